"""Comparison of the plate's outline in the image with the outline predicted from `corners_px` and
the lens.

The brightness is sampled along profiles that cross each predicted edge at right angles. The
measured edge is a curve of second degree through steps of brightness in these profiles. This curve
is found by random sampling, followed by least squares. The deviations of all edges together show
the cause. A missing lens model bends the edges. A moved camera shifts, rotates or scales the
outline. Edges that are not visible are ignored.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from plate_core import Rig
from plate_core.status import Finding, Level

from ..camera.encodings import grey_levels
from ..camera.lens import Calibration

IMAGES = 5
"""Number of images that are used for one evaluation of the outline. If the plate moves, the images
show it at several times of its cycle."""

REST_M = 5e-4
"""Maximum range of an edge's places in the images of an evaluation [m]. If the range of an edge
exceeds this maximum, the plate was moving. For a plate at rest, the range is 0.1 mm with a noise of
15 grey levels."""

RECHECK_S = 1.0
"""Minimum time from a finding to the next evaluation [s]. The evaluation of an image takes 20 to 60
ms."""

UNSEEN_S = 10.0
"""Minimum time to the next evaluation if the plate was not visible or was moving [s]."""

SEARCH = 0.15
"""Maximum distance from the predicted edge at which the edge is searched, relative to the smaller
side of the plate [-]. Without a lens model, a barrel lens from the literature shifts corners by 8
%."""

STATIONS = 64
"""Number of profiles along an edge."""

STATION_END = 0.94
"""Fraction of an edge that the profiles span. The ends are omitted, because corners are often
rounded."""

NEAR_M = 3e-3
"""Tolerated deviation of the plate's outline from the prediction [m]. At the start of a cycle, the
plate is up to 2 mm from home."""

NEAR_STROKE = 0.3
"""Tolerated deviation of the plate's outline from the prediction, as a fraction of the motors'
stroke. The smaller one of this value and `NEAR_M` is used."""

NEAR_PX = 3.0
"""Minimum tolerated deviation of the plate's outline from the prediction [px]. Corners measured by
hand have errors of 1 to 2 px."""

BOW_PX = 1.0
"""Tolerated bow in the middle of an edge of the plate [px]. The bow is measured with an accuracy of
0.2 px."""

BOW_M = 5e-4
"""Tolerated bow in the middle of an edge of the plate [m]. The larger one of this bow and `BOW_PX`
is used. The edges of sawn plates deviate from a straight line by up to 0.3 mm."""

MAX_ROTATION_RAD = np.radians(0.6)
"""Tolerated rotation of the plate's outline relative to the prediction [rad]. For a plate of 300
px, the rotation is measured with an accuracy of a tenth of this value. At the start of a cycle, the
rotation of a moving plate is smaller than this value."""

STRETCH = 0.01
"""Tolerated difference between the size of the plate's outline and the predicted size, relative to
the predicted size [-]. The size is measured with an accuracy of a tenth of this value."""

SUPPORT = 0.6
"""Minimum fraction of an edge's profiles that must agree. The fraction is below 1 because parts may
hide the edge in some profiles."""

MIN_EDGES = 3
"""Minimum number of visible edges for a finding. Two edges do not determine shift and size."""

SMOOTH_PX = 1.0
"""Standard deviation of the Gaussian filter that is applied before profiles are sampled [px]. The
filter reduces a noise of 20 grey levels to 6."""

MIN_STEP = 4.0
"""Minimum step of an edge [grey levels]."""

NOISE_STEPS = 5.0
"""Minimum step of an edge, relative to the standard deviation of the gradient beside the edge
[-]."""

CANDIDATES = 3
"""Number of steps of each sign that are kept from a profile, starting with the strongest step. Such
steps are, for example, the plate's edge, a shadow, and a part."""

DRAWS = 400
"""Number of trial curves for an edge. Each curve passes through a random triple of candidates. If
each profile has one correct and two false candidates, one triple in 27 is correct. About fifteen of
the curves are then correct."""

INLIER_PX = 2.0
"""Maximum distance between a step and the curve of its edge [px]. An edge that is bent by a lens
with strong distortion deviates by 1 px from a curve of second degree."""

MOVED_RADII = 2.0
"""Maximum deviation of the plate's outline from the prediction that is explained by a moved camera
[part radii]. If the deviation exceeds this maximum and the outline agrees with a flip, the image is
assumed to be flipped."""

