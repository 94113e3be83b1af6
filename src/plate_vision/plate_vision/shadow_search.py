"""Estimation of the shadow that all parts of an image cast (`find_shadow`).

A part and its shadow form one dark object: the part's disc swept along the shadow's displacement.
If several objects are longer than a part in a common direction, their moments determine the
shadow's length and direction, but not the sign of the direction. The sign, the darkness and the
width of the edge are chosen so that the misfit of the parts' contours is minimal (Nelder-Mead
method).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from scipy.optimize import minimize

from .camera import Calibration
from .discs import Silhouettes, fit_discs, to_image
from .discs.shadow import Shadow
from .plate import LitPlate
from .remains import Remains

MIN_OBJECTS = 2
"""Minimum number of objects that are elongated in one direction and therefore indicate shadows. A
single object is not sufficient, because it may be a part of another shape."""

MAX_OBJECTS = 10
"""Maximum number of objects used for the fit. With more objects than this number, the fit would be
slower and hardly better."""

PIXELS = 3000.0
"""Maximum total area of the objects in the fit, divided by pi [px^2]. This maximum limits the
computation time if the objects are large."""

SIZE = 1.05, 4.0
"""Range of the area of a part with its shadow, relative to the part's area."""

ALIGNED = 0.8
"""Minimum length of a mean vector. The vector is the mean of unit vectors at twice the angles of
the objects' directions. Its length is 1 if all directions are equal."""

MIN_LENGTH = 0.1
"""Minimum length of a shadow [part radii]."""

SKIRT_PX = 0.7
"""Width that is added to a part's radius, because the blurred edge belongs to the object [px]."""

DARKNESS = np.linspace(0.1, 0.8, 6)
EDGES_PX = (1.0, 2.5, 4.5)
"""Values of the shadow's darkness and of the half width of its edge [px] in the grid search."""

SIMPLEX = 0.5 * np.vstack([-np.ones(4), np.eye(4) * 3 - 1])
TRIES = 40
DARKEST, EDGE_RANGE_PX = (0.05, 0.9), (0.5, 8.0)
"""Parameters of the Nelder-Mead search. `SIMPLEX`: initial changes of the displacement (x, y) [mm],
of the darkness [0.1] and of the half width of the edge [px]. `TRIES`: maximum number of
evaluations. `DARKEST`, `EDGE_RANGE_PX`: ranges of the darkness and of the half width [px]."""

GOOD_FIT = 0.1
"""Maximum mean misfit of the objects with a shadow. If the mean misfit exceeds this maximum, the
shadow is rejected."""

BETTER = 0.75
"""Maximum mean misfit of the objects with a shadow, relative to their mean misfit without a
shadow."""

SURE = 0.7
"""Maximum mean misfit with a shadow, relative to the misfit with a shadow on the opposite side. If
the ratio of the misfits exceeds this maximum, the side of the shadow is unknown. For synthetic
shadows that were assigned to the wrong side, the ratio was 0.76 and more."""

UNLIKE = 0.15
"""Minimum difference in darkness by which a part is distinguished from its shadow."""

UNLIKE_FRACTION = 0.3
"""Minimum fraction of parts that differ from their shadows in darkness by more than `UNLIKE`. Below
this fraction, the sign of the shadow's direction is unknown, and no shadow is returned."""

EQUAL = 1.05
"""Maximum misfit of the shadow with the measured length, relative to the misfit of the shadow with
the fitted length. The measured length is used if its misfit is below this limit or below
`GOOD_FIT`."""

WORST = 0.4
"""Upper limit of an object's misfit when the mean misfit is computed. The limit prevents objects
that are not parts from dominating the mean."""

ROUNDS = 2
"""Number of grid searches over the darkness and the edge. After each search, the length of the
shadow is measured with the result."""

RATIOS = np.linspace(0, 4, 81)
"""Lengths of capsules (discs swept along a line) for which the flatness is tabulated [radii]."""

