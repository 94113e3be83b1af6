"""Judge detectors on the photographs of one half.

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
"""A part is found by what is nearer to its centre than so many of its radii, one to one."""

ALIKE = 2.5
"""What is ignored is only what has its size, up to this factor."""

TAUGHT = "ours, taught"

MISSING = "cd bench && python -m photographs.fetch"

Score = dict[str, list[Any]]
"""What one detector found in some pictures.

`hit`: of each part whether it was found; `touching`, `fresh`: the same of parts that touch others,
and of those that were not shown as examples. `true`: of each thing found that counts whether it is
a part. `right`: of each found part that got a class whether that is its own. `centre_px` and
`angle_deg`: errors of centres, and of angles, modulo symmetry, apart from one zero for each class
of a picture.
"""

COLUMNS = {
    "method": "method", "pictures": "pictures", "parts": "parts", "found": "found",
    "false": "false", "recall": "recall [%]", "precision": "precision [%]",
    "touching": "recall, touching [%]", "centre_px": "centre RMS [px]",
    "angle_deg": "angle, median [deg]",
    "right": "class right [%]", "fresh": "recall, not shown [%]",
}  # fmt: skip
"""Keys of rows and their headings."""


def percent(kept: list[bool]) -> float | None:
    """Return how many hold [%], None of nothing."""
    return 100 * sum(kept) / len(kept) if kept else None


def row_of(score: Score) -> dict[str, float | int | None]:
    """Return a score as the row of a table."""
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
    """Tell (n,) of what was found whether it counts: not outside the plate, not to be ignored."""
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
    """Judge what was found (n,) FOUND in a photograph; `shown` (m,) bool are taught examples."""
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
    """Return errors of the angles [deg] of parts (k,) that were found (k,).

    Nobody says where a class has its zero: for each class that is found twice or more, the mean
    difference is taken off. Where ends are not told apart (`directed` is False), half a turn is
    none.
    """
    errors: list[float] = []
    for label in set(parts["label"]):
        those = (parts["label"] == label) & np.isfinite(parts["angle_deg"] + found["angle_deg"])
        symmetry = int(parts["symmetry"][those][0]) if those.any() else 0
        if np.count_nonzero(those) < 2 or symmetry == 0:
            continue
        turns = symmetry if directed or symmetry % 2 == 0 else 2 * symmetry
        gap = turns * np.radians(found["angle_deg"][those] - parts["angle_deg"][those])
        mean = np.angle(np.mean(np.exp(1j * gap)))
        off = np.angle(np.exp(1j * (gap - mean)))
        errors += np.degrees(np.abs(off) / turns).tolist()
    return errors


def evaluate(photographs: Iterable[Photograph]) -> tuple[list[dict[str, Any]], list[str]]:
    """Run all detectors on photographs that are there; returns rows of totals, and what was refused
    when teaching."""
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


def of_half(half: str) -> tuple[list[Photograph], int]:
    """Return the photographs of a half whose files are there, and how many are not."""
    wanted = [p for p in load_photographs() if p.half == half]
    there = [p for p in wanted if is_there(p)]
    return there, len(wanted) - len(there)


@piped()
def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--held-out",
        action="store_true",
        help="evaluate the half that was not used for tuning; prints only totals",
    )
    half = HALVES[parser.parse_args().held_out]
    there, missing = of_half(half)
    if missing:
        print(f"{missing} of {missing + len(there)} photographs are missing: {MISSING}")
    rows, refused = evaluate(there)
    print("\n".join(text_table({"title": half, "columns": COLUMNS, "rows": rows})))
    for line in refused if half == HALVES[0] else ():
        print(f"not taught: {line}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
