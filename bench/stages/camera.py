"""The simulated camera: time for one image, by what is drawn, and the error of the centres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from harness import Result, Table, race
from plate_core import Rig, load_rig
from plate_core.rig import Lens, PartType, camera_pose
from plate_sim import Camera, part_greys

PARTS = 10
LIMIT_MS = 1.0
"""An image of 640 x 480 with 10 parts is to take no longer."""

STRONG = (-0.3, 0.1, 1e-3, -1e-3, 0.0)
"""k1, k2, p1, p2, k3 of a strong lens."""

SAMPLES = 9
"""Poses and positions over the exposure."""

SQUARE = 0.007 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])


def measure(quick: bool) -> Result:
    """Time every option with and without distortion; compare discs with OpenCV's projection."""
    rig = load_rig()
    bent = with_lens(rig, STRONG)
    contestants = {
        (lens, option): call
        for lens, seen in (("none", rig), ("strong", bent))
        for option, call in options(seen).items()
    }
    named = {f"{lens}: {option}": call for (lens, option), call in contestants.items()}
    times = race(named, 3.0 if quick else 12.0)
    rows = [
        {
            "option": option,
            "none": 1e3 * times.median(f"none: {option}"),
            "strong": 1e3 * times.median(f"strong: {option}"),
        }
        for option in options(rig)
    ]
    worst = 1e3 * max(times.median(name) for name in named)
    gaps = {name: centre_gaps(seen) for name, seen in (("none", rig), ("strong", bent))}
    errors = [
        {"lens": name, "rms": float(np.sqrt(np.mean(gap**2))), "max": float(gap.max())}
        for name, gap in gaps.items()
    ]
    size = f"{rig.camera.width_px} x {rig.camera.height_px}"
    return Result(
        [
            Table(
                "camera",
                f"Median time of one image, {size} px, {PARTS} parts, with noise",
                {"option": "drawn", "none": "no distortion [ms]", "strong": "k1 = -0.3 [ms]"},
                rows,
                "One core. Poses and positions over the exposure: 9 of each, the plate displaced "
                "by up to 11 mm and moving by 1 mm.",
            ),
            Table(
                "camera_error",
                "Centre of a disc's image against OpenCV's projection of its outline",
                {"lens": "distortion", "rms": "rms [px]", "max": "largest [px]"},
                errors,
            ),
        ],
        [
            f"slowest option {worst:.2f} ms an image, limit {LIMIT_MS:g} ms",
            f"largest error of a disc's centre {max(gap.max() for gap in gaps.values()):.3f} px",
        ],
    )


def with_lens(rig: Rig, distortion: tuple[float, float, float, float, float]) -> Rig:
    """Return a rig whose camera has a lens that bends, in the same place."""
    assert rig.camera.lens is not None
    lens = Lens(rig.camera.lens.focal_px, rig.camera.lens.centre_px, distortion)
    corners = tuple((u, v) for u, v in lens.bend(np.array(rig.camera.corners_px)).tolist())
    return replace(rig, camera=replace(rig.camera, lens=lens, corners_px=corners))


def options(rig: Rig) -> dict[str, Callable[[], object]]:
    """Return what is timed: ready calls that draw one image."""
    camera = Camera(rig)
    rng = np.random.default_rng(1)
    position = rng.uniform(-0.9, 0.9, (PARTS, 2)) * rig.plate.half
    velocity = rng.normal(0, 0.5, (PARTS, 2))
    grey = part_greys(["black", "grey"] * (PARTS // 2))
    angle = rng.uniform(-3, 3, PARTS)
    share = np.linspace(0, 1, SAMPLES)[:, None]
    poses = np.array([0.01, -0.004, 0.005]) + share * np.array([0.001, -0.0005, 0.001])
    path = position + rig.camera.exposure_s * share[:, None] * velocity
    squares = [PartType("square", outline=tuple(map(tuple, SQUARE.tolist())))] * PARTS
    draws: dict[str, Callable[[], object]] = {
        "no parts": lambda: camera.render(np.zeros((0, 2)), np.zeros(0), rng),
        "parts at rest": lambda: camera.render(position, grey, rng),
        "moving parts": lambda: camera.render(position, grey, rng, velocity),
        "moving parts, marks": lambda: camera.render(position, grey, rng, velocity, angle=angle),
        "moving squares": lambda: camera.render(
            position, grey, rng, velocity, angle=angle, types=squares
        ),
        "displaced plate": lambda: camera.render(position, grey, rng, velocity, poses[0]),
        "vibrating plate": lambda: camera.render(path, grey, rng, pose=poses),
        "all: vibrating plate, squares": lambda: camera.render(
            path, grey, rng, pose=poses, angle=angle, types=squares
        ),
    }
    return draws


def centre_gaps(rig: Rig) -> np.ndarray:
    """Return distances (n,) [px] between drawn discs' centres and OpenCV's projection."""
    lens = rig.camera.lens
    assert lens is not None
    rotation, translation = camera_pose(rig)
    x, y = np.meshgrid(np.linspace(-0.26, 0.26, 9), np.linspace(-0.12, 0.12, 5))
    places = np.stack([x.ravel(), y.ravel()], axis=1)
    places += np.random.default_rng(2).uniform(-1e-3, 1e-3, places.shape)
    camera = Camera(rig, 0.0)
    none = camera.render(np.zeros((0, 2)), np.zeros(0), np.random.default_rng(0)).astype(float)
    grey = part_greys(["black"] * len(places))
    image = camera.render(places, grey, np.random.default_rng(0)).astype(float)
    share = 1 - image / none
    share[share < 0.02] = 0
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ring = rig.parts.radius_m * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    gaps = []
    for place in places:
        outline = cv2.projectPoints(
            ring + np.append(place, 0.0), cv2.Rodrigues(rotation)[0], translation, lens.matrix,
            np.array(lens.distortion),
        )[0][:, 0]  # fmt: skip
        a = outline - outline[0]
        b = np.roll(a, -1, axis=0)
        area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        centre = outline[0] + (a + b).T @ area / (3 * area.sum())
        u, v = np.rint(centre).astype(int)
        window = np.s_[v - 13 : v + 14, u - 13 : u + 14]
        rows, columns = np.mgrid[window]
        mass = share[window]
        drawn = np.array([np.sum(mass * columns), np.sum(mass * rows)]) / mass.sum()
        gaps.append(float(np.hypot(*(drawn - centre))))
    return np.array(gaps)
