"""A V4L2 camera. OpenCV reads the images. Exposure and gain are set by ioctl. When the first image
arrives, the source determines whether stamps are usable, and whether they are taken at the start or
at the end of the exposure."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from threading import Event
from typing import Any

import cv2
import numpy as np

from ..errors import ImageError
from .source import (
    FORMATS,
    LIVE_RATE,
    Camera,
    CameraError,
    Frame,
    Settings,
    Warn,
    decode_frame,
)
from .v4l2_device import (
    AUTO_EXPOSURE,
    AUTO_FOCUS,
    AUTO_GAIN,
    AUTO_PRIORITY,
    AUTO_WHITE_BALANCE,
    EXPOSURE,
    FOCUS,
    GAIN,
    MANUAL,
    WHITE_BALANCE,
    V4l2Device,
    fourcc,
)

EXPOSURE_US = 100
"""Unit of the exposure control [us]."""

OLDEST_S = 2.0
"""Maximum age of a stamp from the monotonic clock [s]. Images that wait in OpenCV's four buffers
are younger."""

RATE_ERROR = 0.02
"""Maximum deviation of the device's rate from the requested rate, relative to the requested rate
[-]. If the deviation exceeds this maximum, a warning is given."""


def open_capture(path: str) -> Any:
    """Return OpenCV's reader of a device."""
    return cv2.VideoCapture(path, cv2.CAP_V4L2)


