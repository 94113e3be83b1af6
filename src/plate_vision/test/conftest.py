"""Frames with known truth, drawn by counting sub-pixels: no code is shared with the simulator."""

import dataclasses
from functools import lru_cache

import numpy as np
import pytest

WIDTH_PX, HEIGHT_PX = 640, 480
CORNERS_PX = np.array([[21.01, 387.25], [617.82, 389.5], [614.33, 93.94], [26.86, 91.35]])
PLATE, ROOM = 220.0, 70.0
GREY_OF = {"black": 40.0, "grey": 130.0}
SUB = 10
"""Sub-pixels along each side of a pixel: areas are then right to a thousandth."""


def flat(u, v):
    return np.ones_like(u)


def slope(u, v):
    return 1 + 0.05 * u - 0.03 * v


def vignette(u, v):
    """Light falls by 15 % towards the corners, as the fourth power of a cosine: no quadratic."""
    return (1 + 0.042 * (u * u + v * v)) ** -2


SHADINGS = {"flat": flat, "slope": slope, "vignette": vignette}


@lru_cache
def plate_fraction(corners):
    """Share of every pixel that shows the plate."""
    fraction = np.zeros((HEIGHT_PX, WIDTH_PX))
    y, x = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    for dx in (-0.375, -0.125, 0.125, 0.375):
        for dy in (-0.375, -0.125, 0.125, 0.375):
            inside = np.ones_like(fraction, dtype=bool)
            for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
                inside &= (bx - ax) * (y + dy - ay) - (by - ay) * (x + dx - ax) <= 0
            fraction += inside
    return fraction / 16


def draw_frame(
    centre,
    label,
    rng,
    radius=8.0,
    noise=2.0,
    shading="slope",
    blur=0.0,
    corners=CORNERS_PX,
    extra=None,
    light=1.0,
):
    """Return a frame (H, W) uint8 with discs at `centre` (M, 2) [px] of classes `label`.

    `extra(image)` may draw more, before light and noise.
    """
    import cv2

    fraction = plate_fraction(tuple(map(tuple, np.asarray(corners).tolist())))
    image = ROOM + (PLATE - ROOM) * fraction
    offset = (np.arange(SUB) + 0.5) / SUB - 0.5
    reach = int(radius) + 3
    for (cx, cy), name in zip(np.asarray(centre).reshape(-1, 2), label, strict=True):
        xs = np.arange(max(round(cx) - reach, 0), min(round(cx) + reach + 1, WIDTH_PX))
        ys = np.arange(max(round(cy) - reach, 0), min(round(cy) + reach + 1, HEIGHT_PX))
        x = (xs[:, None] + offset).ravel()
        y = (ys[:, None] + offset).ravel()
        inside = (x - cx) ** 2 + (y[:, None] - cy) ** 2 <= radius**2
        cover = inside.reshape(len(ys), SUB, len(xs), SUB).mean(axis=(1, 3))
        window = image[ys[0] : ys[-1] + 1, xs[0] : xs[-1] + 1]
        window += cover * (GREY_OF[name] - window)
    if extra is not None:
        extra(image)
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    v, u = np.mgrid[-1 : 1 : HEIGHT_PX * 1j, -1 : 1 : WIDTH_PX * 1j]
    image = image * SHADINGS[shading](u, v) * light + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture
def draw():
    return draw_frame


@pytest.fixture
def corners_px():
    return CORNERS_PX.copy()


@pytest.fixture
def rng():
    return np.random.default_rng(20261121)


RAYS = 3
"""Rays of a traced picture along each side of a pixel."""


@lru_cache(maxsize=4)
def rays(matrix, distortion, fisheye=False):
    """Return x, y of the rays (x, y, 1) of all sub-pixels (rows, columns, 2) of a camera (3, 3) and
    lens (5,), or (4,) of a fisheye."""
    import cv2

    matrix, distortion = np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion)
    pixel = np.stack(np.meshgrid(np.arange(WIDTH_PX), np.arange(HEIGHT_PX)), axis=2)
    pixel = pixel.reshape(-1, 1, 2).astype(float)
    opencv = cv2.fisheye if fisheye else cv2
    ray = first = opencv.undistortPoints(pixel, matrix, distortion)[:, 0]
    for _ in range(0 if fisheye else 2):  # reduces its error of 0.05 px to 1e-6 px
        space = np.column_stack([ray, np.ones(len(ray))])
        seen = cv2.projectPoints(space, np.zeros(3), np.zeros(3), matrix, distortion)[0]
        ray = ray + first - cv2.undistortPoints(seen, matrix, distortion)[:, 0]
    ray = ray.reshape(HEIGHT_PX, WIDTH_PX, 2)
    step = (np.arange(RAYS) + 0.5) / RAYS - 0.5
    down, across = np.gradient(ray, axis=(0, 1))
    fine = (
        ray[:, None, :, None]
        + step[:, None, None, None] * down[:, None, :, None]
        + step[:, None] * across[:, None, :, None]
    )  # (rows, sub-rows, columns, sub-columns, 2)
    return fine.reshape(HEIGHT_PX * RAYS, WIDTH_PX * RAYS, 2).astype(np.float32)


