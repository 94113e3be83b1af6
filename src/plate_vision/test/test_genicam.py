"""A GenICam camera, with a stand-in for harvesters and the maker's library."""

from contextlib import contextmanager
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest

from plate_vision.errors import ImageError
from plate_vision.image_sources import CameraError, Settings
from plate_vision.image_sources.genicam import GenicamSource, open_producer


class Node:
    """A feature: a number within a range, or one of some words."""

    def __init__(self, value, low=None, high=None, symbolics=None):
        self._value, self.min, self.max, self.symbolics = value, low, high, symbolics

    @property
    def value(self):
        return self._value

    @value.setter
    def value(self, value):
        if self.symbolics is not None and value not in self.symbolics:
            raise ValueError("not an entry")
        if self.min is not None and not self.min <= value <= self.max:
            raise ValueError("out of range")
        self._value = value


class Maker:
    """Harvester and camera in one; its clock is 500 s behind ours."""

    def __init__(self, serials=("17",)):
        self.device_info_list = [SimpleNamespace(serial_number=each) for each in serials]
        self.nodes = SimpleNamespace(
            Width=Node(0, 8, 64), Height=Node(0, 8, 48),
            PixelFormat=Node("Mono8", symbolics=("Mono8", "Mono12")),
            ExposureAuto=Node("Continuous", symbolics=("Off", "Continuous")),
            ExposureTime=Node(900.0, 20.0, 10000.0), Gain=Node(1.0, 0.0, 24.0),
            TriggerMode=Node("Off", symbolics=("Off", "On")), AcquisitionFrameRate=Node(1, 1, 100),
        )  # fmt: skip
        self.remote_device = SimpleNamespace(node_map=self.nodes)
        self.buffers, self.started, self.unplugged = [], False, False
        self.held = 1  # the library, and the camera once it is created

    def create(self, key):
        found = [each for each in self.device_info_list
                 if key == 0 or each.serial_number == key["serial_number"]]  # fmt: skip
        if not found:
            raise ValueError("no such device")
        self.held += 1
        return self

    def start(self):
        self.started = True

    def update(self):
        if self.unplugged:
            self.device_info_list = []

    def try_fetch(self, timeout):
        if not self.buffers:
            return None
        pixels, kind, taken = self.buffers.pop(0)
        part = SimpleNamespace(height=48, width=64, data_format=kind, data=pixels.reshape(-1))

        @contextmanager
        def buffer():
            yield

        found = buffer()
        found.payload = SimpleNamespace(components=[part])
        found.timestamp_ns = round(1e9 * taken)
        return found

    def destroy(self):
        self.started = False
        self.held -= 1

    def reset(self):
        self.held -= 1


def opened(maker, **settings):
    values = Settings(**({"device": "genicam:x.cti", "width": 64, "height": 48} | settings))
    source = GenicamSource(values, pytest.fail, lambda file: maker, lambda: maker.now)
    source.open()
    return source


def test_settings_are_applied_and_images_get_stamps():
    maker = Maker()
    source = opened(maker, exposure_us=2000.0, gain=3, format="Y12", rate=60.0)
    nodes = maker.nodes
    assert (nodes.Width.value, nodes.PixelFormat.value) == (64, "Mono12")
    assert (nodes.ExposureAuto.value, nodes.ExposureTime.value) == ("Off", 2000.0)
    assert (nodes.TriggerMode.value, nodes.AcquisitionFrameRate.value) == ("Off", 60.0)
    image, instants = np.full((48, 64), 4095, np.uint16), []
    for k, delay in enumerate((0.010, 0.004, 0.030)):  # of the line
        maker.buffers.append((image, "Mono12", 100 + 0.1 * k))
        maker.now = 600 + 0.1 * k + delay
        frame = source.read(Event())
        instants.append(frame.instant - 600 - 0.1 * k)
    # The quickest image counts: 4 ms remain of the line's delay.
    assert instants == pytest.approx([0.010 - 0.002, 0.004 - 0.002, 0.004 - 0.002])
    assert frame.encoding == "mono16"
    assert int(frame.pixels.max()) == 4095 << 4
    source.close()
    assert (maker.started, maker.held) == (False, 0)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_the_brightest_grey_of_a_format_fills_its_bits(bits):
    maker = Maker()
    maker.now = 0.0
    source = opened(maker)
    kind = np.uint8 if bits == 8 else np.uint16
    maker.buffers.append((np.full((48, 64), 2**bits - 1, kind), f"Mono{bits}", 0.0))
    frame = source.read(Event())
    wide = max(bits, 8 if bits == 8 else 16)
    assert (frame.encoding, frame.pixels.max()) == (f"mono{wide}", 2**wide - 2 ** (wide - bits))


def test_a_trigger_replaces_the_frame_rate():
    maker = Maker()
    opened(maker, trigger=True, rate=60.0)
    assert (maker.nodes.TriggerMode.value, maker.nodes.AcquisitionFrameRate.value) == ("On", 1)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"exposure_us": 1e5}, r"ExposureTime is 100000.0, allowed by the camera: 20.0 to 10000.0"),
        ({"format": "MJPG"}, "format is MJPG, allowed for GenICam: GREY, Y10, Y12"),
        ({"format": "Y10"}, "PixelFormat is Mono10, allowed by the camera: Mono8, Mono12"),
        ({"device": "genicam:x.cti#18"}, "no such device; available cameras: 17"),
    ],
)
def test_unsupported_settings_of_the_camera_are_reported_with_supported_ones(settings, words):
    maker = Maker()
    with pytest.raises(CameraError, match=words):
        opened(maker, **settings)
    assert maker.held == 0


def test_a_camera_that_goes_and_one_of_another_format():
    maker = Maker()
    maker.now = 0.0
    source = opened(maker)
    maker.buffers.append((np.zeros((48, 64), np.uint8), "YUV8", 0.0))
    with pytest.raises(ImageError, match="format is YUV8, allowed: Mono8"):
        source.read(Event())
    maker.unplugged = True
    with pytest.raises(CameraError, match="the camera is unplugged"):
        source.read(Event())


def test_without_harvesters_the_command_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "harvesters.core", None)
    with pytest.raises(CameraError, match=r"pip install '\.\[genicam\]'"):
        open_producer("x.cti")
