"""Sources of images: a fake V4L2 device, a film, a folder, a pipe; and their faults."""

import os
import threading
from pathlib import Path
from threading import Event

import cv2
import numpy as np
import pytest
from fake_camera import FakeCamera

from plate_core import PlateError
from plate_core.status import Level
from plate_vision.errors import ImageError
from plate_vision.image_sources import CameraError, Settings, Watch, listing, make_source, played
from plate_vision.image_sources import v4l2_device as v4l2
from plate_vision.image_sources.played import FilmSource, PipeSource
from plate_vision.image_sources.source import decode_frame
from plate_vision.image_sources.v4l2 import V4l2Source

GREY = {"GREY": {(64, 48): (30, 60)}}


class Opened:
    """A fake camera and the source that reads it; time is the test's."""

    def __init__(self, tmp_path, formats=None, controls=None, driver="fake", **settings):
        self.camera = FakeCamera(tmp_path / "video0", formats or GREY, controls, driver=driver)
        self.warnings, self.now = [], 1000.0
        size = {"width": 64, "height": 48}
        values = Settings(str(self.camera.path), **(size | settings))
        self.source = V4l2Source(
            values, self.warnings.append, self.camera.device, self.camera.capture, lambda: self.now
        )

    def opened(self):
        self.source.open()
        return self

    def frame(self, age_s=0.02, data=bytes(range(256)) * 12):
        self.camera.show(data, self.now - age_s)
        return self.source.read(Event())

    def value(self, number):
        return self.camera.controls[number][-1]


@pytest.fixture
def make(tmp_path):
    made = []

    def make(**words):
        made.append(Opened(tmp_path, **words))
        return made[-1]

    yield make
    for each in made:
        each.source.close()


def test_a_stamp_is_the_start_of_the_exposure(make):
    """By the kernel's stamp: itself, or less exposure and readout if it is the end."""
    opened = make(exposure_us=2000.0).opened()
    assert opened.frame().instant == pytest.approx(999.98)
    opened.source.close()
    end = make(exposure_us=2000.0, readout_us=5000.0)
    end.camera.flags = v4l2.MONOTONIC
    assert end.opened().frame().instant == pytest.approx(999.98 - 0.007)
    assert end.source.state()["stamp"] == "end of exposure"
    assert end.warnings == []


def test_the_exposure_in_force_counts_where_none_is_given(make):
    opened = make()
    opened.camera.flags = v4l2.MONOTONIC
    assert opened.opened().frame().instant == pytest.approx(999.98 - 0.025)
    assert opened.source.state()["exposure_us"] == "25000"


def test_uvcvideo_stamps_the_start_without_reporting_it(make):
    opened = make(driver="uvcvideo", exposure_us=2000.0).opened()
    assert opened.frame().instant == pytest.approx(999.98)
    assert opened.source.state()["stamp"] == "start of exposure"


@pytest.mark.parametrize("age_s", [1000.0, -3.0, 1000.0 - 1.7e9])
def test_stamps_of_another_clock_are_rejected_and_reported_once(make, age_s):
    """Such as 0, or the time of day."""
    opened = make(exposure_us=2000.0).opened()
    frames = [opened.frame(age_s) for _ in range(3)]
    assert frames[0].instant == pytest.approx(1000.0 - 0.002)
    (warning,) = opened.warnings
    assert "not from the kernel's monotonic clock" in warning
    assert "the arrival time of images is used" in warning