class Scene:
    """Pictures of a flat print through a lens: every pixel is traced back to the print.

    Parameters
    ----------
    texture : (h, w) uint8
        The print; its row 0 is at the largest y.
    size : (float, float)
        Its length along x and y [m]; the origin is its centre.
    """

    def __init__(self, texture, size, matrix, distortion=None, fisheye=False):

        self.texture, self.size = texture, size
        self.matrix = np.asarray(matrix, float)
        bend = np.zeros(5) if distortion is None else np.asarray(distortion, float)
        self.ray = rays(self.matrix.tobytes(), bend.tobytes(), fisheye)

    def take(self, rotation, translation, rng, blur=0.7, noise=2.0, light=1.0):
        """Return the picture (H, W) uint8 of the print at a pose in the camera's frame [m]."""
        import cv2

        plane = np.column_stack([rotation[:, 0], rotation[:, 1], translation])
        rows, columns = self.texture.shape
        x, y = columns / self.size[0], rows / self.size[1]
        to_texel = np.array([[x, 0, (columns - 1) / 2], [0, -y, (rows - 1) / 2], [0, 0, 1]])
        texel = cv2.perspectiveTransform(self.ray, to_texel @ np.linalg.inv(plane))
        fine = cv2.remap(
            self.texture, texel, None, cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=int(ROOM),
        )  # fmt: skip
        image = cv2.resize(fine, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_AREA).astype(float)
        if blur:
            image = cv2.GaussianBlur(image, (0, 0), blur)
        v, u = np.mgrid[-1 : 1 : HEIGHT_PX * 1j, -1 : 1 : WIDTH_PX * 1j]
        image = image * slope(u, v) * light + noise * rng.standard_normal(image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture
def make_scene():
    return Scene


class MarkedPlate:
    """A plate with markers, and discs that ride on it, under the default rig's camera.

    Parameters
    ----------
    distortion : (5,), optional
        Of the lens.
    discs : sequence of (x, y, grey)
        Places on the plate [m] and grey levels of discs of the rig's radius.
    lean : (3,)
        Turn of the camera about its axes [rad], by which it is not where the rig file has it.
    """

    PER_M = 5000
    """Texels of the print for a metre."""

    CENTRES = ((-0.27, -0.12), (0.27, -0.12), (0.27, 0.12), (-0.27, 0.12))
    SIDE = 0.03

    def __init__(self, distortion=None, discs=(), lean=(0, 0, 0)):
        import cv2

        from plate_core import load_rig
        from plate_core.rig import Fiducials, camera_pose
        from plate_vision import Lens

        rig = load_rig()
        self.fiducials = Fiducials("4X4_50", self.SIDE, (0, 1, 2, 3), self.CENTRES)
        self.rig = dataclasses.replace(rig, fiducials=self.fiducials)
        self.matrix = rig.camera.lens.matrix
        self.lens = None if distortion is None else Lens(self.matrix, np.array(distortion))
        self.scene = Scene(self._print(discs), (0.6, 0.3), self.matrix, distortion)
        rotation, translation = camera_pose(rig)
        turn = cv2.Rodrigues(np.array(lean, float))[0]
        self.rotation, self.translation = turn @ rotation, turn @ translation

    def _print(self, discs):
        import cv2

        from plate_vision.camera import draw_marker

        texture = np.full((round(0.3 * self.PER_M), round(0.6 * self.PER_M)), PLATE, np.uint8)
        side = round(self.SIDE * self.PER_M)
        for number, (x, y) in enumerate(self.CENTRES):
            column = round((x + 0.3 - self.SIDE / 2) * self.PER_M)
            row = round((0.15 - y - self.SIDE / 2) * self.PER_M)
            marker = draw_marker("4X4_50", number, side)
            texture[row : row + side, column : column + side] = np.where(marker > 0, PLATE, 30)
        for x, y, grey in discs:
            # Of texels the centres have whole numbers; sixteenths are OpenCV's finest.
            middle = np.array([x + 0.3, 0.15 - y]) * self.PER_M - 0.5
            radius = round(16 * self.rig.parts.radius_m * self.PER_M)
            place = np.rint(16 * middle).astype(int).tolist()
            cv2.circle(texture, place, radius, float(grey), -1, cv2.LINE_AA, 4)
        return texture

    def take(self, pose, rng, **light):
        """Return the picture with the plate at a pose (3,) [m, m, rad]."""
        x, y, theta = pose
        cos, sin = np.cos(theta), np.sin(theta)
        turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        there = self.translation + self.rotation @ [x, y, 0]
        return self.scene.take(self.rotation @ turn, there, rng, **light)

    def seen_at(self, point):
        """Where OpenCV projects points (n, 2) [m, plate_home] to."""
        import cv2

        space = np.column_stack([point, np.zeros(len(point))])
        turn = cv2.Rodrigues(self.rotation)[0]
        distortion = np.zeros(5) if self.lens is None else self.lens.distortion
        return cv2.projectPoints(space, turn, self.translation, self.matrix, distortion)[0][:, 0]


@pytest.fixture
def make_plate():
    return MarkedPlate


TYPES_SUB = 8
"""Sub-pixels along each side of a pixel in `draw_types`."""


def draw_types(
    types, poses, rng, scale=1000.0, size_px=(640, 480), plate=(88.0, 0.0, 2.0), noise=2.0,
    blur=0.7, to_image=None,
):  # fmt: skip
    """Return a picture (H, W, 3) uint8 of parts of `types` at `poses`: name, x, y [m], angle [rad].

    Seen from above at `scale` [px/m], the origin in the middle, y up; or by `to_image`.
    """
    import cv2

    def bgr(lab):
        return 255 * cv2.cvtColor(np.float32([[lab]]), cv2.COLOR_Lab2BGR)[0, 0]

    width, height = size_px
    image = np.tile(bgr(plate), (height, width, 1)).astype(np.float32)
    for name, x, y, angle in poses:
        c, s = np.cos(angle), np.sin(angle)
        rings = [types[name].polygon, *map(np.array, types[name].holes)]
        rings = [ring @ np.array([[c, s], [-s, c]]) + (x, y) for ring in rings]
        if to_image is None:
            rings = [ring * (scale, -scale) + ((width - 1) / 2, (height - 1) / 2) for ring in rings]
        else:
            rings = [to_image(ring) for ring in rings]
        low = np.clip(np.floor(rings[0].min(axis=0)).astype(int) - 1, 0, size_px)
        high = np.clip(np.ceil(rings[0].max(axis=0)).astype(int) + 2, 0, size_px)
        if np.any(high <= low):
            continue
        fine = np.zeros(TYPES_SUB * (high - low)[::-1], np.uint8)
        for level, ring in zip([255] + [0] * len(rings), rings, strict=False):
            point = 16 * (TYPES_SUB * (ring - low + 0.5) - 0.5)
            cv2.fillPoly(fine, [np.rint(point).astype(np.int32)], level, shift=4)
        size = tuple((high - low).tolist())
        cover = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)[:, :, None] / 255
        window = image[low[1] : high[1], low[0] : high[0]]
        window += cover * (bgr(types[name].colour_lab) - window)
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    image = image + noise * rng.standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture(name="draw_types")
def draw_types_fixture():
    return draw_types


@pytest.fixture
def detector_time(clock, monkeypatch):
    """Time of the detectors that a test starts, which the test moves on."""
    from detector_graph import Graph  # only where there is ROS

    monkeypatch.setattr(Graph, "clock", clock)


@pytest.fixture
def graph(detector_time):
    """A detector with default parameters."""
    from detector_graph import Graph

    graph = Graph()
    yield graph
    graph.close()


@pytest.fixture
def marked_rig(tmp_path):
    """The default rig file with markers."""
    import yaml

    from plate_core import config_path

    data = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
    places = {f"marker_{k}": list(xy) for k, xy in enumerate(MarkedPlate.CENTRES)}
    data["fiducials"] = {"dictionary": "4X4_50", "side_m": MarkedPlate.SIDE, "centre_m": places}
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path
