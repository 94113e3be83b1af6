"""Formats, sizes, rates and controls of a V4L2 device. These data are read by ioctl, because OpenCV
does not provide them.

The codes and structure layouts are those of linux/videodev2.h on 64-bit machines.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

from .source import AbsentError, CameraError, NoImagesError

Ioctl = Callable[[int, int, bytearray], object]

QUERYCAP, ENUM_FMT, FRAMESIZES, FRAMEINTERVALS = 0x80685600, 0xC0405602, 0xC02C564A, 0xC034564B
QUERYCTRL, QUERYMENU, G_CTRL, S_CTRL = 0xC0445624, 0xC02C5625, 0xC008561B, 0xC008561C
G_FMT, S_FMT, QUERYBUF = 0xC0D05604, 0xC0D05605, 0xC0585609
"""Codes of the ioctl requests `VIDIOC_...`."""

CAPTURE, MMAP, DISCRETE = 1, 1, 1
"""Values of V4L2_BUF_TYPE_VIDEO_CAPTURE, V4L2_MEMORY_MMAP and V4L2_FRMSIZE_TYPE_DISCRETE."""

CAN_CAPTURE, HAS_DEVICE_CAPS = 0x1, 0x80000000
"""Values of V4L2_CAP_VIDEO_CAPTURE and V4L2_CAP_DEVICE_CAPS."""

NEXT, CONTROL_CLASS, DISABLED = 0x80000000, 6, 0x1
"""Values of V4L2_CTRL_FLAG_NEXT_CTRL, V4L2_CTRL_TYPE_CTRL_CLASS and V4L2_CTRL_FLAG_DISABLED."""

MENU = 3
"""Value of V4L2_CTRL_TYPE_MENU."""

CLOCK_MASK, MONOTONIC, SOURCE_MASK, START_OF_EXPOSURE = 0xE000, 0x2000, 0x70000, 0x10000
"""Values of V4L2_BUF_FLAG_TIMESTAMP_MASK, V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC,
V4L2_BUF_FLAG_TSTAMP_SRC_MASK and V4L2_BUF_FLAG_TSTAMP_SRC_SOE."""

AUTO_EXPOSURE, EXPOSURE, AUTO_PRIORITY = 0x9A0901, 0x9A0902, 0x9A0903
GAIN, AUTO_GAIN = 0x980913, 0x980912
AUTO_WHITE_BALANCE, WHITE_BALANCE = 0x98090C, 0x98091A
AUTO_FOCUS, FOCUS = 0x9A090C, 0x9A090A
"""Ids of controls, `V4L2_CID_...`. Exposure is in units of 100 us, white balance in kelvin."""

MANUAL = 1
"""V4L2_EXPOSURE_MANUAL, a value of the control `AUTO_EXPOSURE`."""

ABSENT = (errno.ENOENT, errno.ENXIO, errno.ENODEV)
"""Codes of the system errors that an absent device causes."""

MAX_ENTRIES = 256
"""Maximum number of entries that are read from a list. The number is limited because the list of a
faulty driver may have no end."""


@dataclass(frozen=True)
class Control:
    """A control of a device: its id, name, range, step, default, value, and menu entries."""

    number: int
    name: str
    low: int
    high: int
    step: int
    default: int
    value: int
    menu: tuple[str, ...] = ()


@dataclass(frozen=True)
class Size:
    """Range of sizes (width, height) [px] from `low` to `high`. If both sizes are equal, the range
    is a single size."""

    low: tuple[int, int]
    high: tuple[int, int]

    def holds(self, size_px: tuple[int, int]) -> bool:
        """Whether a size is in this range."""
        return all(a <= x <= b for a, x, b in zip(self.low, size_px, self.high, strict=True))

    def __str__(self) -> str:
        low, high = ("{}x{}".format(*size) for size in (self.low, self.high))
        return low if low == high else f"{low} to {high}"


def fourcc(name: str) -> int:
    """Return the code of a format's name. The name has up to four characters, without trailing
    spaces."""
    return int.from_bytes(name.ljust(4).encode("ascii"), "little")


class V4l2Device:
    """A V4L2 device. The device can be open here while another program reads its images.

    Parameters
    ----------
    path : str
        Path, such as /dev/video0.
    ioctl : callable
        `fcntl.ioctl`, or a replacement in tests.

    Raises
    ------
    CameraError
        If the device does not exist, if the permission is missing, or if the device provides no
        images.
    """

    def __init__(self, path: str, ioctl: Ioctl = fcntl.ioctl) -> None:
        self.path, self._ioctl = path, ioctl
        try:
            self._file = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        except OSError as error:
            kind = AbsentError if error.errno in ABSENT else CameraError
            raise kind(error_text(path, error)) from None
        try:
            found = self._query(QUERYCAP, bytearray(104))
            self.driver, self.name = _decode_text(found[0:16]), _decode_text(found[16:48])
            of_all, of_this = struct.unpack_from("II", found, 84)
            if not (of_this if of_all & HAS_DEVICE_CAPS else of_all) & CAN_CAPTURE:
                raise NoImagesError(
                    f"{path}: {self.name} does not capture images, allowed: a camera (camera "
                    "--list shows them)"
                )
        except OSError as error:
            self.close()
            raise CameraError(error_text(path, error)) from None
        except CameraError:
            self.close()
            raise

    def close(self) -> None:
        """Close the device."""
        # set the attribute before closing, because another thread may read a control at the same
        # time
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)

    def _query(self, request: int, data: bytearray) -> bytearray:
        self._ioctl(self._file, request, data)
        return data

    def check_free(self) -> None:
        """Raise an error if another program reads the device's images, because then the format
        cannot be set.

        Without this check, OpenCV would wait 10 s for such a device.

        Raises
        ------
        CameraError
        """
        data = bytearray(208)
        struct.pack_into("I", data, 0, CAPTURE)
        try:
            self._query(S_FMT, self._query(G_FMT, data))
        except OSError as error:
            if error.errno == errno.EBUSY:
                raise CameraError(error_text(self.path, error)) from None

    def formats(self) -> dict[str, str]:
        """Return the device's formats: the description by code."""
        found = {}
        for data in self._list_entries(ENUM_FMT, 64, lambda k: struct.pack("II", k, CAPTURE)):
            found[_decode_text(data[44:48]).rstrip()] = _decode_text(data[12:44])
        return found

    def sizes(self, form: str) -> list[Size]:
        """Return the sizes of a format."""
        found = []
        for data in self._list_entries(
            FRAMESIZES, 44, lambda k: struct.pack("II", k, fourcc(form))
        ):
            (kind,) = struct.unpack_from("I", data, 8)
            if kind == DISCRETE:
                size = struct.unpack_from("II", data, 12)
                found.append(Size(size, size))
                continue
            x0, x1, _, y0, y1, _ = struct.unpack_from("6I", data, 12)
            return [Size((x0, y0), (x1, y1))]
        return found

    def rates(self, form: str, size_px: tuple[int, int]) -> tuple[float, ...]:
        """Return the image rates of a format and size [1/s], in ascending order. If the rates are a
        range, return its two ends."""
        found = []
        head = (fourcc(form), *size_px)
        for data in self._list_entries(FRAMEINTERVALS, 52, lambda k: struct.pack("IIII", k, *head)):
            (kind,) = struct.unpack_from("I", data, 16)
            ends = struct.unpack_from("IIII", data, 20)
            found += [ends[1] / max(1, ends[0])]
            if kind != DISCRETE:
                found += [ends[3] / max(1, ends[2])]
                break
        return tuple(sorted(set(found)))

    def _list_entries(
        self, request: int, size: int, head: Callable[[int], bytes]
    ) -> Iterator[bytearray]:
        """Yield the entries of a list until the driver reports an error."""
        for k in range(MAX_ENTRIES):
            data = bytearray(size)
            first = head(k)
            data[: len(first)] = first
            try:
                yield self._query(request, data)
            except OSError:
                return

    def controls(self) -> dict[int, Control]:
        """Return the device's controls by their ids."""
        found: dict[int, Control] = {}
        number = 0
        for _ in range(MAX_ENTRIES):
            data = bytearray(68)
            struct.pack_into("I", data, 0, number | NEXT)
            try:
                self._query(QUERYCTRL, data)
            except OSError:
                break
            number, kind = struct.unpack_from("II", data, 0)
            low, high, step, default = struct.unpack_from("4i", data, 40)
            (flags,) = struct.unpack_from("I", data, 56)
            if kind == CONTROL_CLASS or flags & DISABLED:
                continue
            value = self.get(number)
            if value is not None:
                menu = self._read_menu(number, low, high) if kind == MENU else ()
                name = _decode_text(data[8:40])
                found[number] = Control(number, name, low, high, step, default, value, menu)
        return found

    def _read_menu(self, number: int, low: int, high: int) -> tuple[str, ...]:
        found = []
        for index in range(max(0, low), min(high, low + MAX_ENTRIES) + 1):
            data = bytearray(44)
            struct.pack_into("II", data, 0, number, index)
            with suppress(OSError):
                found.append(f"{index}: {_decode_text(self._query(QUERYMENU, data)[8:40])}")
        return tuple(found)

    def get(self, number: int) -> int | None:
        """Return the value of a control, or None if the value cannot be read."""
        data = bytearray(struct.pack("Ii", number, 0))
        try:
            return int(struct.unpack_from("i", self._query(G_CTRL, data), 4)[0])
        except (OSError, ValueError):  # a closed device causes a ValueError
            return None

    def set(self, number: int, value: int) -> bool:
        """Set a control. Return whether the device accepted the value."""
        try:
            self._query(S_CTRL, bytearray(struct.pack("Ii", number, value)))
        except OSError:
            return False
        return True

    def stamp_source(self) -> tuple[bool, bool] | None:
        """Return whether the stamps of the device's buffers are from the monotonic clock, and
        whether they refer to the start of the exposure. Return None if the driver does not report
        these properties.

        Most drivers also report these properties to a process that does not read the images. The
        driver uvcvideo up to Linux 6.15 does not. The result is then (True, True), which is correct
        for uvcvideo.
        """
        data = bytearray(88)
        struct.pack_into("II", data, 0, 0, CAPTURE)
        struct.pack_into("I", data, 60, MMAP)
        try:
            (flags,) = struct.unpack_from("I", self._query(QUERYBUF, data), 12)
        except OSError:
            return (True, True) if self.driver == "uvcvideo" else None
        return flags & CLOCK_MASK == MONOTONIC, flags & SOURCE_MASK == START_OF_EXPOSURE


def _decode_text(data: bytes | bytearray) -> str:
    return bytes(data).split(b"\0")[0].decode("utf-8", "replace")


def error_text(path: str, error: OSError) -> str:
    """Return a message that describes a system error of a device and its remedy."""
    match error.errno:
        case number if number in ABSENT:
            return (
                f"{path}: no such device; check that it is plugged in. camera --list shows the "
                "available devices"
            )
        case errno.EACCES | errno.EPERM:
            return (
                f"{path}: no permission. Join the group video (sudo usermod -aG video $USER), "
                "then log in again"
            )
        case errno.EBUSY:
            return f"{path}: used by another program; end it (fuser -v {path} shows its name)"
        case errno.ENOTTY | errno.EINVAL:
            return f"{path}: is not a video device, allowed: a device such as /dev/video0"
    return f"{path}: cannot be opened ({error.strerror})"