def test_automatic_controls_are_off_and_given_settings_are_applied(make):
    opened = make(exposure_us=5000.0, gain=40, white_balance_k=5000).opened()
    assert opened.value(v4l2.AUTO_EXPOSURE) == v4l2.MANUAL
    assert opened.value(v4l2.EXPOSURE) == 50
    assert opened.value(v4l2.GAIN) == 40
    assert opened.value(v4l2.WHITE_BALANCE) == 5000
    off = (v4l2.AUTO_PRIORITY, v4l2.AUTO_WHITE_BALANCE, v4l2.AUTO_FOCUS)
    assert [opened.value(number) for number in off] == [0, 0, 0]
    opened.source.close()
    chosen = make(auto_exposure=True, gain=0).opened()
    assert chosen.value(v4l2.AUTO_EXPOSURE) == 3
    assert chosen.value(v4l2.GAIN) == 0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"exposure_us": 1e6}, "exposure_us is 1e.06, allowed by Fake camera: 300 to 204700"),
        ({"gain": 500}, "gain is 500, allowed by Fake camera: 0 to 100"),
        ({"focus": 5}, "focus is 5, but the device has no such control; v4l2-ctl -d .* --list-c"),
        ({"auto_gain": True}, "auto_gain is true, but the device has no such control"),
        ({"format": "YUYV"}, "format is YUYV, allowed by Fake camera: GREY"),
        ({"width": 65}, "size is 65 x 48 px, allowed by Fake camera: GREY 64x48"),
        ({"rate": 5.0}, "rate is 5 images per second at 64 x 48 px, allowed .*: at least 30 wi"),
        ({"rate": 90.0}, "rate is 90 images per second at 64 x 48 px, allowed .*: 60 with GREY"),
    ],
)
def test_unsupported_settings_of_the_device_are_reported_with_supported_ones(make, settings, words):
    refused = make(**settings)
    with pytest.raises(CameraError, match=words):
        refused.opened()
    opened = map(os.path.realpath, Path("/proc/self/fd").iterdir())
    assert os.path.realpath(refused.camera.path) not in opened


def test_a_change_that_is_refused_changes_nothing(make):
    opened = make(gain=40).opened()
    with pytest.raises(CameraError, match="gain is 101"):
        opened.source.change(Settings(str(opened.camera.path), gain=101))
    assert opened.value(v4l2.GAIN) == 40
    opened.source.change(Settings(str(opened.camera.path), gain=10))
    assert opened.value(v4l2.GAIN) == 10


@pytest.mark.parametrize(
    ("size_px", "rate", "form"),
    [((640, 480), 0.0, "YUYV"), ((640, 480), 60.0, "MJPG"), ((1280, 720), 30.0, "MJPG")],
)
def test_the_format_is_the_first_with_size_and_rate(tmp_path, size_px, rate, form):
    camera = FakeCamera(tmp_path / "video0")
    width, height = size_px
    settings = Settings(str(camera.path), width, height, rate)
    source = V4l2Source(settings, pytest.fail, camera.device, camera.capture)
    source.open()
    assert camera.fourcc == v4l2.fourcc(form)
    assert camera.size_px == [width, height]
    source.close()


def test_each_fault_of_a_device_has_its_sentence(make, tmp_path):
    used = make()
    used.camera.busy = True
    with pytest.raises(
        CameraError, match=r"used by another program; end it \(fuser -v .* shows its name\)"
    ):
        used.opened()
    assert used.camera.opened == 0  # OpenCV would wait 10 s
    other = make()
    other.camera.gives_px = (32, 24)
    with pytest.raises(CameraError, match=r"32 x 24 px of GREY, requested: 64 x 48 px of GREY"):
        other.opened()
    with pytest.raises(CameraError, match="no such device; check that it is plugged in"):
        v4l2.V4l2Device(str(tmp_path / "video7"))
    with pytest.raises(CameraError, match="is not a video device"):
        v4l2.V4l2Device(__file__)


def test_no_permission_names_the_group(monkeypatch):
    def refuse(path, flags):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("os.open", refuse)
    with pytest.raises(CameraError, match=r"no permission. Join the group video \(sudo usermod"):
        v4l2.V4l2Device("/dev/video0")


def test_an_unplugged_camera_is_named_and_may_come_back(make):
    opened = make().opened()
    opened.frame()
    opened.camera.unplug()
    with pytest.raises(CameraError, match="is unplugged; images continue when it is back"):
        opened.source.read(Event())
    opened.source.close()
    with pytest.raises(v4l2.AbsentError):
        opened.source.open()
    opened.camera.plug()
    opened.source.open()
    assert opened.frame().pixels.shape == (48, 64)


@pytest.mark.parametrize(
    ("form", "pixels", "encoding", "value"),
    [
        ("GREY", np.full((4, 6), 7, np.uint8), "mono8", 7),
        ("Y10", np.full((4, 6), 1023, "<u2"), "mono16", 1023 << 6),
        ("Y12", np.full((4, 6), 4095, "<u2"), "mono16", 4095 << 4),
        ("YUYV", np.full((4, 6, 2), 9, np.uint8), "yuv422_yuy2", 9),
        ("UYVY", np.full((4, 6, 2), 9, np.uint8), "yuv422", 9),
    ],
)
def test_frames_of_every_format(form, pixels, encoding, value):
    data = np.frombuffer(pixels.tobytes(), np.uint8)[None]
    found, name = decode_frame(data, form, (6, 4))
    assert name == encoding
    assert found.shape == pixels.shape
    assert np.all(found == value)
    with pytest.raises(ImageError, match="bytes, allowed"):
        decode_frame(data[:, :-1], form, (6, 4))


