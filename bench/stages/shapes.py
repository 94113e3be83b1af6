"""Parts of any outline in difficult scenes: recall, precision, centres, time.

The detector gets no information on the parts, but images of the bare plate. The scenes are from
`hostile`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np

from harness import Result, Table, paired, places, timed
from plate_vision import calibrate_by_scale, find_types
from plate_vision.shapes import GROUP, UNKNOWN, Patch, find_patches, make_catalogue
from stages.hostile import (
    PARTS,
    SCALE_PX_M,
    SIZE_PX,
    Kind,
    Part,
    all_types,
    kinds,
    scenes,
    seen_whole,
)

SCENES, QUICK_SCENES = 20, 1
"""Number of scenes of each kind."""

FIRST = 100
"""Number of the first measured scene. Scenes with smaller numbers are for tuning."""

REACH = 0.5
"""Maximum distance of a detection from a part's true centre [radii of the disc of equal area]."""

GOAL_PERCENT = (98, 99)
"""Required recall and precision [%]."""

OURS, TAUGHT = METHODS = "find_patches", "find_types"

SEEN = np.dtype([("x_px", "f8"), ("y_px", "f8"), ("label", "U32"), ("whole", "?")])
"""Evaluated fields of a detection. The label is empty if the method does not use types."""


Tally = dict[str, list[Any]]
"""Results of several scenes. Only parts that are completely in the image are evaluated.

hit: Whether each of these parts was detected.
true: Whether each evaluated detection is such a part.
label, name, gap_px: Detected type, true type and position error of each detected part.
"""


def add(tally: Tally, seen: np.ndarray, parts: list[Part]) -> None:
    """Add one scene with its detections (n,) SEEN and parts."""
    seen = seen[seen["label"] != GROUP]
    centres = np.array([part.middle_px for part in parts]).reshape(-1, 2)
    reach = REACH * np.array([part.radius_px for part in parts])
    i, j, gaps = paired(places(seen), centres, reach)
    inside = np.array([seen_whole(part) for part in parts], bool)
    hit = np.isin(np.arange(len(parts)), j)[inside]
    whole = inside[j]
    tally["hit"] += hit.tolist()
    tally["true"] += hit[hit].tolist() + [False] * int(np.sum(np.delete(seen["whole"], i)))
    tally["label"] += seen["label"][i][whole].tolist()
    tally["name"] += [parts[k].kind.name for k in j[whole]]
    tally["gap_px"] += gaps[whole].tolist()


def measure(quick: bool) -> Result:
    """Measure all kinds of scenes."""
    cv2.setNumThreads(1)
    count = QUICK_SCENES if quick else SCENES
    rows = [row for kind in kinds() for row in kind_rows(kind, count)]
    sentences = [sentence(rows, name) for name in METHODS]
    return Result([Table.of("shapes", rows, parts=PARTS, size=SIZE_PX)], sentences)


def sentence(rows: list[dict[str, Any]], method: str) -> str:
    """Return a sentence on the number of kinds of scenes in which a method reaches the goal, and on
    its time."""
    own = [row for row in rows if row["method"] == method]
    below = [
        f"{row['kind']} ({row['recall_percent']:.1f}, {row['precision_percent']:.1f})"
        for row in own
        if row["recall_percent"] < GOAL_PERCENT[0] or row["precision_percent"] < GOAL_PERCENT[1]
    ]
    ms = [row["ms"] for row in own]
    return (
        f"{method}: recall {GOAL_PERCENT[0]} % and precision {GOAL_PERCENT[1]} % in "
        f"{len(own) - len(below)} of {len(own)} kinds of scenes, {float(np.median(ms)):.1f} ms for "
        f"{PARTS} parts, median of the kinds; not: {', '.join(below) or 'none'}"
    )


def kind_rows(kind: Kind, count: int) -> list[dict[str, Any]]:
    """Measure the project's detector with and without types, in scenes of one kind."""
    catalogue, calibration = make_catalogue(all_types()), calibrate_by_scale(SCALE_PX_M)
    tallies: dict[str, Tally] = {name: defaultdict(list) for name in METHODS}
    times: dict[str, list[float]] = {name: [] for name in tallies}
    for learned, image, parts in scenes(kind, range(FIRST, FIRST + count)):
        background = learned.followed(image)
        finders: dict[str, Callable[[], Any]] = {
            OURS: partial(find_patches, image, background),
            TAUGHT: partial(find_types, image, catalogue, background, calibration),
        }
        for name, find in finders.items():
            if not times[name]:
                find()  # the first call is a warm-up
            found, seconds = timed(find)
            times[name].append(seconds)
            add(tallies[name], as_seen(found), parts)
    rows = []
    for name, tally in tallies.items():
        gaps = np.array(tally["gap_px"])
        unlike = [a for a, b in zip(tally["label"], tally["name"], strict=True) if a != b]
        rows.append({
            "kind": kind.name, "method": name, "true": len(tally["hit"]),
            "recall_percent": 100 * sum(tally["hit"]) / max(len(tally["hit"]), 1),
            "precision_percent": 100 * sum(tally["true"]) / max(len(tally["true"]), 1),
            "wrong": len(unlike) - unlike.count(UNKNOWN) if name == TAUGHT else None,
            "unknown": unlike.count(UNKNOWN) if name == TAUGHT else None,
            "rms_px": float(np.sqrt(np.mean(gaps**2))) if len(gaps) else None,
            "ms": 1e3 * float(np.median(times[name])),
        })  # fmt: skip
    return rows


def as_seen(found: list[Patch] | np.ndarray) -> np.ndarray:
    """Return patches converted to (n,) SEEN. Other detections are returned unchanged."""
    if isinstance(found, np.ndarray):
        return found
    return np.array([(*p.centre_px, GROUP if p.group else "", p.whole) for p in found], SEEN)