SIDE_PX = 5.0, 10.0
"""Minimum and maximum distance from a step in a profile [px]. The brightness beside the step is
measured between these distances. Both distances are larger than the width of a line of pen or tape,
which is 2 to 4 px."""

SHIFT_TEXT_M = 5e-4
"""Minimum shift that is stated in a message [m]. This shift is the error of the measurement with
noise and with corners that are rounded to a pixel."""

MIN_TEXT_ROTATION_RAD = np.radians(0.2)
"""Minimum rotation that is stated in a message [rad]."""

STRETCH_TEXT = 0.003
"""Minimum change of size that is stated in a message [-]."""

FLIPS = {
    "mirrored left to right": (1, -1),
    "mirrored upside down": (-1, 1),
    "rotated by 180 degrees": (-1, -1),
}
"""Flips of the image that a driver or a mount may cause. The two numbers are the steps through rows
and columns that undo the flip."""


QUARTER_TURNS = {
    "rotated by 90 degrees clockwise": 1,
    "rotated by 90 degrees anticlockwise": -1,
}
"""Rotations of a square image, which do not change its size. The number is the argument of
`numpy.rot90` that undoes the rotation."""


@dataclass(frozen=True, eq=False)
class OutlineGrid:
    """Image points at which the plate's edges are searched.

    Attributes
    ----------
    half : (2,)
        Half sides of the plate [m].
    along : (S,)
        Places of the profiles along an edge, -1 to 1.
    offset : (D,)
        Distances outwards from the predicted edge [m].
    place_px : (4, S, D, 2) float32
        Image points [px]; NaN outside the image.
    scale : (4,)
        Pixels per metre across each edge.
    near : float
        Tolerated deviation of the outline from the prediction [m].
    stroke : float
        Stroke of the motors [m].
    """

    half: np.ndarray
    along: np.ndarray
    offset: np.ndarray
    place_px: np.ndarray
    scale: np.ndarray
    near: float
    stroke: float

    @classmethod
    def of(cls, rig: Rig, calibration: Calibration) -> OutlineGrid:
        """Prepare the grid around the edges of the rig's plate, with the plate at home."""
        half = np.asarray(rig.plate.half, float)
        size_px = np.array([rig.camera.width_px, rig.camera.height_px])
        along = np.linspace(-STATION_END, STATION_END, STATIONS)
        foot = edge_points(half, along)  # (4, S, 2)
        pixel = float(np.median(calibration.scale(foot.reshape(-1, 2))))
        reach = SEARCH * 2 * float(half.min())
        count = max(int(np.ceil(reach * pixel)), 8)
        offset = np.linspace(-reach, reach, 2 * count + 1)
        point = foot[:, :, None] + offset[:, None] * OUTWARD[:, None, None]
        place = calibration.to_image(point.reshape(-1, 2)).reshape(*point.shape)
        # The model of a lens with strong distortion can map points outside its valid range back
        # into the image. At such points, the image point moves in the wrong direction along the
        # profile. Such points are excluded.
        step = np.diff(place, axis=2)
        middle = step[:, :, count : count + 1]
        folded = np.sum(step * middle, axis=3) <= 0
        inside = np.all((place >= 0) & (place <= size_px - 1), axis=3)
        inside[:, :, 1:] &= ~folded
        inside[:, :, :-1] &= ~folded
        place[~inside] = np.nan
        across = np.linalg.norm(middle[:, :, 0], axis=2) / (offset[1] - offset[0])
        near = min(NEAR_M, NEAR_STROKE * rig.limits.stroke_m)
        scale = np.median(across, axis=1)
        near = max(near, NEAR_PX / float(scale.min()))
        return cls(half, along, offset, place.astype(np.float32), scale, near, rig.limits.stroke_m)

    @cached_property
    def visible(self) -> np.ndarray:
        """Whether a profile is inside the image near the predicted edge, (4, S) bool."""
        around = np.abs(self.offset) <= self.near
        return np.asarray(np.all(np.isfinite(self.place_px[:, :, around, 0]), axis=2))


OUTWARD = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
"""Outward normals of the plate's edges, in the order of `Plate.corners`."""

EDGE_DIRECTION = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Directions of the edges, counter-clockwise."""


def edge_points(half: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return points (4, S, 2) [m, plate_home] of the edges of a plate with these half sides (2,)
    [m], at places `along` (S,), -1 to 1."""
    return half * (OUTWARD[:, None] + along[:, None] * EDGE_DIRECTION[:, None])