def test_jpeg_frames(make):
    picture = np.full((48, 64, 3), 90, np.uint8)
    data = np.frombuffer(cv2.imencode(".jpg", picture)[1].tobytes(), np.uint8)
    found, name = decode_frame(data, "MJPG", (64, 48))
    assert (found.shape, name) == ((48, 64, 3), "bgr8")
    with pytest.raises(ImageError, match="size is 64 x 48 px, allowed: 32 x 24"):
        decode_frame(data, "MJPG", (32, 24))
    with pytest.raises(ImageError, match=r"200 bytes is incomplete, allowed: a complete file"):
        decode_frame(data[:200], "MJPG", (64, 48))


def test_the_list_shows_formats_sizes_rates_and_controls(tmp_path, monkeypatch):
    camera = FakeCamera(tmp_path / "video0")
    monkeypatch.setattr("plate_vision.image_sources.sources.V4l2Device", camera.device)
    lines = list(listing([str(camera.path)]))
    assert lines[0].endswith("video0: Fake camera (driver fake)")
    assert "  MJPG: pixels as MJPG" in lines
    assert "    1280x720 px: 30, 60 images per second" in lines
    assert "    Gain: 20, allowed: 0 to 100, default: 20" in lines
    menu = "(0: mode 0, 1: mode 1, 3: mode 3)"
    assert f"    Exposure, Auto: 3, allowed: 0 to 3, default: 3 {menu}" in lines
    assert "no video devices" in next(listing([]))


def test_a_folder_and_a_film_play_at_their_rate(tmp_path):
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full((48, 64, 3), 50 * k, np.uint8))
    source = FilmSource(Settings(str(tmp_path), rate=50.0), pytest.fail)
    source.open()
    frames = [source.read(Event()) for _ in range(4)]
    assert frames[3] is None
    assert [frame.name for frame in frames[:3]] == ["0.png", "1.png", "2.png"]
    assert [int(frame.pixels[0, 0, 0]) for frame in frames[:3]] == [0, 50, 100]
    source.open()
    assert source.read(Event()).name == "0.png"


@pytest.mark.parametrize(
    ("rate", "used"), [(0.99, 30.0), (1.0, 1.0), (240.0, 240.0), (1e6, 30.0), (np.nan, 30.0)]
)
def test_an_impossible_rate_in_a_film_is_ignored(monkeypatch, rate, used):
    class Film:
        is_film, names = True, ()

        def __next__(self):
            return "frame", np.zeros((48, 64, 3), np.uint8)

    Film.rate = rate
    monkeypatch.setattr(played, "read_pictures", lambda path, warn: Film())
    now = [0.0]

    class Waited(Event):
        def wait(self, timeout=None):
            now[0] += timeout
            return False

    source = FilmSource(Settings("film.avi"), pytest.fail, lambda: now[0])
    source.open()
    first, second = (source.read(Waited()).instant for _ in range(2))
    assert second - first == pytest.approx(1 / used)


def test_stamps_of_a_film_are_regular_unless_it_cannot_keep_up(tmp_path):
    path = tmp_path / "film.avi"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20, (64, 48))
    for k in range(6):
        film.write(np.full((48, 64, 3), 20 * k, np.uint8))
    film.release()
    now = [100.0]

    class Waited(Event):
        def wait(self, timeout=None):
            now[0] += timeout
            return False

    source = FilmSource(Settings(str(path)), pytest.fail, lambda: now[0])
    source.open()
    stop = Waited()
    stamps = []
    for late in (0.0, 0.0, 0.01, 0.0, 0.2, 0.0):
        now[0] += late
        stamps.append(source.read(stop).instant)
    assert stamps == pytest.approx([100.0, 100.05, 100.1, 100.15, 100.35, 100.4])
    assert source.read(stop) is None


