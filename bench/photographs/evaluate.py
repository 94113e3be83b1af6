"""Evaluate detectors on the photographs of the tuning half, or of the held-out half.

cd bench && python -m photographs.evaluate [--held-out]
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np

from harness import paired, places, text_table
from photographs.fetch import is_there
from photographs.finders import make_finders
from photographs.pictures import HALVES, Photograph, load_photographs
from photographs.taught import teach_examples
from plate_core import piped

REACH = 0.5
"""Maximum distance of a detection from the centre of its part [radii of the part]. Each detection
is assigned to at most one part."""

ALIKE = 2.5
"""Maximum ratio of the radii of a detection and an ignored object. A detection at the object with a
larger ratio is not ignored."""

TAUGHT = "ours, taught"

MISSING = "cd bench && python -m photographs.fetch"

Score = dict[str, list[Any]]
"""Results of one detector in several pictures.

hit: Whether each part was detected.
touching, fresh: As `hit`, only for parts that touch others, and only for parts that were not used
as examples.
true: Whether each counted detection belongs to a part.
right: Whether the class of each detected part is correct. Parts without a class are omitted.
centre_px: Errors of centres.
angle_deg: Errors of angles, as `angle_errors` defines them.
"""

COLUMNS = {
    "method": "method", "pictures": "pictures", "parts": "parts", "found": "found",
    "false": "false", "recall": "recall [%]", "precision": "precision [%]",
    "touching": "recall, touching [%]", "centre_px": "centre RMS [px]",
    "angle_deg": "angle, median [deg]",
    "right": "class right [%]", "fresh": "recall, not shown [%]",
}  # fmt: skip
"""Headings of the columns, by key of a row."""


def percent(kept: list[bool]) -> float | None:
    """Return the percentage of True values in a list. None if the list is empty."""
    return 100 * sum(kept) / len(kept) if kept else None


def row_of(score: Score) -> dict[str, float | int | None]:
    """Return a score as the row of a table. Values without data are None."""
    centre_px, angle_deg = score["centre_px"], score["angle_deg"]
    return {
        "parts": len(score["hit"]), "found": sum(score["hit"]), "false": score["true"].count(False),
        "recall": percent(score["hit"]), "precision": percent(score["true"]),
        "touching": percent(score["touching"]), "right": percent(score["right"]),
        "fresh": percent(score["fresh"]),
        "centre_px": float(np.sqrt(np.mean(np.square(centre_px)))) if score["true"] else None,
        "angle_deg": float(np.median(angle_deg)) if angle_deg else None,
    }  # fmt: skip


def counts(found: np.ndarray, photograph: Photograph) -> np.ndarray:
    """Return whether each detection (n,) is counted as right or false. Detections outside the plate
    and detections of ignored objects are not counted."""
    kept = np.ones(len(found), bool)
    if photograph.plate is not None:
        corners = photograph.plate.astype(np.float32)
        inside = [
            cv2.pointPolygonTest(corners, (float(f["x_px"]), float(f["y_px"])), False) >= 0
            for f in found
        ]
        kept &= np.array(inside, bool)
    for x, y, radius in photograph.ignore:
        near = np.hypot(found["x_px"] - x, found["y_px"] - y) < radius
        size = found["radius_px"] / radius
        kept &= ~(near & (size < ALIKE) & (size > 1 / ALIKE))
    return kept


def score(found: np.ndarray, photograph: Photograph, shown: np.ndarray | None = None) -> Score:
    """Evaluate the detections (n,) FINDING in a photograph. `shown` (m,) bool are the parts used as
    examples."""
    parts = photograph.parts
    i, j, gap = paired(places(found), places(parts), REACH * parts["radius_px"])
    hit = np.isin(np.arange(len(parts)), j)
    label = found["label"][i]
    named = np.isin(label, parts["label"])
    false = np.count_nonzero(counts(np.delete(found, i), photograph))
    return {
        "hit": hit.tolist(), "true": [True] * len(i) + [False] * false,
        "touching": hit[parts["touching"]].tolist(),
        "fresh": (hit if shown is None else hit[~shown]).tolist(),
        "right": (label == parts["label"][j])[named].tolist(),
        "centre_px": gap.tolist(),
        "angle_deg": angle_errors(found[i], parts[j], bool(named.any())),
    }  # fmt: skip


def angle_errors(found: np.ndarray, parts: np.ndarray, directed: bool) -> list[float]:
    """Return the errors of the angles of detected parts (k,) [deg].

    The direction of angle 0 is arbitrary for each class. Therefore the mean error of the class is
    subtracted. Classes with fewer than two detected parts are omitted. If the detector does not
    distinguish the two ends of a part (`directed` is False), errors are modulo 180 degrees.
    """
    errors: list[float] = []
    for label in set(parts["label"]):
        those = (parts["label"] == label) & np.isfinite(parts["angle_deg"] + found["angle_deg"])
        symmetry = int(parts["symmetry"][those][0]) if those.any() else 0
        if np.count_nonzero(those) < 2 or symmetry == 0:
            continue
        order = symmetry if directed or symmetry % 2 == 0 else 2 * symmetry
        gap = order * np.radians(found["angle_deg"][those] - parts["angle_deg"][those])
        mean = np.angle(np.mean(np.exp(1j * gap)))
        off = np.angle(np.exp(1j * (gap - mean)))
        errors += np.degrees(np.abs(off) / order).tolist()
    return errors


def evaluate(photographs: Iterable[Photograph]) -> tuple[list[dict[str, Any]], list[str]]:
    """Run all detectors on photographs. Return one row of totals for each detector, and the
    messages on refused examples."""
    total: dict[str, Score] = {}
    pictures: Counter[str] = Counter()
    refused: list[str] = []
    for photograph in photographs:
        image = photograph.image()
        finders = make_finders()
        finders[TAUGHT], taught, problems = teach_examples(image, photograph.parts)
        refused += [f"{photograph.name}: {problem}" for problem in problems]
        for method, find in finders.items():
            shown = taught if method == TAUGHT else None
            for key, values in score(find(image), photograph, shown).items():
                total.setdefault(method, {}).setdefault(key, []).extend(values)
            pictures[method] += 1
    rows = [{"method": m, "pictures": pictures[m], **row_of(s)} for m, s in total.items()]
    return rows, refused


def load_half(half: str) -> tuple[list[Photograph], int]:
    """Return the photographs of a half whose files exist, and the number of missing files."""
    selected = [p for p in load_photographs() if p.half == half]
    present = [p for p in selected if is_there(p)]
    return present, len(selected) - len(present)


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--held-out",
        action="store_true",
        help="evaluate the photographs that were not used for tuning, and print only totals",
    )
    half = HALVES[parser.parse_args().held_out]
    present, missing = load_half(half)
    if missing:
        print(f"{missing} of {missing + len(present)} photographs are missing; first run {MISSING}")
    rows, refused = evaluate(present)
    print("\n".join(text_table({"title": half, "columns": COLUMNS, "rows": rows})))
    for line in refused if half == HALVES[0] else ():
        print(f"not taught: {line}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
