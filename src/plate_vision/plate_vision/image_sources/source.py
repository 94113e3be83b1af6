"""The interface of all image sources, such as a camera, a pipe, a film or a folder of pictures.

A source is made from `Settings`, and `Source.read` returns a `Frame`. `Camera` is the base class of
sources with adjustable exposure and gain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Event
from typing import NamedTuple, Protocol

import numpy as np

from plate_core import PlateError

from ..camera import decode_file
from ..errors import ImageError, check_size

FORMATS = {"GREY": 1, "Y10": 2, "Y12": 2, "YUYV": 2, "UYVY": 2, "MJPG": 0}
"""Formats in order of preference, and their bytes per pixel (0: compressed)."""

ENCODINGS = {"GREY": "mono8", "Y10": "mono16", "Y12": "mono16", "YUYV": "yuv422_yuy2",
             "UYVY": "yuv422"}  # fmt: skip
"""Encoding of sensor_msgs/Image for each format."""

UNUSED_BITS = {"Y10": 6, "Y12": 4}
"""Number of unused upper bits in the 16-bit values of a format."""


class CameraError(PlateError):
    """An image source cannot be opened, or it provides no more images."""


class AbsentError(CameraError):
    """The device is absent. A user may plug in the device later."""


class NoImagesError(CameraError):
    """The device captures no images. An example is the second V4L2 device of a camera, which
    delivers only metadata."""


@dataclass(frozen=True)
class Settings:
    """Settings of an image source.

    Attributes
    ----------
    device : str
        Number or path of a V4L2 device, genicam:FILE.cti, or path of a pipe, a video, a picture or
        a folder.
    width, height : int
        Size of the images [px]. For a film, a picture or a folder, the files determine the size.
    rate : float
        Images per second; 0: `LIVE_RATE` for a camera, the file's rate for a film, 2 for a picture
        or a folder.
    format : str
        Key of `FORMATS`; empty: the first format that has this size and rate.
    exposure_us : float
        Exposure time [us]; 0 leaves it unchanged.
    readout_us : float
        Time from the end of the exposure to the stamp [us].
    gain : int
        Gain in the device's units; -1 leaves it unchanged.
    white_balance_k : int
        White balance [K]; 0 leaves it unchanged.
    focus : int
        Focus in the device's units; -1 leaves it unchanged.
    auto_exposure, auto_gain, auto_white_balance, auto_focus : bool
        Whether the device chooses the respective value automatically.
    trigger : bool
        Whether a GenICam camera takes one image for each pulse at its trigger input.
    """

    device: str
    width: int = 640
    height: int = 480
    rate: float = 0.0
    format: str = ""
    exposure_us: float = 0.0
    readout_us: float = 0.0
    gain: int = -1
    white_balance_k: int = 0
    focus: int = -1
    auto_exposure: bool = False
    auto_gain: bool = False
    auto_white_balance: bool = False
    auto_focus: bool = False
    trigger: bool = False

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.width, self.height

    @property
    def before_stamp_s(self) -> float:
        """Time from the start of the exposure to a stamp that is taken when the image is complete
        [s]."""
        return 1e-6 * (self.exposure_us + self.readout_us)


LIVE_RATE = 30.0
"""Default rate of a camera [images/s]."""


class Frame(NamedTuple):
    """An image.

    Attributes
    ----------
    pixels : (H, W), (H, W, 2) or (H, W, 3) uint8, or (H, W) uint16
    encoding : str
        Encoding of sensor_msgs/Image.
    instant : float
        Start of the exposure [s, steady clock].
    arrival : float
        Arrival of the image [s, steady clock].
    name : str
        File name of a picture; empty otherwise.
    """

    pixels: np.ndarray
    encoding: str
    instant: float
    arrival: float
    name: str = ""


class Source(Protocol):
    """A source of images. After `close`, `open` and `read` can be called again.

    Attributes
    ----------
    live : bool
        True for a camera or a pipe; False for files.
    advice : str
        Advice to the user about the probable cause if no image arrives.
    """

    live: bool
    advice: str

    def open(self) -> None:
        """Prepare for `read`.

        Raises
        ------
        PlateError
            If the source cannot be used. The message is one sentence with the remedy.
        """

    def read(self, stop: Event) -> Frame | None:
        """Wait for the next image and return it. Return None if there are no more images, or if
        `stop` is set.

        Raises
        ------
        ImageError
            If the image cannot be used.
        CameraError
            If the source provides no more images.
        """

    def change(self, settings: Settings) -> None:
        """Apply exposure, gain, white balance and focus.

        Raises
        ------
        CameraError
            If the device refuses a setting. The message lists the allowed values.
        """

    def state(self) -> Mapping[str, object]:
        """Return the current settings, for diagnostics."""

    def close(self) -> None:
        """Close the device."""


NO_IMAGE_ADVICE = "check that the camera is plugged in and does not wait for a trigger"
"""Advice to the user if a camera sends no image (`Source.advice`)."""

Warn = Callable[[str], None]


class Camera(ABC):
    """Base class of cameras. The settings of a camera can be changed while it takes images.

    Parameters
    ----------
    settings : Settings
    warn : callable
        Function that is called with the text of a warning.
    clock : callable
        Function that returns the time of the steady clock [s].
    """

    live = True
    advice = NO_IMAGE_ADVICE

    def __init__(self, settings: Settings, warn: Warn, clock: Callable[[], float]) -> None:
        self.settings, self._warn, self._clock = settings, warn, clock

    @property
    @abstractmethod
    def _is_open(self) -> bool: ...

    @abstractmethod
    def _apply_settings(self) -> None:
        """Set exposure, gain and the automatic functions in the device."""

    @abstractmethod
    def _exposure_us(self) -> float | None:
        """Return the exposure time of the device [us], or None if it is unknown."""

    def change(self, settings: Settings) -> None:
        """Apply new settings to the open camera. If the device refuses the new settings, restore
        the old settings."""
        before, self.settings = self.settings, settings
        if not self._is_open:
            return
        try:
            self._apply_settings()
        except CameraError:
            self.settings = before
            self._apply_settings()
            raise

    def _exposure_start_to_stamp_s(self) -> float:
        """Return the time from the start of the exposure to a stamp that is taken after the end of
        the exposure [s]."""
        exposure_us = self.settings.exposure_us or self._exposure_us() or 0.0
        return 1e-6 * (exposure_us + self.settings.readout_us)


def decode_frame(data: np.ndarray, form: str, size_px: tuple[int, int]) -> tuple[np.ndarray, str]:
    """Return pixels and encoding of a frame from a camera or a pipe.

    Parameters
    ----------
    data : array of bytes
        The frame, in any shape.
    form : str
        Key of `FORMATS`.
    size_px : (int, int)
        Width and height that were requested from the camera.

    Raises
    ------
    ImageError
        If the frame has another size, or a JPEG is damaged.
    """
    width, height = size_px
    plain = data.reshape(-1).view(np.uint8)
    if form == "MJPG":
        pixels = decode_file(plain.data, "jpeg", size_px=size_px)
        check_size("image: size is", pixels.shape[1::-1], size_px)
        return pixels, "mono8" if pixels.ndim == 2 else "bgr8"
    expected = width * height * FORMATS[form]
    if plain.size != expected:
        raise ImageError(
            f"image: data has {plain.size} bytes, allowed: {expected} ({width} x {height} px of "
            f"{form}); another program may have changed the camera's format"
        )
    if form in UNUSED_BITS:
        wide = plain.view("<u2").reshape(height, width)
        return wide << UNUSED_BITS[form], ENCODINGS[form]
    shape = (height, width) if FORMATS[form] == 1 else (height, width, 2)
    return plain.reshape(shape), ENCODINGS[form]