@dataclass(frozen=True, eq=False)
class Outline:
    """The plate's edges measured in one image.

    Attributes
    ----------
    edges : (4, 3)
        Three numbers for each edge, NaN if the edge is not visible. The first number is the mean
        outward distance of both ends from the predicted edge [m]. The second number is the slope,
        which is half the difference of the two distances [m]. The third number is the bow, which is
        the additional outward distance of the edge's middle [m].
    """

    edges: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """Whether an edge is visible, (4,) bool."""
        return np.isfinite(self.edges[:, 0])

    def within(self, near: float) -> np.ndarray:
        """Whether the distance of an edge from the predicted edge is at most `near` [m] at both
        ends, (4,) bool."""
        middle, slope, _ = np.abs(self.edges).T
        return np.asarray(np.nan_to_num(middle + slope, nan=np.inf) <= near)


def measure_outline(image: np.ndarray, grid: OutlineGrid, limit: float | None = None) -> Outline:
    """Measure the plate's edges in an image (H, W) or (H, W, 3) uint8.

    `limit` is the maximum distance from the predicted edges [m]. None: the maximum distance of the
    grid.
    """
    smooth = cv2.GaussianBlur(contrast_channel(image, grid), (0, 0), SMOOTH_PX)
    edges = np.full((4, 3), np.nan)
    rng = np.random.default_rng(0)  # a fixed seed, so that the same image gives the same result
    for edge in range(4):
        place = grid.place_px[edge]
        used = grid.visible[edge]
        if np.mean(used) < SUPPORT:
            continue
        x, y = np.nan_to_num(place[used], nan=-1e4).transpose(2, 0, 1)
        profile = cv2.remap(smooth, x, y, cv2.INTER_LINEAR, borderValue=0.0)
        profile[~np.isfinite(place[used][..., 0])] = np.nan
        tolerance = INLIER_PX / float(grid.scale[edge])
        found = _fit_edge(profile, grid, grid.along[used], tolerance, limit, rng)
        if found is not None:
            edges[edge] = found
    return Outline(edges)


