"""The compared detectors: the project's detector, and baselines with the settings that their guides
recommend. No detector gets the number or the size of the parts, or settings for a single picture.
If a guide recommends no value, a few values were tried on the tuning half, and the best one is
used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from harness import optional
from plate_vision import detect

FINDING = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("angle_deg", "f8"),
        ("label", "U32"),
    ]
)
"""Data of a detected part: centre and radius of a disc with the same area [px], angle (NaN if
unknown), and class (empty if unknown)."""

Finder = Callable[[np.ndarray], np.ndarray]
"""Function from an image (H, W, 3) uint8 to (n,) FINDING."""

MIN_PX2 = 30.0
"""Minimum area of a patch that a baseline reports [px2]."""

MAX_FRACTION = 0.25
"""Maximum area of a patch, as a fraction of the picture."""

DEEPER_PX = 1.5
"""Minimum height of a peak of the distance to the contour above the saddle to the next peak [px].
Peaks with a larger height are separate parts."""

UNTAUGHT = "ours, untaught"

WHITE = 255


def make_finders() -> dict[str, Finder]:
    """Return the detectors that need no teaching, by name. Baselines that are not installed are
    omitted."""
    finders: dict[str, Finder] = {UNTAUGHT: find_untaught}
    if optional("skimage.segmentation") is not None:
        finders["scikit-image watershed"] = watershed
    return finders


def find_untaught(image: np.ndarray) -> np.ndarray:
    """Find parts with `plate_vision.detect` and its default options. Groups are omitted."""
    seen = detect(image)
    seen = seen[seen["method"] != "group"]
    return as_findings(seen, seen["label"])


def as_findings(seen: np.ndarray, label: Sequence[str] | np.ndarray) -> np.ndarray:
    """Return detections (n,) of the project's detector as FINDING, with these labels."""
    found = np.zeros(len(seen), FINDING)
    for name in ("x_px", "y_px", "radius_px"):
        found[name] = seen[name]
    found["label"], found["angle_deg"] = label, np.degrees(seen["angle_rad"])
    return found


def watershed(image: np.ndarray) -> np.ndarray:
    """Find patches whose colour differs from the median colour by more than Otsu's threshold. Split
    the patches by a watershed of the distance to their contour."""
    measure, morphology = optional("skimage.measure"), optional("skimage.morphology")
    segmentation = optional("skimage.segmentation")
    mask = _far_from_background(image)
    depth = cv2.GaussianBlur(cv2.distanceTransform(mask, cv2.DIST_L2, 5), (0, 0), 1.0)
    seeds = measure.label(morphology.h_maxima(depth, DEEPER_PX))
    labels = segmentation.watershed(-depth, seeds, mask=mask > 0)
    props = measure.regionprops(labels)
    y, x = np.array([p.centroid for p in props]).reshape(-1, 2).T
    found = _to_findings(x, y, np.array([p.area for p in props], float), image)
    angle = {(p.centroid[1], p.centroid[0]): np.degrees(p.orientation) + 90 for p in props}
    found["angle_deg"] = [angle[x, y] for x, y in zip(found["x_px"], found["y_px"], strict=True)]
    return found


def _far_from_background(image: np.ndarray) -> np.ndarray:
    """Return a mask (H, W) uint8 of pixels that differ from the median colour, with filled
    holes."""
    image = cv2.medianBlur(image, 3)
    lab = cv2.cvtColor(image.astype(np.float32) / WHITE, cv2.COLOR_BGR2Lab)
    distance = np.linalg.norm(lab - np.median(lab.reshape(-1, 3), axis=0), axis=2)
    bins = np.minimum(2 * distance, WHITE).astype(np.uint8)
    mask = cv2.threshold(bins, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)[1]
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[-2]
    return np.asarray(cv2.drawContours(mask, contours, -1, 1, cv2.FILLED))


def _to_findings(x: np.ndarray, y: np.ndarray, area: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return patches (n,) FINDING from centres [px] and areas [px2]. Too small and too large
    patches are omitted."""
    found = np.zeros(len(area), FINDING)
    found["x_px"], found["y_px"] = x, y
    found["radius_px"] = np.sqrt(area / np.pi)
    found["angle_deg"] = np.nan
    size = image.shape[0] * image.shape[1]
    return found[(area >= MIN_PX2) & (area <= MAX_FRACTION * size)]
