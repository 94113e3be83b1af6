"""A GenICam camera. The library harvesters reads the images by means of the GenTL file of the
camera's manufacturer.

This module has not been tested with a real camera yet.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from threading import Event
from typing import Any

import numpy as np

from ..errors import ImageError
from .source import LIVE_RATE, AbsentError, Camera, CameraError, Frame, Settings, Warn

PREFIX = "genicam:"
"""Prefix of the name of a GenICam device: genicam:FILE.cti, or genicam:FILE.cti#SERIAL."""

PIXEL_FORMATS = {"GREY": "Mono8", "Y10": "Mono10", "Y12": "Mono12"}
"""GenICam's names of some of the formats in `source.FORMATS`."""

ENCODINGS = {
    "Mono8": ("mono8", 0), "Mono10": ("mono16", 6), "Mono12": ("mono16", 4),
    "Mono16": ("mono16", 0), "RGB8": ("rgb8", 0), "BGR8": ("bgr8", 0),
    "BayerRG8": ("bayer_rggb8", 0), "BayerBG8": ("bayer_bggr8", 0),
    "BayerGB8": ("bayer_gbrg8", 0), "BayerGR8": ("bayer_grbg8", 0),
}  # fmt: skip
"""Encoding of each pixel format in sensor_msgs/Image, and number of unused upper bits of its 16-bit
values."""

FETCH_S = 0.5
"""Maximum time to wait for an image before `stop` is checked again [s]."""

OFFSETS = 100
"""Number of images whose minimum delay is used as the offset between the camera's clock and the
host's clock."""


def open_producer(file: str) -> Any:
    """Return the harvesters object that manages the devices of a GenTL file.

    Raises
    ------
    CameraError
        If harvesters is not installed, or the file cannot be used.
    """
    try:
        from harvesters.core import Harvester
    except ImportError:
        raise CameraError(
            "GenICam cameras require harvesters, which is not installed: pip install '.[genicam]'"
        ) from None
    harvester = Harvester()
    try:
        harvester.add_file(file, check_existence=True, check_validity=True)
        harvester.update()
    except Exception as error:  # the manufacturer's library can raise any type of exception
        raise CameraError(
            f"{file}: cannot be used ({error}), allowed: a GenTL file, .cti"
        ) from None
    return harvester


