"""A V4L2 device that is none: the kernel's answers to ioctl, and OpenCV's reader of its images."""

import errno
import queue
import struct
import time

import cv2
import numpy as np

from plate_vision.image_sources import v4l2_device as v4l2
from plate_vision.image_sources.v4l2 import V4l2Source

YUYV_SLOW = {"YUYV": {(640, 480): (15, 30), (1280, 720): (10,)}}
MJPG_FAST = {"MJPG": {(640, 480): (30, 60), (1280, 720): (30, 60)}}
CONTROLS = {
    v4l2.AUTO_EXPOSURE: ["Exposure, Auto", v4l2.MENU, 0, 3, 1, 3, 3],
    v4l2.EXPOSURE: ["Exposure (Absolute)", 1, 3, 2047, 1, 250, 250],
    v4l2.AUTO_PRIORITY: ["Exposure, Auto Priority", 2, 0, 1, 1, 1, 1],
    v4l2.GAIN: ["Gain", 1, 0, 100, 1, 20, 20],
    v4l2.AUTO_WHITE_BALANCE: ["White Balance, Automatic", 2, 0, 1, 1, 1, 1],
    v4l2.WHITE_BALANCE: ["White Balance Temperature", 1, 2800, 6500, 1, 4600, 4600],
    v4l2.AUTO_FOCUS: ["Focus, Automatic", 2, 0, 1, 1, 1, 1],
}
"""Name, type, low, high, step, default, value."""


class FakeCamera:
    """A camera at a path, which is a file of the test; what it gives and refuses are attributes.

    `show` gives an image (its bytes, its kernel stamp [s]); while it is `stalled` OpenCV gives up.
    """

    def __init__(self, path, formats=None, controls=None, name="Fake camera", driver="fake"):
        self.path = path
        self.formats = formats or YUYV_SLOW | MJPG_FAST
        self.controls = {number: list(row) for number, row in (controls or CONTROLS).items()}
        self.name, self.driver = name, driver
        self.busy = self.stalled = False
        self.flags = v4l2.MONOTONIC | v4l2.START_OF_EXPOSURE
        self.opened = 0
        self.fourcc, self.size_px, self.gives_px = 0, [640, 480], None
        self.plug()

    def plug(self):
        self.plugged, self.given = True, queue.Queue()
        self.path.touch()

    def unplug(self):
        self.path.unlink()
        self.plugged = False

    def show(self, data, stamp):
        self.given.put((np.frombuffer(bytes(data), np.uint8), stamp))

    def device(self, path):
        return v4l2.V4l2Device(path, self.ioctl)

    def capture(self, path):
        self.opened += 1
        return FakeCapture(self)

    def source(self, settings, warn, clock=time.monotonic):
        return V4l2Source(settings, warn, self.device, self.capture, clock)

    # The kernel

    def ioctl(self, file, request, data):
        answer = {
            v4l2.QUERYCAP: self._capability, v4l2.ENUM_FMT: self._format,
            v4l2.FRAMESIZES: self._size, v4l2.FRAMEINTERVALS: self._rate,
            v4l2.QUERYCTRL: self._control, v4l2.QUERYMENU: self._menu, v4l2.G_CTRL: self._get,
            v4l2.S_CTRL: self._set, v4l2.G_FMT: lambda data: None, v4l2.S_FMT: self._fixed,
            v4l2.QUERYBUF: self._buffer,
        }[request]  # fmt: skip
        if not self.plugged:
            raise OSError(errno.ENODEV, "No such device")
        answer(data)

    def _capability(self, data):
        struct.pack_into("16s32s", data, 0, self.driver.encode(), self.name.encode())
        struct.pack_into("II", data, 84, v4l2.HAS_DEVICE_CAPS | v4l2.CAN_CAPTURE, v4l2.CAN_CAPTURE)

    def _format(self, data):
        index, _ = struct.unpack_from("II", data)
        form = self._nth(list(self.formats), index)
        struct.pack_into("32sI", data, 12, f"pixels as {form}".encode(), v4l2.fourcc(form))

    def _size(self, data):
        index, code = struct.unpack_from("II", data)
        size = self._nth(list(self._sizes(code)), index)
        struct.pack_into("III", data, 8, v4l2.DISCRETE, *size)

    def _rate(self, data):
        index, code, width, height = struct.unpack_from("IIII", data)
        rate = self._nth(self._sizes(code)[width, height], index)
        struct.pack_into("III", data, 16, v4l2.DISCRETE, 1, rate)

    def _sizes(self, code):
        return next(sizes for form, sizes in self.formats.items() if v4l2.fourcc(form) == code)

    def _control(self, data):
        (requested,) = struct.unpack_from("I", data)
        later = sorted(number for number in self.controls if number > requested & ~v4l2.NEXT)
        number = self._nth(later, 0)
        name, kind, low, high, step, default, _ = self.controls[number]
        struct.pack_into("II32s4i", data, 0, number, kind, name.encode(), low, high, step, default)

    def _menu(self, data):
        _, index = struct.unpack_from("II", data)
        if index == 2:
            raise OSError(errno.EINVAL, "Invalid argument")
        struct.pack_into("32s", data, 8, f"mode {index}".encode())

    def _get(self, data):
        number, _ = struct.unpack("Ii", data)
        if number not in self.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        struct.pack_into("i", data, 4, self.controls[number][-1])

    def _set(self, data):
        number, value = struct.unpack("Ii", data)
        if number not in self.controls or not (
            self.controls[number][2] <= value <= self.controls[number][3]
        ):
            raise OSError(errno.ERANGE, "Numerical result out of range")
        self.controls[number][-1] = value

    def _fixed(self, data):
        if self.busy:
            raise OSError(errno.EBUSY, "Device or resource busy")

    def _buffer(self, data):
        if self.driver == "uvcvideo" or self.flags is None:
            raise OSError(errno.EBUSY, "Device or resource busy")
        struct.pack_into("I", data, 12, self.flags)

    @staticmethod
    def _nth(items, index):
        if index >= len(items):
            raise OSError(errno.EINVAL, "Invalid argument")
        return items[index]


