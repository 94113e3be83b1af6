"""Part types that are prepared for the comparison with outlines, and their fit to an outline.

`make_catalogue` computes edges, samples, spectra and areas of all types. `fit_template` fits a type
to an outline. The function determines candidate angles by the correlation of the spectra, and
continues with Gauss-Newton steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from plate_core.rig import PartType

from .. import _kernels
from .outlines import HARMONICS, Outline, PoseFit, distances, make_outline

GRID = 13
"""Number of points along each side of the bounding box at which a type is sampled."""

CHIRAL = 0.02
"""Minimum RMS (root mean square) difference between the outlines of a part's two faces, relative to
the part's reach (largest radius). If the difference is below this minimum, the two faces count as
equal. The outline of the other face is the mirror image."""

HOLE_INSIDE = 0.55
"""Size of the inner area of a hole, relative to the size of the hole. The inner area does not
include the edge of the hole."""

SAMPLES = 64
"""Number of points on a type's outline."""


@dataclass(frozen=True, eq=False)
class Template:
    """A part type that is prepared for the comparison with outlines.

    Attributes
    ----------
    part : PartType
    edges : (e, 5)
        Edges of the type's outline and holes (see `Outline.edges`). The outline of a disc is a
        circle.
    outline : Outline
    """

    part: PartType
    edges: np.ndarray
    outline: Outline

    @cached_property
    def samples(self) -> np.ndarray:
        """Evenly spaced points [m] on the type's contour, with their outward unit vectors:
        (SAMPLES, 4)."""
        edges = self.outline.edges
        end = np.cumsum(edges[:, 4])
        distance = (np.arange(SAMPLES) + 0.5) * end[-1] / SAMPLES
        i = np.searchsorted(end, distance)
        unit, length = edges[i, 2:4], edges[i, 4]
        points = edges[i, :2] + (length - end[i] + distance)[:, None] * unit
        return np.column_stack([points, unit[:, 1], -unit[:, 0]])

    @cached_property
    def lever2(self) -> float:
        """Mean square of the contour's displacement along its normal, per squared rotation
        [m2/rad2]."""
        x, y, right, up = self.samples.T
        return float(np.mean((x * up - y * right) ** 2))

    @cached_property
    def pole(self) -> tuple[np.ndarray, float]:
        """The inner point (2,) of the part that is farthest from the contour, and its distance from
        the contour [m]."""
        depth = -distances(self.edges, self._grid)[:, 0]
        return self._grid[np.argmax(depth)], float(np.max(depth))

    @cached_property
    def inner(self) -> np.ndarray:
        """Points (n, 2) inside the part and away from its contour [m]. The points farthest from
        `pole` come first."""
        depth = -distances(self.edges, self._grid)[:, 0]
        points = self._grid[depth > 0.2 * np.max(depth)]
        return points[np.argsort(-np.hypot(*(points - self.pole[0]).T))]

    @cached_property
    def hole_points(self) -> np.ndarray:
        """Points (n, 2) inside the part's holes, away from their edges [m]."""
        found = [np.empty((0, 2))]
        for hole in self.part.holes:
            ring = np.array(hole)
            middle = np.mean(ring, axis=0)
            found += [
                middle + HOLE_INSIDE * fraction * (ring - middle) for fraction in (0.0, 0.5, 1.0)
            ]
        return np.concatenate(found)

    @property
    def _grid(self) -> np.ndarray:
        low, high = np.min(self.outline.points, axis=0), np.max(self.outline.points, axis=0)
        axes = [np.linspace(a, b, GRID) for a, b in zip(low, high, strict=True)]
        return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)

    @cached_property
    def filled(self) -> Template:
        """The part without holes."""
        if not self.part.holes:
            return self
        return make_template(replace(self.part, holes=()))

    @cached_property
    def mirrored(self) -> Template | None:
        """The template of the part's other face. None if both faces look the same."""
        flip = np.array([-1.0, 1.0])
        outline = make_outline([flip * ring for ring in self.outline.rings])
        fit = fit_template(self, outline, 100 / outline.reach)
        if np.hypot(fit.swell, fit.residual) < CHIRAL * outline.reach:
            return None
        edges = make_outline([flip * ring for ring in _corner_rings(self.part)]).edges
        return Template(self.part, edges, outline)