def test_a_pipe_of_raw_frames(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    settings = Settings(str(path), 64, 48, exposure_us=2000.0, readout_us=1000.0)
    source = PipeSource(settings, pytest.fail, lambda: 5.0)
    source.open()

    def write():
        with path.open("wb") as file:
            for k in range(3):
                file.write(bytes([k]) * 64 * 48)

    writer = threading.Thread(target=write)
    writer.start()
    frames = [source.read(Event()) for _ in range(3)]
    writer.join()
    assert [int(frame.pixels.max()) for frame in frames] == [0, 1, 2]
    assert frames[0].instant == pytest.approx(5.0 - 0.003)
    with pytest.raises(CameraError, match="no program writes to the pipe"):
        source.read(Event())
    assert source.state()["exposure_us"] == "2000"
    source.change(Settings(str(path), 64, 48, exposure_us=4000.0, readout_us=1000.0))
    assert source.state()["exposure_us"] == "4000"
    with path.open("wb") as file:
        file.write(bytes(64 * 48))
        file.flush()
        assert source.read(Event()).instant == pytest.approx(5.0 - 0.005)
    source.close()
    with pytest.raises(CameraError, match="format is MJPG, allowed for a pipe: GREY"):
        PipeSource(Settings(str(path), format="MJPG"), pytest.fail).open()


def test_reading_a_pipe_ends_when_it_must(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    source = PipeSource(Settings(str(path), 64, 48), pytest.fail)
    source.open()
    stop = Event()
    stop.set()
    assert source.read(stop) is None
    source.close()


@pytest.mark.parametrize(
    ("name", "kind"),
    [("0", "V4l2Source"), ("/dev/v4l/by-id/x", "V4l2Source"), ("genicam:a.cti", "GenicamSource")],
)
def test_names_of_devices(name, kind):
    assert type(make_source(Settings(name), pytest.fail)).__name__ == kind


@pytest.mark.parametrize("name", ["", "nowhere.mp4"])
def test_an_invalid_device_name_is_refused_with_the_allowed_names(name):
    with pytest.raises(PlateError, match=r"allowed: a number or path of a video device"):
        make_source(Settings(name), pytest.fail)


class Seen:
    """A watch that is shown images of a regular camera."""

    def __init__(self):
        self.watch, self.k = Watch(), 0
        self.rng = np.random.default_rng(0)

    def show(self, count, pixels=None, age_s=0.02, skipped=0):
        self.k += skipped
        for _ in range(count):
            image = self.rng.integers(100, 120, (70, 70), np.uint8) if pixels is None else pixels
            self.watch.add(image, self.k / 30, self.k / 30 + age_s)
            self.k += 1
        return self

    def said(self, live=True):
        return [(found.level, found.message) for found in self.watch.findings(live)]


def test_a_regular_stream_causes_no_warning():
    assert Seen().show(100).said() == []


def test_lost_and_late_images_are_counted():
    seen = Seen().show(30).show(20, skipped=2)
    assert seen.watch.lost == 2
    assert seen.said()[0][0] == Level.WARN
    assert "2 of 52 images are lost" in seen.said()[0][1]
    late = Seen().show(10, age_s=0.3)
    assert "10 of 10 images arrive more than 0.1 s after" in late.said()[0][1]


def test_no_image_of_an_irregular_camera_counts_as_lost():
    watch = Watch()
    for instant in np.cumsum(np.random.default_rng(0).uniform(0.02, 0.2, 100)):
        watch.add(np.full((7, 7), 100, np.uint8), float(instant), float(instant))
    assert watch.lost == 0


def test_black_and_frozen_pictures():
    black = Seen().show(20, np.full((70, 70), 9, np.uint8))
    ((level, text),) = black.said(live=False)
    assert level == Level.ERROR
    assert "the image is black; remove the lens cap" in text
    assert black.show(1).said() == []
    still = np.random.default_rng(0).integers(0, 255, (70, 70, 3), np.uint8)
    assert Seen().show(10, still).said() == []
    ((level, text),) = Seen().show(20, still).said()
    assert level == Level.ERROR
    assert "is frozen: the last 20 images are equal" in text
    assert Seen().show(20, still).said(live=False) == []


def test_a_black_yuyv_image_has_grey_colours():
    image = np.full((70, 70, 2), 128, np.uint8)
    image[..., 0] = 8
    assert "black" in Seen().show(20, image).said()[0][1]