INNER_PX = 2.0
"""Width of the blurred border of a disc's shadow [px]. Further inside, the shadow has its full
darkness."""

PROFILE_PX = 0.5
"""Step of the profile in which the end of a shadow is searched [px]."""


def find_shadow(
    contrast: LitPlate, remains: Remains, silhouettes: Silhouettes, calibration: Calibration
) -> Shadow | None:
    """Return the shadow that the objects of an image cast. Return None if no shadow is found.

    `contrast` is the `contrast_image`, and `remains` contains all objects on the plate.
    """
    found = _find_elongated_objects(remains, silhouettes)
    if found is None:
        return None
    middle, parts, length_px, direction = found
    slopes = calibration.slopes(middle)
    fit = _ShadowFit(contrast, middle, parts, slopes)
    offset_m = np.median(np.einsum("nij,nj->ni", slopes, length_px[:, None] * direction), axis=0)
    refinements = []
    for sense in (1, -1):
        shadow = Shadow(calibration, sense * offset_m, 0.5, 1.0)
        for _ in range(ROUNDS):
            shadow = fit.search_grid(shadow)
        shadow = fit.refined(shadow)
        refinements.append((fit.misfit_along_shadow(fit.with_measured_length(shadow)), shadow))
    (misfit, best), (other, reverse) = sorted(refinements, key=lambda refinement: refinement[0])
    left = fit.mean_misfit(best)
    one_sense = best.offset_m @ reverse.offset_m > 0 or misfit < SURE * other
    if not one_sense or left > GOOD_FIT or left > BETTER * fit.misfit_without_shadow():
        return None
    # If most parts are about as dark as their shadows, parts and shadows cannot be distinguished.
    # In this case, the sign of the shadow's direction is unknown.
    unlike = np.abs(fit.discs(best)["darkness"] - best.darkness) > UNLIKE
    if np.count_nonzero(unlike) < UNLIKE_FRACTION * len(unlike):
        return None
    # The misfit evaluates only pixels near the contours of the discs. A long shadow ends far from
    # the contours, so its length is measured along the shadow. If the misfit with the measured
    # length is too large, the shadow is short. For a short shadow, the fitted length is used.
    adjusted, left_adjusted = fit.adjusted(fit.with_measured_length(best))
    return adjusted if left_adjusted < max(EQUAL * left, GOOD_FIT) else best


