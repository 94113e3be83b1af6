"""Judge detectors on the photographs of one half.

cd bench && python -m photographs.evaluate [--held-out]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from harness import text_table
from photographs.fetch import is_there
from photographs.finders import make_finders
from photographs.pictures import FOLDER, HALVES, Photograph, load_photographs
from photographs.taught import teach_examples

REACH = 0.5
"""A part is found by what is nearer to its centre than so many of its radii, one to one."""

ALIKE = 2.5
"""What is ignored is only what has its size, up to this factor."""

TAUGHT = "ours, taught"

TILE_PX = 560
"""Longer side of one method's picture in a figure."""

ACROSS = 3
"""Methods beside each other in a figure."""

COLOURS = {
    "found": (0, 200, 0),
    "missed": (0, 0, 255),
    "false": (255, 0, 255),
    "ignored": (200,) * 3,
}
"""Of figures: blue, green, red."""

PICTURES = "By picture: found + false"

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
    centre_px, centre : list of float
        Errors of centres [px], and in radii.
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
    centre: list[float] = field(default_factory=list)
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
            "centre": float(np.median(self.centre)) if self.centre else None,
            "angle_deg": float(np.median(self.angle_deg)) if self.angle_deg else None,
            "right": percent(self.right, self.named),
            "fresh": percent(self.fresh_found, self.fresh),
        }


COLUMNS = {
    "method": "method", "pictures": "pictures", "parts": "parts", "found": "found",
    "false": "false", "recall": "recall [%]", "precision": "precision [%]",
    "touching": "recall, touching [%]", "centre_px": "centre RMS [px]",
    "centre": "centre, median [radii]", "angle_deg": "angle, median [deg]",
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
        centre=(gap / parts["radius_px"][j]).tolist(),
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


def evaluate(
    photographs: Iterable[Photograph], figures: bool
) -> tuple[list[dict[str, object]], dict[tuple[str, str], Score], list[str]]:
    """Run all detectors on photographs that are there.

    Returns rows of totals; scores by method and picture; what was refused when teaching. Figures
    are drawn into `FOLDER` where wanted.
    """
    scores: dict[tuple[str, str], Score] = {}
    refused: list[str] = []
    for photograph in photographs:
        image = photograph.image()
        finders = make_finders()
        finders[TAUGHT], taught, problems = teach_examples(image, photograph.parts)
        refused += [f"{photograph.name}: {problem}" for problem in problems]
        tiles = []
        for method, find in finders.items():
            found = find(image)
            shown = taught if method == TAUGHT else None
            scores[method, photograph.name] = score(found, photograph, shown)
            tiles.append(draw(image, found, photograph, method))
        if figures:
            write_figure(tiles, FOLDER / f"{photograph.name}.png")
    rows: list[dict[str, object]] = []
    for method in dict.fromkeys(method for method, _ in scores):
        total, pictures = Score(), 0
        for (name, _), one in scores.items():
            if name == method:
                total += one
                pictures += 1
        rows.append({"method": method, "pictures": pictures, **total.row()})
    return rows, scores, refused


def draw(image: np.ndarray, found: np.ndarray, photograph: Photograph, method: str) -> np.ndarray:
    """Return a picture of what was found: parts found green, missed red, false ones magenta."""
    factor = TILE_PX / max(image.shape[:2])
    canvas = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    i, j = match(found, photograph.parts)
    missed = np.delete(photograph.parts, j)
    rest = np.delete(found, i)
    valid = counts(rest, photograph)
    groups = (("found", found[i]), ("missed", missed), ("false", rest[valid]))
    for kind, those in (*groups, ("ignored", rest[~valid])):
        for one in those:
            centre = (round(factor * float(one["x_px"])), round(factor * float(one["y_px"])))
            radius = max(2, round(factor * float(one["radius_px"])))
            cv2.circle(canvas, centre, radius, COLOURS[kind], 1, cv2.LINE_AA)
    strip = np.full((20, canvas.shape[1], 3), 255, np.uint8)
    words = f"{method}: {len(i)} of {len(photograph.parts)}, {int(valid.sum())} false"
    cv2.putText(strip, words, (4, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([strip, canvas])


def write_figure(tiles: list[np.ndarray], path: Path) -> None:
    """Write pictures of one size beside each other, `ACROSS` in a row."""
    tiles = tiles + [np.full_like(tiles[0], 255)] * (-len(tiles) % ACROSS)
    rows = [np.hstack(tiles[k : k + ACROSS]) for k in range(0, len(tiles), ACROSS)]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack(rows))


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
    rows, scores, refused = evaluate(there, figures=half == HALVES[0])
    print("\n".join(text_table({"title": half, "columns": COLUMNS, "rows": rows})))
    if half == HALVES[0]:
        print("\n".join(text_table({"title": PICTURES, **by_picture(scores)})))
        for line in refused:
            print(f"not taught: {line}")
    return 0


def by_picture(scores: Mapping[tuple[str, str], Score]) -> dict[str, Any]:
    """Return columns and rows of a table: what each method found in each picture."""
    rows: dict[str, dict[str, object]] = {}
    for (method, name), one in scores.items():
        row = rows.setdefault(name, {"picture": name, "parts": one.parts})
        row[method] = f"{one.found} + {one.false}"
    methods = dict.fromkeys(method for method, _ in scores)
    columns = {"picture": "picture", "parts": "parts", **{m: m for m in methods}}
    return {"columns": columns, "rows": list(rows.values())}


if __name__ == "__main__":
    sys.exit(main())
