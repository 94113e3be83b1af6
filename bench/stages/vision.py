"""Finding discs in an image: time, misses, error of the centres.

The detector is compared with OpenCV and scikit-image. The images are from the simulated camera, so
the true centres are known.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from harness import Result, Table, missing, optional, paired, timed
from plate_core import Rig, load_rig
from plate_core.rig import homography, project
from plate_sim import Camera, part_greys
from plate_vision import detect, make_vision

PROJECT = "plate_vision.detect"

FRAMES, BASELINE_FRAMES = 250, 20
"""Number of images of each scene: 1000 in total for the project's detector, fewer for the baselines
to save time. All methods are timed with the smaller number of images."""

ROUNDS = 5
"""Number of timings of each method with every image. Each method is timed in its own loop, and in
turn with the others."""

THRESHOLD = 165
"""Threshold of the baselines [grey level]. Parts are at most 130, and the plate is at least 198."""

Finder = Callable[[np.ndarray], np.ndarray]
"""Function from an image (H, W) to centres (n, 2) [px]."""


def measure(quick: bool) -> Result:
    """Measure the detection of 10 and 100 discs, in scenes with separate and with touching
    discs."""
    rig = load_rig()
    cv2.setNumThreads(1)
    finders = make_finders(rig)
    scenes = [(count, touching) for count in (10, 100) for touching in (False, True)]
    rows = [row for scene in scenes for row in scene_rows(rig, finders, *scene, quick)]
    table = Table.of("vision", rows, width=rig.camera.width_px, height=rig.camera.height_px)
    return Result([table], missing("skimage"))


def make_finders(rig: Rig) -> dict[str, Finder]:
    """Return the project's detector and the baselines by name, ready to run."""
    vision = make_vision(rig)
    mask = np.zeros((rig.camera.height_px, rig.camera.width_px), np.uint8)
    cv2.fillConvexPoly(mask, np.round(vision.region.outline_px).astype(np.int32), 255)
    area = np.pi * vision.options.radius_px**2

    def ours(image: np.ndarray) -> np.ndarray:
        found = detect(image, vision.options, vision.region)
        return np.column_stack([found["x_px"], found["y_px"]])

    def contours(image: np.ndarray) -> np.ndarray:
        dark = cv2.threshold(image, THRESHOLD, 255, cv2.THRESH_BINARY_INV)[1]
        dark = cv2.bitwise_and(dark, mask)
        outlines, _ = cv2.findContours(dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        moments = [cv2.moments(outline) for outline in outlines]
        centres = [
            (m["m10"] / m["m00"], m["m01"] / m["m00"]) for m in moments if m["m00"] > 0.3 * area
        ]
        return np.array(centres).reshape(-1, 2)

    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea, parameters.maxArea = float(0.5 * area), float(1.5 * area)
    parameters.minThreshold, parameters.maxThreshold, parameters.thresholdStep = 60, 190, 30
    parameters.minRepeatability, parameters.minDistBetweenBlobs = 2, 5
    parameters.filterByInertia = parameters.filterByConvexity = False
    detector = cv2.SimpleBlobDetector.create(parameters)

    def blobs(image: np.ndarray) -> np.ndarray:
        points = detector.detect(image)
        return np.array([point.pt for point in points]).reshape(-1, 2)

    radius = vision.options.radius_px

    def hough(image: np.ndarray) -> np.ndarray:
        circles = cv2.HoughCircles(
            image, cv2.HOUGH_GRADIENT, 1, 1.6 * radius, param1=100, param2=9,
            minRadius=round(0.8 * radius), maxRadius=round(1.2 * radius),
        )  # fmt: skip
        return np.zeros((0, 2)) if circles is None else circles.reshape(-1, 3)[:, :2]

    def peaks(image: np.ndarray) -> np.ndarray:
        dark = cv2.bitwise_and(cv2.threshold(image, THRESHOLD, 255, cv2.THRESH_BINARY_INV)[1], mask)
        depth = cv2.distanceTransform(dark, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        tops = (depth > 0.6 * radius).astype(np.uint8)
        return np.asarray(cv2.connectedComponentsWithStats(tops)[3][1:])

    inner, skimage = cv2.erode(mask, np.ones((5, 5), np.uint8)) > 0, optional("skimage.measure")

    def regions(image: np.ndarray) -> np.ndarray:
        parts = skimage.regionprops(skimage.label((image < THRESHOLD) & inner))
        return np.array([p.centroid[::-1] for p in parts if p.area > 0.3 * area]).reshape(-1, 2)

    return {
        PROJECT: ours,
        "findContours + moments": contours,
        "SimpleBlobDetector": blobs,
        "HoughCircles": hough,
        "distance transform": peaks,
        **({"skimage regionprops": regions} if skimage else {}),
    }


def scene_rows(
    rig: Rig, finders: dict[str, Finder], count: int, touching: bool, quick: bool
) -> list[dict[str, Any]]:
    """Measure all methods on the same images."""
    rng = np.random.default_rng(count + touching)
    camera, matrix = Camera(rig), homography(rig)
    # The length of 1 cm in the image at the centre of the plate gives the scale.
    centimetre = np.diff(project(matrix, np.array([[0, 0], [0.01, 0]])), axis=0)
    reach = 0.5 * rig.parts.radius_m * float(np.linalg.norm(centimetre)) / 0.01
    images, truths = [], []
    for _ in range(3 if quick else FRAMES):
        position = layout(rig, count, touching, rng)
        grey = part_greys([("black", "grey")[i % 2] for i in range(count)])
        images.append(camera.render(position, grey, rng))
        truths.append(project(matrix, position))
    loop, alternating = times_of(finders, images[:BASELINE_FRAMES], 1 if quick else ROUNDS)
    rows = []
    for name, find in finders.items():
        frames = len(images) if name == PROJECT else min(BASELINE_FRAMES, len(images))
        found = [find(image) for image in images[:frames]]
        pairs = [paired(*two, reach) for two in zip(found, truths[:frames], strict=True)]
        errors = np.concatenate([gap for _, _, gap in pairs])
        true = count * frames
        rows.append(
            {
                "discs": count,
                "place": "touching" if touching else "apart",
                "method": name,
                "frames": frames,
                "loop_ms": 1e3 * float(np.median(loop[name])),
                "turns_ms": 1e3 * float(np.median(alternating[name])),
                "loop_lead": float(np.median(loop[name]) / np.median(loop[PROJECT])),
                "turns_lead": float(np.median(alternating[name] / alternating[PROJECT])),
                "rms_px": float(np.sqrt(np.mean(errors**2))) if len(errors) else None,
                "missed_percent": 100 * (1 - len(errors) / true),
                "false_percent": 100 * (sum(map(len, found)) - len(errors)) / true,
            }
        )
    return rows


def times_of(
    finders: dict[str, Finder], images: list[np.ndarray], rounds: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return the times (rounds, images) [s] of every method, in a separate loop, and in turn with
    the others."""
    loop = {name: np.empty((rounds, len(images))) for name in finders}
    alternating = {name: np.empty((rounds, len(images))) for name in finders}
    for k in range(rounds):
        for name, find in finders.items():
            find(images[0])
            loop[name][k] = [timed(find, image)[1] for image in images]
        for i, image in enumerate(images):
            for name, find in finders.items():
                alternating[name][k, i] = timed(find, image)[1]
    return loop, alternating


def layout(rig: Rig, count: int, touching: bool, rng: np.random.Generator) -> np.ndarray:
    """Return centres (count, 2) [m] of discs on a coarse grid, separate or in touching groups of
    three."""
    radius = rig.parts.radius_m
    columns, lines, group = (11, 5, 3) if touching else (18, 8, 1)
    limit = rig.plate.half - radius
    cell = 2 * limit / (columns, lines)
    chosen = rng.permutation(columns * lines)[: -(-count // group)]
    centre = -limit + cell * (np.column_stack([chosen % columns, chosen // columns]) + 0.5)
    if not touching:
        return centre + rng.uniform(-0.5, 0.5, centre.shape) * (cell - 2.5 * radius)
    # Three discs of radius r touch each other if their centres have the distance 2 r / sqrt(3) from
    # a common point and are 120 degrees apart.
    angle = rng.uniform(0, 2 * np.pi, len(centre))[:, None] + 2 * np.pi / 3 * np.arange(3)
    ray = 2 * radius / np.sqrt(3) * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    return (centre[:, None] + ray).reshape(-1, 2)[:count]
