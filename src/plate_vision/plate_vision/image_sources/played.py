"""Image sources other than cameras: a film, a picture, a folder of pictures, or a pipe of raw
frames. Files are played at a constant rate. A pipe delivers a frame when another program has
written it."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Event

import numpy as np

from ..camera import Pictures, read_pictures
from ..errors import ImageError
from .source import FORMATS, CameraError, Frame, Settings, Warn, decode_frame

PICTURE_RATE = 2.0
"""Default rate of the pictures of a folder [1/s]."""

FILM_RATE = 30.0
"""Rate of a film whose file has no plausible rate [1/s]."""

FILM_RATES = (1.0, 240.0)
"""Range of plausible rates of a film [1/s]."""

POLL_S = 0.1
"""Maximum time to wait for bytes of a pipe before `stop` is checked again [s]."""


class FilmSource:
    """A film, a picture or a folder of pictures. Each image is delivered when it is due.

    The intervals between the stamps are constant. If an image is not ready when it is due, all
    later images are delayed too, so that no image is lost.
    """

    live = False
    advice = ""

    def __init__(
        self, settings: Settings, warn: Warn, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._path, self._settings = Path(settings.device), settings
        self._warn, self._clock = warn, clock
        self._pictures: Pictures | None = None
        self._rate, self._due = settings.rate, 0.0

    def open(self) -> None:
        """Open the files. If the folder is empty or OpenCV cannot read the film, raise an error."""
        self._pictures = read_pictures(self._path, self._warn)
        natural_rate = FILM_RATE if self._pictures.is_film else PICTURE_RATE
        if FILM_RATES[0] <= self._pictures.rate <= FILM_RATES[1]:
            natural_rate = self._pictures.rate
        self._rate = self._settings.rate or natural_rate
        self._due = 0.0

    def read(self, stop: Event) -> Frame | None:
        """Wait until the next picture is due. Return None if there is no further picture, or if
        `stop` is set."""
        assert self._pictures is not None
        try:
            found = next(self._pictures, None)
        except ImageError as error:
            raise CameraError(f"no more pictures: {error}") from None
        if found is None:
            return None
        name, pixels = found
        now = self._clock()
        self._due = max(self._due, now)
        if stop.wait(self._due - now):
            return None
        frame = Frame(pixels, "bgr8", self._due, self._due, name)
        self._due += 1 / self._rate
        return frame

    def change(self, settings: Settings) -> None:
        """Ignore the settings, because a film has no settings."""

    def state(self) -> Mapping[str, object]:
        """Return the kind of the files, and the meaning of the stamps."""
        film = self._pictures is not None and self._pictures.is_film
        return {"format": "film" if film else "pictures", "stamp": "regular"}

    def close(self) -> None:
        """Close the files. A new `open` starts from the first picture."""
        self._pictures = None


class PipeSource:
    """A named pipe into which another program writes raw frames.

    Examples are `v4l2-ctl --stream-mmap --stream-to=PIPE`, and ffmpeg with `-f rawvideo`. The
    exposure of a frame is assumed to end when the frame arrives.
    """

    live = True
    advice = "check that a program writes frames of this format and size to the pipe"

    def __init__(
        self, settings: Settings, warn: Warn, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._settings, self._clock = settings, clock
        self._form = settings.format or "GREY"
        self._file = -1
        width, height = settings.size_px
        self._bytes = width * height * FORMATS[self._form]

    def open(self) -> None:
        """Open the pipe. No program needs to write to it yet."""
        if not self._bytes:
            plain = ", ".join(form for form, size in FORMATS.items() if size)
            raise CameraError(
                f"{self._settings.device}: format is MJPG, allowed for a pipe: {plain}"
            )
        try:
            self._file = os.open(self._settings.device, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise CameraError(f"{self._settings.device}: cannot be read ({error})") from None

    def read(self, stop: Event) -> Frame | None:
        """Wait for the bytes of a frame. Return None if `stop` is set."""
        data, have = np.empty(self._bytes, np.uint8), 0
        rest = memoryview(data.data)
        while have < self._bytes:
            if stop.is_set():
                return None
            if not select.select([self._file], [], [], POLL_S)[0]:
                continue
            try:
                count = os.readv(self._file, [rest[have:]])
            except BlockingIOError:
                continue
            if not count:
                raise CameraError(
                    f"{self._settings.device}: no program writes to the pipe any more; images "
                    "continue when a program writes to it again"
                )
            have += count
        arrival = self._clock()
        pixels, encoding = decode_frame(data, self._form, self._settings.size_px)
        return Frame(pixels, encoding, arrival - self._settings.before_stamp_s, arrival)

    def change(self, settings: Settings) -> None:
        """Apply the exposure time, on which the stamps depend."""
        self._settings = settings

    def state(self) -> Mapping[str, object]:
        """Return the format of the frames."""
        exposure_us = self._settings.exposure_us
        return {
            "format": self._form,
            "exposure_us": f"{exposure_us:g}" if exposure_us else "unknown",
            "gain": "unknown",
            "stamp": "arrival",
        }

    def close(self) -> None:
        """Close the pipe."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1