class V4l2Source(Camera):
    """A V4L2 camera.

    Stamps come from the kernel: OpenCV's `CAP_PROP_POS_MSEC` is `v4l2_buffer.timestamp` (in
    cap_v4l.cpp of 4.x and 5.x). With other backends of OpenCV, the stamps are not from the
    monotonic clock. The time of arrival is then used instead.

    Parameters
    ----------
    settings : Settings
    warn : callable
        Function that is called with the text of a warning.
    device : callable
        Function that opens the `V4l2Device` at a path.
    capture : callable
        Function that opens OpenCV's reader at a path.
    clock : callable
        Function that returns the time of the steady clock [s].
    """

    def __init__(
        self,
        settings: Settings,
        warn: Warn,
        device: Callable[[str], V4l2Device] = V4l2Device,
        capture: Callable[[str], Any] = open_capture,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        name = settings.device
        self.path = f"/dev/video{name}" if name.isdigit() else name
        super().__init__(settings, warn, clock)
        self._make_device, self._make_capture = device, capture
        self._device: V4l2Device | None = None
        self._capture: Any = None
        self._form, self._rate = "", 0.0
        # True if the camera's stamps refer to the start of the exposure, and False if they refer to
        # its end. None: the arrival time of the images is used instead of stamps.
        self._at_start: bool | None = None
        self._stamps_known = False

    def open(self) -> None:
        """Open the camera, and apply the settings."""
        if self.settings.trigger:
            raise CameraError(
                f"{self.path}: trigger is true, allowed: false, because this is not a GenICam "
                f"camera; set its trigger with v4l2-ctl -d {self.path} (--list-ctrls)"
            )
        try:
            device = self._device = self._make_device(self.path)
            device.check_free()
            self._form = self._choose_format(device)
            self._apply_settings()
            self._capture = self._open_reader()
        except BaseException:
            self.close()
            raise
        self._stamps_known = False

    def _choose_format(self, device: V4l2Device) -> str:
        """Return the format that the settings contain. If the settings have no format, return the
        first format that has this size and rate."""
        requested, size_px = self.settings, self.settings.size_px
        has = [form for form in FORMATS if form in device.formats()]
        offers = {form: device.sizes(form) for form in has}
        known = f"a format of {', '.join(FORMATS)}"
        if requested.format and requested.format not in has:
            raise CameraError(
                f"{self.path}: format is {requested.format}, allowed by {device.name}: "
                f"{', '.join(has) or known}"
            )
        forms = [requested.format] if requested.format else has
        fit = [form for form in forms if any(size.holds(size_px) for size in offers[form])]
        if not fit:
            sizes = "; ".join(f"{form} {', '.join(map(str, offers[form]))}" for form in forms)
            raise CameraError(
                f"{self.path}: size is {size_px[0]} x {size_px[1]} px, allowed by {device.name}: "
                f"{sizes or known}"
            )
        rates = {form: device.rates(form, size_px) for form in fit}
        rate = requested.rate or LIVE_RATE
        quick = [form for form in fit if not rates[form] or max(rates[form]) >= 0.99 * rate]
        if not quick:
            best = ", ".join(f"{max(rates[form]):.4g} with {form}" for form in fit)
            if requested.rate:
                raise CameraError(
                    f"{self.path}: rate is {rate:g} images per second at {size_px[0]} x "
                    f"{size_px[1]} px, allowed by {device.name}: {best}"
                )
            quick = [max(fit, key=lambda form: max(rates[form]))]
        slow = [form for form in quick if not rates[form] or min(rates[form]) <= 1.01 * rate]
        if requested.rate and not slow:
            minimum = ", ".join(f"{min(rates[form]):.4g} with {form}" for form in quick)
            raise CameraError(
                f"{self.path}: rate is {rate:g} images per second at {size_px[0]} x {size_px[1]} "
                f"px, allowed by {device.name}: at least {minimum}"
            )
        form = (slow or quick)[0]
        self._rate = min(rate, max(rates[form])) if rates[form] else rate
        return form

    def _open_reader(self) -> Any:
        """Open OpenCV's reader, set its format, size and rate, and return it."""
        width, height = self.settings.size_px
        capture = self._make_capture(self.path)
        if not capture.isOpened():
            raise CameraError(
                f"{self.path}: OpenCV cannot open this device; try v4l2-ctl -d {self.path} "
                "--stream-mmap --stream-count=10"
            )
        capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
        capture.set(cv2.CAP_PROP_FOURCC, fourcc(self._form))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
        capture.set(cv2.CAP_PROP_FPS, round(self._rate))
        found = tuple(
            int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        form = (
            int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace")
        )
        if found != (width, height) or form.rstrip() != self._form:
            capture.release()
            raise CameraError(
                f"{self.path}: the device delivers {found[0]} x {found[1]} px of {form.rstrip()}, "
                f"requested: {width} x {height} px of {self._form}; see camera --list"
            )
        rate = capture.get(cv2.CAP_PROP_FPS)
        if rate > 0 and abs(rate - self._rate) > RATE_ERROR * self._rate:
            self._warn(
                f"{self.path}: rate is {rate:.4g} images per second, requested: {self._rate:g}"
            )
            self._rate = rate
        return capture

    @property
    def _is_open(self) -> bool:
        return self._device is not None

    def _apply_settings(self) -> None:
        device, values = self._device, self.settings
        assert device is not None
        has = device.controls()
        automatic = (
            ("auto_exposure", AUTO_EXPOSURE, MANUAL),
            ("auto_gain", AUTO_GAIN, 0),
            ("auto_white_balance", AUTO_WHITE_BALANCE, 0),
            ("auto_focus", AUTO_FOCUS, 0),
        )
        for name, number, off in automatic:
            control = has.get(number)
            if getattr(values, name):
                if control is None:
                    raise self._no_control_error(name, "true")
                done = device.set(number, control.default if control.default != off else 1 - off)
            else:
                done = control is None or device.set(number, off)
            if not done:
                self._warn(
                    f"{self.path}: {name} cannot be switched; try v4l2-ctl -d {self.path} "
                    "--list-ctrls-menus"
                )
        # switch off automatic priority, because it would reduce the image rate in the dark
        if AUTO_PRIORITY in has:
            device.set(AUTO_PRIORITY, 0)
        given = (
            ("exposure_us", EXPOSURE, values.exposure_us > 0, EXPOSURE_US),
            ("gain", GAIN, values.gain >= 0, 1),
            ("white_balance_k", WHITE_BALANCE, values.white_balance_k > 0, 1),
            ("focus", FOCUS, values.focus >= 0, 1),
        )
        for name, number, requested, unit in given:
            if not requested:
                continue
            value, control = getattr(values, name), has.get(number)
            if control is None:
                raise self._no_control_error(name, f"{value:g}")
            if not control.low * unit <= value <= control.high * unit:
                raise CameraError(
                    f"{self.path}: {name} is {value:g}, allowed by {device.name}: "
                    f"{control.low * unit} to {control.high * unit}"
                )
            if not device.set(number, round(value / unit)):
                raise CameraError(
                    f"{self.path}: {name} is {value:g}, refused by {device.name}; try "
                    f"v4l2-ctl -d {self.path} --list-ctrls"
                )

    def _no_control_error(self, name: str, value: str) -> CameraError:
        return CameraError(
            f"{self.path}: {name} is {value}, but the device has no such control; "
            f"v4l2-ctl -d {self.path} --list-ctrls lists its controls"
        )

    def read(self, stop: Event) -> Frame | None:
        """Wait for the next image. OpenCV waits up to 10 s. Return None if no image arrives
        and `stop` is set."""
        if not self._capture.grab():
            if stop.is_set():
                return None
            if not os.path.exists(self.path):
                raise CameraError(
                    f"{self.path}: the camera is unplugged; images continue when it is back"
                )
            raise CameraError(
                f"{self.path}: the camera delivers no images; it may wait for a trigger, or "
                "several cameras may share one USB controller"
            )
        arrival = self._clock()
        is_read, data = self._capture.retrieve()
        stamp = 1e-3 * self._capture.get(cv2.CAP_PROP_POS_MSEC)
        if not self._stamps_known:
            self._identify_stamp_source(arrival - stamp)
        if not is_read:
            raise CameraError(f"{self.path}: the camera delivers no images; it may be unplugged")
        if self._at_start is not None and not 0 <= arrival - stamp < OLDEST_S:
            raise ImageError(
                f"{self.path}: an image arrives {arrival - stamp:.3g} s after its stamp, allowed: "
                f"0 to {OLDEST_S:g} s; the computer may have stalled"
            )
        form = self._form
        pixels, encoding = decode_frame(np.asarray(data), form, self.settings.size_px)
        end = arrival if self._at_start is None else stamp
        instant = end if self._at_start else end - self._exposure_start_to_stamp_s()
        return Frame(pixels, encoding, instant, arrival)

    def _identify_stamp_source(self, age: float) -> None:
        """Determine from the age [s] of the first image's stamp whether stamps are usable, and
        whether they refer to the start or the end of the exposure."""
        self._stamps_known = True
        source = self._device.stamp_source() if self._device else None
        monotonic, at_start = (True, False) if source is None else source
        if monotonic and 0 <= age < OLDEST_S:
            self._at_start = at_start
            return
        self._at_start = None
        self._warn(
            f"{self.path}: stamps are not from the kernel's monotonic clock (OpenCV "
            f"{cv2.__version__}), so the arrival time of images is used"
        )

    def _exposure_us(self) -> float | None:
        device = self._device
        value = device.get(EXPOSURE) if device else None
        return None if value is None else float(EXPOSURE_US * value)

    def state(self) -> Mapping[str, object]:
        """Return the current format, exposure and gain, and the meaning of the stamps."""
        device, exposure_us = self._device, self._exposure_us()
        gain = device.get(GAIN) if device else None
        kinds = {True: "start of exposure", False: "end of exposure", None: "arrival"}
        return {
            "format": self._form,
            "exposure_us": "unknown" if exposure_us is None else f"{exposure_us:g}",
            "gain": "unknown" if gain is None else gain,
            "stamp": kinds[self._at_start] if self._stamps_known else "",
        }

    def close(self) -> None:
        """Close the camera."""
        if self._capture is not None:
            self._capture.release()
        if self._device is not None:
            self._device.close()
        self._capture = self._device = None
