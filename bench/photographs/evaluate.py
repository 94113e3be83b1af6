"""Judge detectors on the photographs of one half.

cd bench && python -m photographs.evaluate [--held-out]
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from harness import text_table
from photographs.fetch import is_there
from photographs.finders import make_finders
from photographs.pictures import HALVES, Photograph, load_photographs
from photographs.taught import teach_examples

REACH = 0.5
"""A part is found by what is nearer to its centre than so many of its radii, one to one."""

ALIKE = 2.5
"""What is ignored is only what has its size, up to this factor."""

TAUGHT = "ours, taught"

MISSING = "cd bench && python -m photographs.fetch"


@dataclass
class Score:
    """What one detector found in some pictures.

    Attributes
    ----------
    parts, found, false : int
        Parts; those that were found; what was found where no part is.
    touching, touching_found : int
        The same of parts that touch others.
    fresh, fresh_found : int
        The same of parts that were not shown as examples.
    named, right : int
        Found parts that got a class, and those that got theirs.
    centre_px : list of float
        Errors of centres [px].
    angle_deg : list of float
        Errors of angles, modulo symmetry, apart from one zero for each class of a picture.
    """

    parts: int = 0
    found: int = 0
    false: int = 0
    touching: int = 0
    touching_found: int = 0
    fresh: int = 0
    fresh_found: int = 0
    named: int = 0
    right: int = 0
    centre_px: list[float] = field(default_factory=list)
    angle_deg: list[float] = field(default_factory=list)

    def __iadd__(self, other: Score) -> Score:
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)
        return self

    def row(self) -> dict[str, float | int | None]:
        """Return it as the row of a table."""
        seen = self.found + self.false
        return {
            "parts": self.parts,
            "found": self.found,
            "false": self.false,
            "recall": percent(self.found, self.parts),
            "precision": percent(self.found, seen),
            "touching": percent(self.touching_found, self.touching),
            "centre_px": float(np.sqrt(np.mean(np.square(self.centre_px)))) if seen else None,
            "angle_deg": float(np.median(self.angle_deg)) if self.angle_deg else None,
            "right": percent(self.right, self.named),
            "fresh": percent(self.fresh_found, self.fresh),
        }


COLUMNS = {
    "method": "method", "pictures": "pictures", "parts": "parts", "found": "found",
    "false": "false", "recall": "recall [%]", "precision": "precision [%]",
    "touching": "recall, touching [%]", "centre_px": "centre RMS [px]",
    "angle_deg": "angle, median [deg]",
    "right": "class right [%]", "fresh": "recall, not shown [%]",
}  # fmt: skip
"""Keys of rows and their headings."""


def percent(part: int, whole: int) -> float | None:
    """Return a share in percent, None of nothing."""
    return 100 * part / whole if whole else None


def match(found: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pair what was found (n,) FOUND with parts (m,) TRUTH, one to one, as many as can be.

    Returns the indices of both, (k,) each.
    """
    gap = np.hypot(
        found["x_px"][:, None] - parts["x_px"], found["y_px"][:, None] - parts["y_px"]
    ) / np.maximum(parts["radius_px"], 1e-9)
    cost = np.where(gap < REACH, gap, 1e3)
    i, j = linear_sum_assignment(cost)
    near = cost[i, j] < REACH
    return i[near], j[near]


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
    shown = np.zeros(len(parts), bool) if shown is None else shown
    i, j = match(found, parts)
    hit = np.zeros(len(parts), bool)
    hit[j] = True
    rest = np.delete(found, i)
    gap = np.hypot(found["x_px"][i] - parts["x_px"][j], found["y_px"][i] - parts["y_px"][j])
    named = np.isin(found["label"][i], parts["label"])
    return Score(
        parts=len(parts),
        found=len(i),
        false=int(counts(rest, photograph).sum()),
        touching=int(parts["touching"].sum()),
        touching_found=int(hit[parts["touching"]].sum()),
        fresh=int((~shown).sum()),
        fresh_found=int(hit[~shown].sum()),
        named=int(named.sum()),
        right=int((found["label"][i] == parts["label"][j]).sum()),
        centre_px=gap.tolist(),
        angle_deg=angle_errors(found[i], parts[j], bool(named.any())),
    )


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
            one = total.setdefault(method, Score())
            one += score(find(image), photograph, shown)
            pictures[method] += 1
    rows = [{"method": name, "pictures": pictures[name], **s.row()} for name, s in total.items()]
    return rows, refused


def of_half(half: str) -> tuple[list[Photograph], int]:
    """Return the photographs of a half whose files are there, and how many are not."""
    wanted = [p for p in load_photographs() if p.half == half]
    there = [p for p in wanted if is_there(p)]
    return there, len(wanted) - len(there)


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--held-out",
        action="store_true",
        help="the half that nothing was tuned on: totals only, to be looked at once at the end",
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
