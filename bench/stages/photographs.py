"""The detector in photographs that come inside the scikit-image package, without any setting.

True centres are marked by hand: src/plate_vision/test/photographs.yaml.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import yaml

from harness import ROOT, Table, missing_peer, optional, race
from plate_vision import detect

MARKS = ROOT / "src/plate_vision/test/photographs.yaml"

REACH_PX = 8.0
"""How near to a mark a part must be to count as found [px]."""

OURS = "plate_vision.detect"

Finder = Callable[[np.ndarray], np.ndarray]


def photograph_table(quick: bool) -> tuple[Table, list[str]]:
    """Measure every photograph; also sentences that sum up."""
    data = optional("skimage.data")
    rows: list[dict[str, Any]] = []
    sentences = []
    if data is None:
        sentences.append(missing_peer("scikit-image (it brings the photographs)"))
    else:
        for name, marks in yaml.safe_load(MARKS.read_text(encoding="utf-8")).items():
            image = getattr(data, name)()
            rows += rows_of(name, image, np.array(marks, dtype=float).reshape(-1, 2), quick)
        ours = [row for row in rows if row["method"] == OURS]
        worst = max(row["worst_px"] for row in ours if row["worst_px"] is not None)
        sentences.append(
            f"photographs: {sum(r['found'] for r in ours)} of {sum(r['true'] for r in ours)} parts "
            f"found, {sum(r['false'] for r in ours)} invented, worst centre {worst:.1f} px"
        )
    columns = {
        "picture": "photograph", "method": "method", "true": "parts", "found": "found",
        "false": "false", "rms_px": "centre RMS [px]", "worst_px": "worst [px]",
        "ms": "median [ms]",
    }  # fmt: skip
    note = (
        "True: counted, and centres marked, by hand in enlarged pictures, to about half a pixel. "
        "Ours has no settings; HoughCircles gets the range of radii and a threshold that suits the "
        "coins, regionprops a threshold by Otsu. The pictures were at hand when the detector was "
        "made, so they show what it can do, not how often it will."
    )
    return Table("photographs", "Photographs, nothing known of the parts", columns, rows, note), (
        sentences
    )


def rows_of(name: str, image: np.ndarray, truth: np.ndarray, quick: bool) -> list[dict[str, Any]]:
    """Measure all methods in one photograph; `truth` is (M, 2) [px]."""
    grey = np.ascontiguousarray(image if image.ndim == 2 else image[:, :, 1])
    finders = make_finders()
    timed = race({n: lambda f=find: f(grey) for n, find in finders.items()}, 0.1 if quick else 1.0)
    rows = []
    for method, find in finders.items():
        found = find(grey)
        gap = np.linalg.norm(found[:, None] - truth, axis=2)
        near = gap.min(axis=0, initial=np.inf)
        errors = near[near < REACH_PX]
        rows.append(
            {
                "picture": name,
                "method": method,
                "true": len(truth),
                "found": len(errors),
                "false": len(found) - len(errors),
                "rms_px": float(np.sqrt(np.mean(errors**2))) if len(errors) else None,
                "worst_px": float(errors.max()) if len(errors) else None,
                "ms": 1e3 * timed.median(method),
            }
        )
    return rows


def make_finders() -> dict[str, Finder]:
    """Return ours and its peers: image (H, W) to centres (n, 2) [px]."""

    def ours(image: np.ndarray) -> np.ndarray:
        found = detect(image)
        return np.column_stack([found["x_px"], found["y_px"]])

    def hough(image: np.ndarray) -> np.ndarray:
        smooth = cv2.GaussianBlur(image, (5, 5), 0)
        circles = cv2.HoughCircles(
            smooth, cv2.HOUGH_GRADIENT, 1, 40, param1=150, param2=25, minRadius=14, maxRadius=40
        )
        return np.zeros((0, 2)) if circles is None else circles.reshape(-1, 3)[:, :2]

    finders: dict[str, Finder] = {OURS: ours, "HoughCircles": hough}
    measure, filters = optional("skimage.measure"), optional("skimage.filters")
    if measure is not None and filters is not None:

        def regions(image: np.ndarray) -> np.ndarray:
            labels = measure.label(image > filters.threshold_otsu(image))
            parts = measure.regionprops(labels)
            return np.array([p.centroid[::-1] for p in parts if p.area > 50]).reshape(-1, 2)

        finders["skimage Otsu + regionprops"] = regions
    return finders
