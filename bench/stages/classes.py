"""Types of parts: names, centres and angles.

Parts of config/parts.yaml are drawn by counting sub-pixels, apart, in random turns, in colour; what
they are is known. The types are those of the file: taught ones differ from them by 0.1 px.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from harness import Result, Table
from plate_core import config_path
from plate_core.rig import PartType, load_part_types
from plate_vision import calibrate_by_scale
from plate_vision.shapes import (
    find_patches,
    learn_plate,
    make_catalogue,
    recognise,
)

SIZE_PX = (640, 480)
COUNT = 20
"""Parts in an image."""

PLATE_LAB = (88.0, 0.0, 2.0)
NOISE = 2.0
"""Of each channel [grey levels]."""

FRAMES = 50

SCENES: dict[str, dict[str, float]] = {
    "1 px/mm": {},
    "0.7 px/mm": {"scale": 700.0},
    "2 px/mm": {"scale": 2000.0},
    "blur 1.5 px": {"blur": 1.5},
    "light from one side": {"slope": 0.25},
    "grey image": {"grey": 1.0},
}
"""What differs from 1 px/mm, a blur of 0.7 px, even light, and colour."""

SUB = 8
"""Sub-pixels along each side of a pixel."""

Pose = tuple[str, float, float, float]
"""Type, x, y [px], angle [rad]."""


def measure(quick: bool) -> Result:
    """Measure each scene."""
    cv2.setNumThreads(1)
    types = load_part_types(config_path("parts.yaml"))
    rows = []
    for number, (name, options) in enumerate(SCENES.items()):
        rows.append(_scene_row(types, name, options, number, 3 if quick else FRAMES))
    title = f"Types of {COUNT} parts in {SIZE_PX[0]} x {SIZE_PX[1]} px"
    columns = {
        "scene": "scene", "frames": "images",
        "wrong_percent": "wrong type [%]", "unknown_percent": "unknown [%]",
        "rms_px": "centre RMS [px]", "angle_deg": "angle RMS [deg]",
        "angle_max_deg": "angle, worst [deg]",
    }  # fmt: skip
    note = "Nine types, 12 to 26 mm, apart."
    return Result([Table("classes", title, columns, rows, note)])


def _scene_row(
    types: Mapping[str, PartType], scene: str, options: dict[str, float], seed: int, frames: int
) -> dict[str, Any]:
    """Return the row of a scene."""
    rng = np.random.default_rng(1000 + seed)
    calibration = calibrate_by_scale(options.get("scale", 1000.0))
    bare = learn_plate(np.stack([_drawn(types, [], options, rng) for _ in range(3)]))
    catalogue = make_catalogue(types)
    shots = []
    for _ in range(frames):
        poses = _laid(types, rng)
        image = _drawn(types, poses, options, rng)
        seen = recognise(image, find_patches(image, bare), catalogue, calibration)
        shots.append((poses, seen))
    return {"scene": scene, "frames": frames, **_scored(types, shots)}


def _laid(types: Mapping[str, PartType], rng: np.random.Generator) -> list[Pose]:
    """Return parts on a grid, each shifted and turned at random."""
    names = rng.choice([*types], COUNT).tolist()
    x, y = np.meshgrid(64 + 128 * np.arange(5), 60 + 120 * np.arange(4))
    place = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-4, 4, (COUNT, 2))
    angle = rng.uniform(-np.pi, np.pi, COUNT)
    return [
        (name, float(x), float(y), float(turn))
        for name, (x, y), turn in zip(names, place, angle, strict=True)
    ]


def _drawn(
    types: Mapping[str, PartType],
    poses: list[Pose],
    options: dict[str, float],
    rng: np.random.Generator,
) -> np.ndarray:
    """Return an image (H, W, 3), or (H, W) if it is grey, uint8."""
    width, height = SIZE_PX
    image = np.tile(_bgr(PLATE_LAB), (height, width, 1)).astype(np.float32)
    for name, x, y, angle in poses:
        part = types[name]
        c, s = np.cos(angle), np.sin(angle)
        turn = options.get("scale", 1000.0) * np.array([[c, -s], [-s, -c]])
        rings = [ring @ turn + (x, y) for ring in (part.polygon, *map(np.array, part.holes))]
        low = np.floor(rings[0].min(axis=0)).astype(int) - 1
        high = np.ceil(rings[0].max(axis=0)).astype(int) + 2
        fine = np.zeros(SUB * (high - low)[::-1], np.uint8)
        for level, ring in zip([255] + [0] * len(part.holes), rings, strict=True):
            corner = 16 * (SUB * (ring - low + 0.5) - 0.5)
            cv2.fillPoly(fine, [np.rint(corner).astype(np.int32)], level, shift=4)
        size = (int(high[0] - low[0]), int(high[1] - low[1]))
        cover = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)[:, :, None] / 255
        window = image[low[1] : high[1], low[0] : high[0]]
        window += cover * (_bgr(part.colour_lab or (0.0, 0.0, 0.0)) - window)
    blurred = cv2.GaussianBlur(image, (0, 0), options.get("blur", 0.7))
    lit = blurred * (1 - options.get("slope", 0.0) * np.linspace(0, 1, width)[:, None])
    noisy = lit + NOISE * rng.standard_normal(lit.shape)
    drawn = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY) if options.get("grey") else drawn


def _bgr(lab: tuple[float, float, float]) -> np.ndarray:
    return 255 * cv2.cvtColor(np.array([[lab]], np.float32), cv2.COLOR_Lab2BGR)[0, 0]


def _scored(
    types: Mapping[str, PartType], shots: list[tuple[list[Pose], np.ndarray]]
) -> dict[str, Any]:
    """Return how often names were wrong or not known, and the errors of place and angle."""
    wrong = unknown = total = 0
    places: list[float] = []
    turns: list[float] = []
    for poses, seen in shots:
        for name, x, y, angle in poses:
            total += 1
            gap = np.hypot(seen["x_px"] - x, seen["y_px"] - y)
            one = seen[np.argmin(gap)]
            if one["label"] != name:
                unknown += one["label"] in ("unknown", "group")
                wrong += one["label"] not in ("unknown", "group")
                continue
            places.append(float(np.min(gap)))
            symmetry = types[name].symmetry
            if symmetry:
                period = 360 / symmetry
                off = np.degrees(one["angle"] - angle) + period / 2
                turns.append(float(off % period - period / 2))
    return {
        "wrong_percent": 100 * wrong / total,
        "unknown_percent": 100 * unknown / total,
        "rms_px": float(np.sqrt(np.mean(np.square(places)))),
        "angle_deg": float(np.sqrt(np.mean(np.square(turns)))),
        "angle_max_deg": float(np.max(np.abs(turns))),
    }