class FakeCapture:
    """OpenCV's reader of it."""

    def __init__(self, camera):
        self._camera, self._frame, self._stamp = camera, None, 0.0

    def isOpened(self):  # as OpenCV calls it
        return self._camera.plugged

    def set(self, key, value):
        camera = self._camera
        if key == cv2.CAP_PROP_FOURCC:
            camera.fourcc = int(value)
        elif key == cv2.CAP_PROP_FRAME_WIDTH:
            camera.size_px[0] = int(value)
        elif key == cv2.CAP_PROP_FRAME_HEIGHT:
            camera.size_px[1] = int(value)
        elif key == cv2.CAP_PROP_FPS:
            camera.fps = value
        return True

    def get(self, key):
        camera = self._camera
        return {
            cv2.CAP_PROP_FOURCC: camera.fourcc,
            cv2.CAP_PROP_FRAME_WIDTH: (camera.gives_px or camera.size_px)[0],
            cv2.CAP_PROP_FRAME_HEIGHT: (camera.gives_px or camera.size_px)[1],
            cv2.CAP_PROP_FPS: getattr(camera, "fps", 30),
            cv2.CAP_PROP_POS_MSEC: 1e3 * self._stamp,
        }[key]

    def grab(self):
        for _ in range(1000):  # 10 s, as OpenCV
            try:
                self._frame, self._stamp = self._camera.given.get(timeout=0.01)
                return True
            except queue.Empty:
                if not self._camera.plugged or self._camera.stalled:
                    return False
        return False

    def retrieve(self):
        return True, self._frame

    def release(self):
        self._camera = None
