"""Types of parts: errors of names, centres and angles.

Parts of config/parts.yaml are drawn in colour by counting sub-pixels, apart from each other and at
random angles. The detector gets the types of the file. Taught types differ from those of the file
by 0.1 px.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from harness import Result, Table, places
from plate_core import config_path
from plate_core.rig import PartType, load_part_types
from plate_vision import calibrate_by_scale
from plate_vision.shapes import (
    find_patches,
    learn_plate,
    make_catalogue,
    recognise,
)
from stages.hostile import NOISE, SCALE_PX_M, SIZE_PX, Part, bgr, cover, window

COUNT = 20
"""Number of parts in an image."""

PLATE_LAB = (88.0, 0.0, 2.0)

FRAMES = 50

SCENES: dict[str, dict[str, float]] = {
    "1 px/mm": {},
    "0.7 px/mm": {"scale": 700.0},
    "2 px/mm": {"scale": 2000.0},
    "blur 1.5 px": {"blur": 1.5},
    "light from one side": {"slope": 0.25},
    "grey image": {"grey": 1.0},
}
"""Differences of each scene from 1 px/mm, a blur of 0.7 px, even light, and colour."""


def measure(quick: bool) -> Result:
    """Measure each scene."""
    cv2.setNumThreads(1)
    types = load_part_types(config_path("parts.yaml"))
    rows = []
    for number, (name, options) in enumerate(SCENES.items()):
        rows.append(_scene_row(types, name, options, number, 3 if quick else FRAMES))
    return Result([Table.of("classes", rows, parts=COUNT, size=SIZE_PX)])


def _scene_row(
    types: Mapping[str, PartType], scene: str, options: dict[str, float], seed: int, frames: int
) -> dict[str, Any]:
    """Return the row of a scene: numbers of wrong and unknown names, and errors of positions and
    angles."""
    rng, scale = np.random.default_rng(1000 + seed), options.get("scale", SCALE_PX_M)
    bare = learn_plate(np.stack([_drawn([], options, rng) for _ in range(3)]))
    catalogue, calibration = make_catalogue(types), calibrate_by_scale(scale)
    wrong = unknown = 0
    gaps: list[float] = []
    turns: list[float] = []
    for _ in range(frames):
        parts = _laid(types, scale, rng)
        image = _drawn(parts, options, rng)
        seen = recognise(image, find_patches(image, bare), catalogue, calibration)
        for part in parts:
            gap = np.linalg.norm(places(seen) - part.centre_px, axis=1)
            one, symmetry = seen[np.argmin(gap)], part.kind.symmetry
            if one["label"] != part.kind.name:
                unknown += one["label"] in ("unknown", "group")
                wrong += one["label"] not in ("unknown", "group")
                continue
            gaps.append(float(np.min(gap)))
            if symmetry:
                period = 360 / symmetry
                off = np.degrees(one["angle"] - part.angle_rad) + period / 2
                turns.append(float(off % period - period / 2))
    return {
        "scene": scene, "frames": frames,
        "wrong_percent": 100 * wrong / (COUNT * frames),
        "unknown_percent": 100 * unknown / (COUNT * frames),
        "rms_px": float(np.sqrt(np.mean(np.square(gaps)))),
        "angle_deg": float(np.sqrt(np.mean(np.square(turns)))),
        "angle_max_deg": float(np.max(np.abs(turns))),
    }  # fmt: skip


def _laid(types: Mapping[str, PartType], scale: float, rng: np.random.Generator) -> list[Part]:
    """Return parts on a grid, each with a random shift and angle."""
    names = rng.choice([*types], COUNT).tolist()
    x, y = np.meshgrid(64 + 128 * np.arange(5), 60 + 120 * np.arange(4))
    place = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-4, 4, (COUNT, 2))
    angle = rng.uniform(-np.pi, np.pi, COUNT).tolist()
    poses = zip(names, place, angle, strict=True)
    return [Part(types[name], centre, turn, scale) for name, centre, turn in poses]


def _drawn(parts: list[Part], options: dict[str, float], rng: np.random.Generator) -> np.ndarray:
    """Return an image (H, W, 3), or (H, W) if it is grey, uint8."""
    width, height = SIZE_PX
    image = np.tile(bgr(np.array(PLATE_LAB)), (height, width, 1))
    for part in parts:
        low, side = window(part)
        here = image[low[1] : low[1] + side, low[0] : low[0] + side]
        colour = bgr(np.array(part.kind.colour_lab or (0.0, 0.0, 0.0)))
        here += cover(part, low, side)[:, :, None] * (colour - here)
    blurred = cv2.GaussianBlur(image, (0, 0), options.get("blur", 0.7))
    lit = blurred * (1 - options.get("slope", 0.0) * np.linspace(0, 1, width)[:, None])
    noisy = lit + NOISE * rng.standard_normal(lit.shape)
    drawn = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY) if options.get("grey") else drawn