@dataclass(frozen=True)
class _ShadowFit:
    """Fit of parts (n,) with a common shadow to an image.

    Attributes
    ----------
    contrast : LitPlate
        The `contrast_image`.
    middle : (n, 2)
        Centres of the parts with their shadows [px].
    parts : (n,)
        Silhouettes of parts at these places.
    slopes : (n, 2, 2)
        Derivatives of plate coordinates with respect to pixels at these places [m/px].
    """

    contrast: LitPlate
    middle: np.ndarray
    parts: np.ndarray
    slopes: np.ndarray

    def misfit_without_shadow(self) -> float:
        """Return the mean misfit of the contours without a shadow."""
        discs = fit_discs(self.contrast, self.middle, self.parts)
        return float(np.mean(np.minimum(discs["misfit"], WORST)))

    def discs(self, shadow: Shadow) -> np.ndarray:
        """Return the discs (n,) DISC that fit the image if they cast the shadow."""
        offset = np.linalg.solve(
            self.slopes, np.broadcast_to(shadow.offset_m[:, None], (len(self.slopes), 2, 1))
        )
        seeds = np.ascontiguousarray(self.middle - 0.5 * offset[:, :, 0])
        return fit_discs(self.contrast, seeds, self.parts, shadow)

    def mean_misfit(self, shadow: Shadow) -> float:
        """Return the mean misfit of the contours with a shadow."""
        return float(np.mean(np.minimum(self.discs(shadow)["misfit"], WORST)))

    def misfit_along_shadow(self, shadow: Shadow) -> float:
        """Return the mean misfit of the contours, plus the deviation of the darkness along the
        shadows. The darkness is only evaluated if the shadows are at least as long as a part's
        radius. Such shadows could be mistaken for parts."""
        discs = self.discs(shadow)
        steps, levels = _darkness_profiles(self.contrast, shadow, discs, self.parts)
        length = _median_length(shadow, discs, self.parts)
        inner = (steps > INNER_PX) & (steps < length - shadow.edge_px)
        if length < np.median(self.parts["radius_px"]) or not np.any(inner):
            return self.mean_misfit(shadow)
        deviation = np.median(np.abs(levels[:, inner] - shadow.darkness), axis=1)
        return float(np.mean(np.minimum(discs["misfit"] + deviation, WORST)))

    def with_measured_length(self, shadow: Shadow) -> Shadow:
        """Return the shadow with its measured length. The shadow ends where the median darkness
        over the discs falls to half of the shadow's darkness."""
        discs = self.discs(shadow)
        steps, levels = _darkness_profiles(self.contrast, shadow, discs, self.parts)
        light = np.flatnonzero(np.median(levels, axis=0) < 0.5 * shadow.darkness)
        end = steps[light[0]] if len(light) else steps[-1]
        length = _median_length(shadow, discs, self.parts)
        return replace(shadow, offset_m=shadow.offset_m * max(end, 1.0) / length)

    def search_grid(self, shadow: Shadow) -> Shadow:
        """Return the shadow with the best darkness and edge of the grid search, and with its
        measured length."""
        tried = (
            replace(shadow, darkness=float(darkness), edge_px=edge_px)
            for darkness, edge_px in product(DARKNESS, EDGES_PX)
        )
        return self.with_measured_length(min(tried, key=self.mean_misfit))

    def refined(self, shadow: Shadow) -> Shadow:
        """Return the best shadow that is similar to the given shadow."""

        def changed(change: np.ndarray) -> Shadow:
            return replace(
                _with_changed_darkness(shadow, change[2:]),
                offset_m=shadow.offset_m + 1e-3 * change[:2],
            )

        best = minimize(
            lambda change: self.mean_misfit(changed(change)), np.zeros(4), method="Nelder-Mead",
            options={"initial_simplex": SIMPLEX, "maxfev": TRIES},
        )  # fmt: skip
        return changed(best.x)

    def adjusted(self, shadow: Shadow) -> tuple[Shadow, float]:
        """Return the shadow with the best darkness and edge that are similar to the given ones, and
        its mean misfit. The length stays the same."""
        best = minimize(
            lambda change: self.mean_misfit(_with_changed_darkness(shadow, change)), np.zeros(2),
            method="Nelder-Mead",
            options={"initial_simplex": SIMPLEX[:3, :2], "maxfev": TRIES // 2},
        )  # fmt: skip
        return _with_changed_darkness(shadow, best.x), float(best.fun)


def _with_changed_darkness(shadow: Shadow, change: np.ndarray) -> Shadow:
    """Return a shadow whose darkness and edge are changed by `change` (2,), in units of 0.1 and of
    1 px."""
    return replace(
        shadow,
        darkness=float(np.clip(shadow.darkness + 0.1 * change[0], *DARKEST)),
        edge_px=float(np.clip(shadow.edge_px + change[1], *EDGE_RANGE_PX)),
    )


def _find_elongated_objects(
    remains: Remains, silhouettes: Silhouettes
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Return four arrays about the objects that are elongated in one common direction. The first
    array contains the centres (n, 2) of the objects [px], the second the silhouettes (n,) of parts
    at these places. The third array contains the lengths (n,) by which the objects are longer than
    a part [px]. The fourth array contains the unit vectors (n, 2) of the objects' directions in the
    image. Return None if there are too few objects."""
    x0, y0, stride = remains.grid
    beside = cv2.dilate(remains.outside.astype(np.uint8), np.ones((3, 3), np.uint8))
    count, labels, stats, middle = cv2.connectedComponentsWithStats(remains.deviating)
    at_edge = np.zeros(count, bool)
    at_edge[labels[(beside > 0) & (remains.deviating > 0)]] = True
    middle = middle * stride + (x0, y0)
    parts = silhouettes(middle)
    radius = parts["radius_px"] + SKIRT_PX
    size = stats[:, cv2.CC_STAT_AREA] * stride**2 / (np.pi * radius**2)
    usual = ~at_edge & (size > SIZE[0]) & (size < SIZE[1])
    usual[0] = False
    max_count = PIXELS / float(np.median(size[usual] * radius[usual] ** 2)) if np.any(usual) else 0
    rows = np.flatnonzero(usual)[: int(np.clip(max_count, MIN_OBJECTS, MAX_OBJECTS))]
    if len(rows) < MIN_OBJECTS:
        return None
    flat = np.empty((len(rows), 2))
    for k, row in enumerate(rows):
        left, top, wide, high = stats[row, :4].tolist()
        mask = (labels[top : top + high, left : left + wide] == row).astype(np.uint8)
        m = cv2.moments(mask, binaryImage=True)
        flat[k] = m["mu20"] - m["mu02"], 2 * m["mu11"]
        flat[k] /= m["mu20"] + m["mu02"]
    flatness = np.hypot(*flat.T)
    unit = flat / np.maximum(flatness, 1e-9)[:, None]
    mean = unit.mean(axis=0)
    if np.hypot(*mean) < ALIGNED:
        return None
    length = np.interp(flatness, _capsule_flatness(RATIOS), RATIOS) * radius[rows]
    if np.median(length / radius[rows]) < MIN_LENGTH:
        return None
    angles = 0.5 * np.arctan2(unit[:, 1], unit[:, 0])
    direction = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    axis = 0.5 * np.arctan2(mean[1], mean[0])
    sense = np.sign(direction @ (np.cos(axis), np.sin(axis)))
    return middle[rows], parts[rows], length, direction * sense[:, None]


def _darkness_profiles(
    contrast: LitPlate, shadow: Shadow, discs: np.ndarray, parts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (k,) [px] from the edges of the discs (n,) DISC along their shadows, and the
    darkness (n, k) of the image at these distances."""
    centre, ends = _shadow_displacements(shadow, discs, parts)
    length = np.maximum(np.hypot(*ends.T), 1e-6)
    radius = float(np.median(discs["radius_px"]))
    steps = np.arange(0, (RATIOS[-1] - 1) * radius, PROFILE_PX)
    place = centre[:, None] + (radius + steps[:, None]) * (ends / length[:, None])[:, None]
    height, width = contrast.grey.shape
    column, row = np.rint(place).astype(int).transpose(2, 0, 1)
    levels = contrast.grey[row.clip(0, height - 1), column.clip(0, width - 1)]
    return steps, 1 - levels / contrast.light[0]


def _median_length(shadow: Shadow, discs: np.ndarray, parts: np.ndarray) -> float:
    """Return the median length of the shadows in the image [px]."""
    _, ends = _shadow_displacements(shadow, discs, parts)
    return max(float(np.median(np.hypot(*ends.T))), 1e-6)


def _shadow_displacements(
    shadow: Shadow, discs: np.ndarray, parts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres (n, 2) of the discs, and the displacements (n, 2) of their shadows
    [px]."""
    centre = np.stack([discs["x_px"], discs["y_px"]], axis=1)
    return centre, to_image(parts, shadow.cast(centre, parts))


def _capsule_flatness(length: np.ndarray) -> np.ndarray:
    """Return the flatness (Ia - Ib) / (Ia + Ib) of capsules with radius 1 and lengths L (n,). Ia
    and Ib are the second moments along and across the length:

        Ia = L^3 / 6 + pi L^2 / 4 + 4 L / 3 + pi / 4, Ib = 2 L / 3 + pi / 4
    """
    along = length**3 / 6 + np.pi * length**2 / 4 + 4 * length / 3 + np.pi / 4
    across = 2 * length / 3 + np.pi / 4
    return np.asarray((along - across) / (along + across))