def contrast_channel(image: np.ndarray, grid: OutlineGrid) -> np.ndarray:
    """Return an image (H, W) float32 with one channel in which the plate and its surround differ.
    For an image (H, W), the result contains the grey levels. For an image (H, W, 3), the result
    contains the projections of the colours on the line from the surround's colour to the plate's
    colour."""
    if image.ndim == 2:
        return image.astype(np.float32)
    colours = []
    for part in (slice(0, len(grid.offset) // 3), slice(-(len(grid.offset) // 3), None)):
        place = grid.place_px[:, :, part].reshape(-1, 2)
        column, row = np.rint(place[np.isfinite(place[:, 0])]).astype(int).T
        if not len(row):
            return grey_levels(image).astype(np.float32)
        colours.append(np.median(image[row, column], axis=0))
    difference = np.subtract(*colours)
    size = float(np.linalg.norm(difference))
    if size < MIN_STEP:
        return grey_levels(image).astype(np.float32)
    return np.asarray(image.astype(np.float32) @ (difference / size).astype(np.float32))


def _fit_edge(
    profile: np.ndarray,
    grid: OutlineGrid,
    along: np.ndarray,
    tolerance: float,
    limit: float | None,
    rng: np.random.Generator,
) -> np.ndarray | None:
    """Return the edge (3,) in profiles (S, D), as in `Outline.edges` [m]. Return None if there is
    no edge.

    An edge near the predicted edge is preferred to a clearer edge that is farther away. The farther
    edge may belong to a frame, a shadow or a table.
    """
    candidate = _find_steps(profile, grid.offset)
    best, best_support = None, SUPPORT
    for reach in (grid.near, np.inf if limit is None else limit):
        for signed in candidate:
            offset = np.where(np.abs(signed) <= reach, signed, np.nan)
            found, support = _fit_curve(offset, signed, along, tolerance, rng)
            far = np.abs(found[0]) > grid.near
            if support >= best_support and not (
                far and _is_line(profile, grid.offset, found, along)
            ):
                best, best_support = found, support
        if best is not None:
            return best
    return None


def _is_line(profile: np.ndarray, offset: np.ndarray, curve: np.ndarray, along: np.ndarray) -> bool:
    """Whether profiles (S, D) are equally bright on both sides of a curve (3,) [m]. If the profiles
    are equally bright, the curve is not an edge but a line on the plate or the table."""
    curve_offset = curve[0] + curve[1] * along + curve[2] * (1 - along**2)
    from_curve = (offset - curve_offset[:, None]) / (offset[1] - offset[0])
    sides = []
    for sign in (-1, 1):
        beside = (
            (sign * from_curve >= SIDE_PX[0])
            & (sign * from_curve <= SIDE_PX[1])
            & np.isfinite(profile)
        )
        if not np.any(beside):
            return True
        sides.append(float(np.median(profile[beside])))
    return abs(sides[1] - sides[0]) < MIN_STEP


def _find_steps(profile: np.ndarray, offset: np.ndarray) -> list[np.ndarray]:
    """Return the offsets (S, CANDIDATES) [m] of the strongest falling steps of profiles (S, D), and
    of the strongest rising steps. The offsets of missing steps are NaN."""
    reach = np.arange(-4, 5)
    kernel = -reach * np.exp(-(reach**2) / 4.5)
    # with this scale, the response to a brightness step is the height of the step
    kernel = 2 * kernel / np.sum(np.abs(kernel))
    slope = np.stack([np.convolve(row, kernel[::-1], mode="valid") for row in profile])
    offset_inside = offset[4:-4]
    noise = 1.4826 * float(np.nanmedian(np.abs(slope - np.nanmedian(slope))))
    threshold = max(MIN_STEP, NOISE_STEPS * noise)
    result = []
    for sign in (1.0, -1.0):
        height = np.nan_to_num(sign * slope, nan=0.0)
        left, middle, right = height[:, :-2], height[:, 1:-1], height[:, 2:]
        peak = np.where((middle > left) & (middle >= right) & (middle >= threshold), middle, 0.0)
        order = np.argsort(-peak, axis=1)[:, :CANDIDATES]
        rows = np.arange(len(peak))[:, None]
        bend = left + right - 2 * middle
        shift = np.divide(left - right, 2 * bend, out=np.zeros_like(bend), where=bend < 0)
        place = offset_inside[1:-1][order] + shift[rows, order] * (
            offset_inside[1] - offset_inside[0]
        )
        result.append(np.where(peak[rows, order] > 0, place, np.nan))
    return result


def _fit_curve(
    drawn: np.ndarray, every: np.ndarray, along: np.ndarray, tolerance: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, float]:  # fmt: skip
    """Return the curve (3,) [m] that is near the candidates of the largest number of profiles, and
    the fraction of profiles with a candidate near it (RANSAC).

    `drawn` (S, C) contains the offsets [m] of up to C candidates in each of S profiles. Each trial
    curve passes through three of the candidates. The best curve is refined by least squares with
    the candidates of `every` (S, C) [m].
    """
    rows = np.flatnonzero(np.any(np.isfinite(drawn), axis=1))
    if len(rows) < SUPPORT * len(along):
        return np.full(3, np.nan), 0.0
    terms = np.column_stack([np.ones_like(along), along, 1 - along**2])
    # Each draw uses one profile from each third of the edge, so that the three profiles are far
    # from each other.
    thirds = np.array_split(rows, 3)
    pick = np.stack([rng.choice(third, DRAWS) for third in thirds], axis=1)  # (DRAWS, 3)
    count = np.sum(np.isfinite(drawn), axis=1)
    finite_first = np.argsort(~np.isfinite(drawn), axis=1, kind="stable")
    take = (rng.random((DRAWS, 3)) * count[pick]).astype(int)
    value = drawn[pick, finite_first[pick, take]]
    curve = np.linalg.solve(terms[pick], value[..., None])[..., 0]
    from_curve = np.abs(drawn[None] - (curve @ terms.T)[:, :, None])
    hits = np.sum(
        np.nanmin(np.where(np.isfinite(from_curve), from_curve, np.inf), axis=2) <= tolerance,
        axis=1,
    )
    best = curve[np.argmax(hits)]
    for _ in range(4):
        from_curve = np.where(np.isfinite(every), np.abs(every - (terms @ best)[:, None]), np.inf)
        nearest = np.argmin(from_curve, axis=1)
        inlier = from_curve[np.arange(len(along)), nearest] <= tolerance
        if np.count_nonzero(inlier) < SUPPORT * len(along):
            return best, 0.0
        value = every[np.arange(len(along)), nearest]
        best = np.linalg.lstsq(terms[inlier], value[inlier], rcond=None)[0]
    return best, float(np.mean(inlier))


@dataclass(frozen=True)
class Deviation:
    """Deviation of the measured outline from the predicted outline.

    Attributes
    ----------
    shift : (float, float)
        Shift of the plate's centre [m, plate_home].
    rotation : float
        Rotation [rad], counter-clockwise.
    stretch : (float, float)
        Relative change of length and width [-].
    bow, bow_px : float
        Mean outward distance of the edges' middles relative to their ends, in metres and in pixels.
    bowed : bool
        Whether the edges are bent, and all to the same side.
    rest : float
        Maximum residual of an edge's end after shift, rotation and stretch [m].
    worst : float
        Maximum error of a part's place [m].
    """

    shift: tuple[float, float]
    rotation: float
    stretch: tuple[float, float]
    bow: float
    bow_px: float
    bowed: bool
    rest: float
    worst: float


def measure_deviation(outline: Outline, grid: OutlineGrid) -> Deviation:
    """Return the deviation of an outline with at least `MIN_EDGES` visible edges.

    n is the outward normal of an edge, p a point of the edge, and s the stretch. The least-squares
    fit solves this equation for all points: n . (shift + turn (-p_y, p_x) + (s_x p_x, s_y p_y)) =
    measured outward distance.
    """
    seen = np.flatnonzero(outline.seen)
    ends = np.array([-1.0, 1.0])
    point = edge_points(grid.half, ends)[seen]  # (n, 2, 2)
    normal = np.repeat(OUTWARD[seen][:, None], 2, axis=1)
    turned = np.stack([-point[..., 1], point[..., 0]], axis=-1)
    terms = np.concatenate(
        [normal, np.sum(normal * turned, axis=-1, keepdims=True), normal * point], axis=-1
    ).reshape(-1, 5)
    middle, slope, bow = outline.edges[seen].T
    offset = (middle[:, None] + slope[:, None] * ends).ravel()
    motion = np.linalg.lstsq(terms, offset, rcond=None)[0]
    # If an edge is not visible, the shift and the stretch across this edge cannot be separated.
    # Therefore, the stretch is assumed to be equal along both axes.
    if len(seen) < 4:
        same = np.column_stack([terms[:, :3], terms[:, 3] + terms[:, 4]])
        found = np.linalg.lstsq(same, offset, rcond=None)[0]
        motion = np.array([*found, found[3]])
        terms = np.column_stack([same[:, :3], terms[:, 3:]])
    x, y, rotation, along, across = motion.tolist()
    corners = edge_points(grid.half, ends).reshape(-1, 2)
    moved = motion[:2] + rotation * np.column_stack([-corners[:, 1], corners[:, 0]])
    moved = moved + corners * motion[3:]
    bow_px = bow * grid.scale[seen]
    bent = np.abs(bow) > np.maximum(BOW_M, BOW_PX / grid.scale[seen])
    mean, min_bow = float(np.mean(bow)), np.min(np.sign(np.mean(bow)) * bow_px)
    bowed = np.count_nonzero(bent) >= 2 and float(min_bow) > -0.2 * float(np.max(np.abs(bow_px)))
    rest = float(np.max(np.abs(offset - terms @ motion)))
    worst = max(float(np.max(np.hypot(*moved.T))), float(np.max(np.abs(bow))), rest)
    return Deviation(
        (x, y), rotation, (along, across), mean, float(np.mean(bow_px)), bool(bowed), rest, worst
    )


@dataclass(frozen=True, eq=False)
class OutlineCheck:
    """Evaluation of the outline over several images.

    Attributes
    ----------
    grid : OutlineGrid
    radius : float
        Radius of a part [m]. If the outline deviates by more than this radius, the finding is an
        error.
    bends : bool
        Whether the calibration has a lens.
    marked : bool
        Whether markers determine the calibration. Then only the bow of the edges is evaluated,
        which shows a wrong lens.
    measured : tuple of Outline
        Outlines of the images of this evaluation so far.
    moving : bool
        Whether the plate may have moved during these images.
    stamp : float
        Stamp of the last of these images [s].
    finding : Finding or None
        The deviation as a finding; None if there is no deviation, or no result yet.
    text : str
        Short text of the result.
    done : bool
        Whether the outline has been evaluated.
    agrees : bool
        Whether the outline agreed with the prediction.
    images : int
        Number of images of an evaluation.
    """

    grid: OutlineGrid
    radius: float
    bends: bool
    marked: bool = False
    measured: tuple[Outline, ...] = ()
    moving: bool = False
    stamp: float = -np.inf
    finding: Finding | None = None
    text: str = "not measured yet"
    done: bool = False
    agrees: bool = False
    images: int = IMAGES

    @classmethod
    def of(cls, rig: Rig, calibration: Calibration, images: int = IMAGES) -> OutlineCheck:
        """Start the check for the plate of a rig and a calibration."""
        grid = OutlineGrid.of(rig, calibration)
        marked = rig.fiducials is not None
        radius, bends = rig.parts.radius_m, calibration.lens is not None
        return cls(grid, radius, bends, marked, images=images)

    def add(self, image: np.ndarray, stamp: float, moving: bool = False) -> OutlineCheck:
        """Return the check with one more image (H, W) or (H, W, 3) uint8 and its stamp [s]. If
        `moving`, the plate may be away from home in the image.

        After `images` images the outline is evaluated. The evaluation is repeated at intervals
        until the outline of a plate at rest agrees. No evaluation is repeated while the plate
        moves.
        """
        waits = self.done and not self.measured
        waits = waits and (moving or 0 <= stamp - self.stamp < self._recheck_interval_s)
        if self.agrees or waits:
            return self
        measured = (*self.measured, measure_outline(image, self.grid))
        check = replace(self, measured=measured, stamp=stamp, moving=self.moving or moving)
        return check._evaluate(image) if len(measured) >= self.images else check

    @property
    def _recheck_interval_s(self) -> float:
        return UNSEEN_S if self.finding is None else RECHECK_S

    def _evaluate(self, image: np.ndarray) -> OutlineCheck:
        """Return a copy with the result of all images. `image` is the last image."""
        grid = self.grid
        every = np.stack([measurement.edges for measurement in self.measured])
        often = np.sum(np.isfinite(every[:, :, 0]), axis=0) > self.images / 2
        edges, moving = np.full((4, 3), np.nan), self.moving
        for edge in np.flatnonzero(often):
            rows = every[np.isfinite(every[:, edge, 0]), edge]
            edges[edge] = np.median(rows, axis=0)
            moving |= float(np.max(np.ptp(rows[:, :2], axis=0))) > REST_M
        outline = Outline(edges)
        facts = outline, grid, self.radius, self.bends, moving
        finding, text = evaluate_outline(*facts, marked=self.marked)
        seen = int(np.count_nonzero(outline.seen)) >= MIN_EDGES
        if not self.marked and (finding is not None or not seen):
            finding, text = evaluate_outline(*facts, find_fitting_flips(image, grid))
        if moving and finding is None and self.finding is not None:
            # Keep the last finding: images of a moving plate cannot prove that it is no longer
            # true.
            finding, text = self.finding, self.text
        agrees = finding is None and seen and not moving
        return replace(
            self, measured=(), moving=False, finding=finding, text=text, done=True, agrees=agrees
        )


def evaluate_outline(
    outline: Outline,
    grid: OutlineGrid,
    radius: float,
    bends: bool,
    moving: bool = False,
    flips: tuple[str, ...] = (),
    marked: bool = False,
) -> tuple[Finding | None, str]:
    """Return a finding (None if the outline agrees), and the result as short text.

    `radius` is the radius of a part [m]. `bends` is true if a lens is known. `moving` is true if
    the plate may be away from home by the motors' stroke. `flips` are the flips of the image with
    which the outline agrees. `marked` is true if markers determine the calibration. Then only edges
    that bend cause a finding, because the markers do not show a wrong lens.
    """
    count = int(np.count_nonzero(outline.seen))
    if count < MIN_EDGES:
        if flips:
            return _flip_finding(flips)
        return None, "not seen" if count == 0 else f"not seen, only {count} of 4 edges"
    found = measure_deviation(outline, grid)
    stroke = grid.stroke if moving else 0.0
    shifted = np.hypot(*found.shift) > grid.near + np.sqrt(2) * stroke
    turned = abs(found.rotation) > MAX_ROTATION_RAD + 2 * stroke / float(grid.half.min())
    pixel = 1 / float(np.median(grid.scale))
    stretched = max(map(abs, found.stretch)) > max(STRETCH, pixel / float(grid.half.min()))
    reshaped = found.rest > grid.near
    if marked and not found.bowed:
        return None, "its edges are as straight as predicted"
    if not (shifted or turned or stretched or reshaped or found.bowed):
        if moving:
            return None, "its shape is as predicted, but the plate moves"
        return None, f"as predicted, within {1e3 * found.worst:.2g} mm"
    if flips and (found.bowed or reshaped or found.worst > MOVED_RADII * radius):
        return _flip_finding(flips)
    cause = _lens_cause(found, bends) if found.bowed else _camera_cause(found)
    if flips:
        cause += f"; or the image is {' or '.join(flips)}"
    level = Level.ERROR if flips or found.worst > radius + stroke else Level.WARN
    source = "the markers" if marked else "corners_px"
    message = (
        f"the plate's outline differs from that of {source} and the lens: {cause}; positions of "
        f"parts are wrong by up to {1e3 * found.worst:.2g} mm"
    )
    return Finding(level, message), cause


def _flip_finding(flips: tuple[str, ...]) -> tuple[Finding, str]:
    cause = f"the image is {' or '.join(flips)}"
    message = (
        f"{cause}, because the plate's outline agrees with corners_px only in this way; change it "
        "in the camera's driver, or measure corners_px in the unchanged image"
    )
    return Finding(Level.ERROR, message), cause


def _lens_cause(found: Deviation, bends: bool) -> str:
    side = "outwards" if found.bow > 0 else "inwards"
    kind = "barrel" if found.bow > 0 else "pincushion"
    bent = f"its edges bend {side} by {abs(found.bow_px):.1f} px in the middle"
    if bends:
        return (
            f"{bent}, because the lens data do not fit this camera: the images may be rectified "
            "already, or focus or zoom was changed (calibrate lens, then set camera_file)"
        )
    return f"{bent}, because the {kind} distortion is unknown (calibrate lens, then camera_file)"


def _camera_cause(found: Deviation) -> str:
    (x, y), (along, across) = found.shift, found.stretch
    is_ = ["it"]
    if np.hypot(x, y) >= SHIFT_TEXT_M:
        x_mm, y_mm = (
            round(1e3 * value, 1) + 0.0 for value in (x, y)
        )  # adding 0.0 changes -0.0 to 0.0
        is_.append(f"is shifted by ({x_mm:.1f}, {y_mm:.1f}) mm")
    if abs(found.rotation) >= MIN_TEXT_ROTATION_RAD:
        is_.append(f"is rotated by {np.degrees(found.rotation):.1f} degrees")
    differ = abs(along - across) > STRETCH
    if differ:
        is_.append(f"is {_percent(along)} in length and {_percent(across)} in width")
    elif abs(along + across) / 2 >= STRETCH_TEXT:
        is_.append(f"is {_percent((along + across) / 2)}")
    if len(is_) == 1:
        is_.append(f"has another shape, with an error of {1e3 * found.rest:.1f} mm")
    moved = " and ".join([" ".join(is_[:2]), *is_[2:]])
    if differ:
        return (
            f"{moved}, because corners_px, or length_m and width_m of the plate, are wrong, or the "
            "camera was tilted (measure them again)"
        )
    return (
        f"{moved}, because the camera was moved or zoomed, or corners_px are wrong (measure them "
        "again)"
    )


def _percent(change: float) -> str:
    return f"{100 * abs(change):.1f} % {'larger' if change >= 0 else 'smaller'}"


def find_fitting_flips(image: np.ndarray, grid: OutlineGrid) -> tuple[str, ...]:
    """Return the flips with which the outline in an image (H, W) or (H, W, 3) agrees on all four
    edges. The flips are those of `FLIPS`, and for a square image also those of `QUARTER_TURNS`. The
    result is empty if the outline agrees without a flip."""
    if np.all(measure_outline(image, grid, grid.near).within(grid.near)):
        return ()
    undone = {name: image[::down, ::across] for name, (down, across) in FLIPS.items()}
    if image.shape[0] == image.shape[1]:
        undone |= {name: np.rot90(image, turns) for name, turns in QUARTER_TURNS.items()}
    names = []
    for name, upright in undone.items():
        outline = measure_outline(np.ascontiguousarray(upright), grid, grid.near)
        if np.all(outline.within(grid.near)):
            names.append(name)
    return tuple(names)