def make_template(part: PartType) -> Template:
    """Prepare a part type for the comparison with outlines."""
    rings = _corner_rings(part)
    coarse = make_outline(rings)
    # The calculation of the spectrum is exact only for short edges. Therefore long edges are
    # divided.
    fine = make_outline([_subdivide_ring(ring, 0.05 * coarse.reach) for ring in rings])
    edges = coarse.edges
    if part.radius_m:
        edges = np.vstack([[0.0, 0, 0, 0, -part.radius_m], edges[len(rings[0]) :]])
    return Template(part, edges, fine)


def _corner_rings(part: PartType) -> list[np.ndarray]:
    """Return the corners (n, 2) [m] of a type's outline and of its holes."""
    rings = [part.polygon]
    if part.radius_m:
        step = 2 * np.pi / len(rings[0])
        angle = step * np.arange(len(rings[0]))
        rings[0] = (
            part.radius_m
            * np.sqrt(step / np.sin(step))
            * np.column_stack([np.cos(angle), np.sin(angle)])
        )
    return rings + [np.array(hole) for hole in part.holes]


@dataclass(frozen=True, eq=False)
class Catalogue:
    """All T types of a rig, prepared for the comparison with outlines.

    Attributes
    ----------
    templates : tuple of Template
    area : (T,)
        Area without the holes [m2].
    filled_area : (T,)
        Area including the holes [m2].
    perimeter : (T,)
        Length of the outer contour [m].
    reach : (T,)
        Maximum distance of the contour from the centre [m].
    outline_rms : (T,)
        RMS difference between the outlines of parts of this type [m].
    colour : (T, 3)
        CIE L, a, b; NaN if unknown.
    form : (T, HARMONICS - 1)
        Form of the outline of each type, as in `Outline.form`.
    height : (T,)
        Height above the plate [m]; 0 if the part is flat or the height is unknown.
    """

    templates: tuple[Template, ...]
    area: np.ndarray
    filled_area: np.ndarray
    perimeter: np.ndarray
    reach: np.ndarray
    outline_rms: np.ndarray
    colour: np.ndarray
    form: np.ndarray
    height: np.ndarray


def make_catalogue(types: Mapping[str, PartType]) -> Catalogue:
    """Prepare all types of a rig."""
    templates = tuple(make_template(part) for part in types.values())
    unknown = (np.nan,) * 3
    return Catalogue(
        templates,
        np.array([template.outline.area for template in templates]),
        np.array([template.outline.filled.area for template in templates]),
        np.array([np.sum(template.outline.filled.edges[:, 4]) for template in templates]),
        np.array([template.part.reach_m for template in templates]),
        np.array([template.part.scatter_m for template in templates]),
        np.array([t.part.colour_lab or unknown for t in templates]).reshape(-1, 3),
        np.array([t.outline.form for t in templates]).reshape(-1, HARMONICS - 1),
        np.array([template.part.height_m for template in templates]),
    )


def fit_template(
    template: Template, outline: Outline, scale: float, hopeless: float = np.inf
) -> PoseFit:
    """Fit a type to an outline, starting from each likely angle. Return the best fit. Its residual
    is the root mean square of two distances: from the outline to the type, and from the type to the
    outline."""
    fit: np.ndarray = _kernels.lay_on(
        template.edges,
        template.samples,
        template.outline.centre,
        template.outline.spectrum,
        template.part.symmetry,
        outline.edges,
        outline.centre,
        outline.spectrum,
        1 / scale,
        hopeless,
    )
    return PoseFit.of(fit)


def _subdivide_ring(ring: np.ndarray, length: float) -> np.ndarray:
    """Return a ring (n, 2) with additional points, so that no point is farther than a length [m]
    from the next point."""
    after = np.roll(ring, -1, axis=0)
    pieces = []
    for a, b in zip(ring, after, strict=True):
        count = int(np.ceil(np.hypot(*(b - a)) / length))
        pieces.append(a + np.arange(count)[:, None] / count * (b - a))
    return np.concatenate(pieces)