class GenicamSource(Camera):
    """A GenICam camera. `producer` opens the GenTL file of the camera. The other parameters are
    those of `Camera`."""

    def __init__(
        self,
        settings: Settings,
        warn: Warn,
        producer: Callable[[str], Any] = open_producer,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(settings, warn, clock)
        self._file, _, self._serial = settings.device.removeprefix(PREFIX).partition("#")
        self._producer = producer
        self._harvester: Any = None
        self._camera: Any = None
        self._offsets: deque[float] = deque(maxlen=OFFSETS)

    @property
    def _nodes(self) -> Any:
        assert self._camera is not None
        return self._camera.remote_device.node_map

    def open(self) -> None:
        """Open the camera, and apply the settings."""
        self._harvester = harvester = self._producer(self._file)
        name = self.settings.device
        try:
            self._camera = harvester.create({"serial_number": self._serial} if self._serial else 0)
        except Exception as error:
            self.close()
            serials = ", ".join(str(info.serial_number) for info in harvester.device_info_list)
            if not serials:
                raise AbsentError(f"{name}: no camera found; check that it is plugged in") from None
            raise CameraError(f"{name}: {error}; available cameras: {serials}") from None
        try:
            self._set_feature("Width", self.settings.width)
            self._set_feature("Height", self.settings.height)
            if self.settings.format:
                pixel_format = PIXEL_FORMATS.get(self.settings.format)
                if pixel_format is None:
                    raise CameraError(
                        f"{name}: format is {self.settings.format}, allowed for GenICam: "
                        f"{', '.join(PIXEL_FORMATS)}"
                    )
                self._set_feature("PixelFormat", pixel_format)
            self._apply_settings()
            self._set_trigger()
            self._camera.start()
        except BaseException:
            self.close()
            raise
        self._offsets.clear()

    @property
    def _is_open(self) -> bool:
        return self._camera is not None

    def _apply_settings(self) -> None:
        values = self.settings
        for feature, chosen in (
            ("ExposureAuto", values.auto_exposure),
            ("GainAuto", values.auto_gain),
            ("BalanceWhiteAuto", values.auto_white_balance),
        ):
            if hasattr(self._nodes, feature):
                self._set_feature(feature, "Continuous" if chosen else "Off")
        if values.exposure_us > 0:
            self._set_feature("ExposureTime", values.exposure_us)
        if values.gain >= 0:
            self._set_feature("Gain", values.gain)

    def _set_trigger(self) -> None:
        """Set whether the camera takes images at trigger pulses or at a fixed rate."""
        triggered = self.settings.trigger
        if hasattr(self._nodes, "TriggerMode"):
            if hasattr(self._nodes, "TriggerSelector"):
                self._set_feature("TriggerSelector", "FrameStart")
            self._set_feature("TriggerMode", "On" if triggered else "Off")
        elif triggered:
            raise CameraError(
                f"{self.settings.device}: trigger is true, but the camera has no TriggerMode"
            )
        if hasattr(self._nodes, "AcquisitionFrameRateEnable"):
            self._set_feature("AcquisitionFrameRateEnable", not triggered)
        if not triggered and hasattr(self._nodes, "AcquisitionFrameRate"):
            self._set_feature("AcquisitionFrameRate", self.settings.rate or LIVE_RATE)

    def _set_feature(self, feature: str, value: object) -> None:
        """Set a feature of the camera. If the camera refuses the value, raise an error that states
        the allowed values."""
        node = getattr(self._nodes, feature, None)
        where = f"{self.settings.device}: {feature} is {value}"
        if node is None:
            raise CameraError(f"{where}, but the camera has no such feature")
        try:
            node.value = value
        # GenApi and the manufacturers' libraries can raise any type of exception
        except Exception as error:
            ends = [getattr(node, end, None) for end in ("min", "max")]
            symbols = getattr(node, "symbolics", None)
            allowed = ", ".join(symbols) if symbols else " to ".join(map(str, ends))
            raise CameraError(f"{where}, allowed by the camera: {allowed} ({error})") from None

    def read(self, stop: Event) -> Frame | None:
        """Wait for the next image. Return None if `stop` is set."""
        assert self._camera is not None
        while True:
            buffer = self._camera.try_fetch(timeout=FETCH_S)
            arrival = self._clock()
            if stop.is_set():
                return None
            if buffer is not None:
                break
            self._check_plugged_in()
        with buffer:
            component = buffer.payload.components[0]
            kind = str(component.data_format)
            if kind not in ENCODINGS:
                raise ImageError(f"image: format is {kind}, allowed: {', '.join(ENCODINGS)}")
            encoding, unused = ENCODINGS[kind]
            shape = (int(component.height), int(component.width))
            if shape[::-1] != self.settings.size_px:
                raise ImageError(
                    f"image: size is {shape[1]} x {shape[0]} px, allowed: "
                    f"{self.settings.width} x {self.settings.height} px"
                )
            data = np.array(component.data)  # copy the data, because the camera reuses the buffer
            pixels = data.reshape(shape if data.size == shape[0] * shape[1] else (*shape, 3))
            try:
                taken = 1e-9 * float(buffer.timestamp_ns)
            # the manufacturer's library raises an exception if the camera has no clock
            except Exception:
                taken = arrival
        # The offset between the clocks of host and camera is estimated as the minimum delay of the
        # last images.
        self._offsets.append(arrival - taken)
        end = taken + min(self._offsets)
        instant = end - self._exposure_start_to_stamp_s()
        return Frame(pixels << unused if unused else pixels, encoding, instant, arrival)

    def _check_plugged_in(self) -> None:
        """Raise an error if the camera is unplugged, so that `read` does not wait for it."""
        self._harvester.update()
        infos = self._harvester.device_info_list
        if not any(self._serial in ("", str(info.serial_number)) for info in infos):
            raise CameraError(
                f"{self.settings.device}: the camera is unplugged; images continue when it is back"
            )

    def _exposure_us(self) -> float | None:
        node = getattr(self._nodes, "ExposureTime", None) if self._camera is not None else None
        return None if node is None else float(node.value)

    def state(self) -> Mapping[str, object]:
        """Return the current exposure and gain."""
        found: dict[str, object] = {"exposure_us": "unknown", "gain": "unknown"}
        # GenApi raises an error if the camera is unplugged or does not have this feature.
        with suppress(Exception):
            found["gain"] = self._nodes.Gain.value
            found["exposure_us"] = f"{self._exposure_us():g}"
        return {
            "format": self.settings.format or "the camera's setting",
            **found,
            "stamp": "end of exposure on the camera's clock",
        }

    def close(self) -> None:
        """Close the camera."""
        if self._camera is not None:
            self._camera.destroy()
        if self._harvester is not None:
            self._harvester.reset()
        self._camera = self._harvester = None
