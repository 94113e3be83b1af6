"""Measurements in a picture while a user aims and focuses a camera and adjusts the light. This
module does not use ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from plate_core import Rig
from plate_core.status import Finding, Level

from .camera import Lens, grey_levels
from .overlooked import Expected
from .plate import light_problem
from .plate.outline import (
    OUTWARD,
    Outline,
    OutlineGrid,
    contrast_channel,
    edge_points,
    evaluate_outline,
    find_fitting_flips,
)
from .vision import Vision

AROUND = 0.03
"""Margin around the plate in which sharpness is also measured, relative to the plate's larger side
in the image [-]. The margin contains the plate's edges, which are the only edges in the image of a
bare plate."""

SMOOTH_PX = 1.0
"""Standard deviation of the Gaussian filter that reduces noise before the gradient is computed
[px]."""

MIN_CONTRAST = 4.0
"""Minimum standard deviation of the grey levels for a measurement of sharpness. If the lens is
covered, noise alone causes a standard deviation of about 2."""

BINS = 64
"""Number of bins of the histogram. Each bin has four grey levels."""

CLIPPED = 0.01
"""Maximum fraction of the plate's pixels at grey level 0, and maximum fraction of its pixels with a
channel at 255 [-]. Reflections of a part cover smaller fractions than this maximum."""

BLURRED = 0.85
"""Minimum sharpness of an image in focus, relative to the maximum of the last minute [-]. Noise or
a moved part changes the sharpness by less than 5 %."""

PASSED, BACK = 0.9, 0.95
"""Two limits of the sharpness, relative to its maximum in the last minute [-]. The lens was moved
through the focus if the sharpness was below `PASSED` before its maximum, and again after it. The
image is back in focus if the present sharpness is at least `BACK`."""

SHARP_PX = 1.5
"""Maximum standard deviation of the blur of the plate's edges in a sharp picture [px]. Synthetic
pictures have a blur of 1.0 px with a sharp lens, of 1.4 px with a defocus of 1 px, and of 2.2 px
with a defocus of 2 px."""

ESF_PX = 12
"""Length of the grey-level profile on each side of the plate's edge [px]. The blur is measured in
this profile."""

ESF_ENDS = 4
"""Number of values at each end of the profile. The contrast is the difference of the medians of
both ends."""

BEST_S, LATELY_S = 60.0, 2.0
"""`BEST_S`: time over which the maximum sharpness is determined [s]. `LATELY_S`: time over which
the change of the sharpness is measured [s]."""

STEADY = 0.04
"""Maximum relative change of the sharpness that counts as noise [-]."""

MIN_PART_PX = 10.0
"""Minimum diameter of a part in the image [px]. For parts below this diameter, the standard
deviation of positions exceeds 0.05 px, and marks are not detected."""

EDGE_POINTS = 9
"""Number of displayed points on each measured edge of the plate."""


@dataclass(frozen=True, eq=False)
class AimField:
    """The measured region of a picture. This region is computed again if `vision.region` changes.

    Attributes
    ----------
    vision : Vision
    rows, columns : slice
        Window of the picture that contains the plate and its surround.
    plate, around : (h, w) uint8
        Masks of this window. `plate` is 255 on the plate, `around` is 255 on the plate and its
        surround. Both masks are 0 elsewhere.
    grid : OutlineGrid
        Image points at which the plate's edges are searched.
    part_px : (float, float)
        Range of the parts' diameters in the image [px]. The range extends from the smallest part at
        the smallest image scale to the largest part at the largest scale. The scale is evaluated at
        the plate's centre and at points of its edges.
    radius : float
        Radius of a part [m].
    """

    vision: Vision
    rows: slice
    columns: slice
    plate: np.ndarray
    around: np.ndarray
    grid: OutlineGrid
    part_px: tuple[float, float]
    radius: float

    @classmethod
    def of(cls, rig: Rig, vision: Vision, expected: Expected) -> AimField:
        """Return the measured region for a rig. `expected` contains the sizes of the rig's
        parts."""
        width, height = vision.region.size_px
        outline = np.rint(vision.region.outline_px).astype(np.int32)
        plate = np.zeros((height, width), np.uint8)
        cv2.fillPoly(plate, [outline], 255)
        reach = max(2, round(AROUND * float(np.max(np.ptp(outline, axis=0)))))
        around = cv2.dilate(plate, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        x, y, w, h = cv2.boundingRect(around)
        rows, columns = slice(y, y + h), slice(x, x + w)
        grid = OutlineGrid.of(rig, vision.calibration)
        edges = edge_points(grid.half, np.linspace(-1, 1, EDGE_POINTS)).reshape(-1, 2)
        scale = vision.calibration.scale(np.vstack([edges, np.zeros((1, 2))]))
        part_px = (2 * expected.smallest * float(scale.min()),
                   2 * expected.largest * float(scale.max()))  # fmt: skip
        return cls(
            vision, rows, columns, plate[rows, columns], around[rows, columns], grid, part_px,
            rig.parts.radius_m,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Light:
    """Brightness of the plate.

    Attributes
    ----------
    histogram : (BINS,) int
        Number of pixels in each bin of four grey levels.
    black : float
        Fraction of the pixels at grey level 0 [-].
    white : float
        Fraction of the pixels with a channel at 255 [-].
    """

    histogram: np.ndarray
    black: float
    white: float


def measure_light(image: np.ndarray, field: AimField) -> Light:
    """Measure the light on the expected area of the plate in an image (H, W) or (H, W, 3) uint8."""
    part = np.ascontiguousarray(image[field.rows, field.columns])
    grey = grey_levels(part)
    levels = cv2.calcHist([grey], [0], field.plate, [256], [0, 256]).ravel()
    brightest = part if part.ndim == 2 else part.max(axis=2)
    burnt = cv2.calcHist([brightest], [0], field.plate, [256], [0, 256]).ravel()
    count = max(float(levels.sum()), 1.0)
    histogram = levels.reshape(BINS, -1).sum(axis=1).astype(int)
    return Light(histogram, float(levels[0]) / count, float(burnt[255]) / count)


def measure_sharpness(image: np.ndarray, field: AimField) -> float:
    """Return the sharpness of an image (H, W) or (H, W, 3) uint8 around the plate [1/px].

    The sharpness is the root mean square of the gradient (Tenengrad), divided by the standard
    deviation of the grey levels. The division makes the sharpness independent of the brightness.
    The result is NaN if the contrast is less than `MIN_CONTRAST`.
    """
    grey = grey_levels(np.ascontiguousarray(image[field.rows, field.columns])).astype(np.float32)
    _, deviation = cv2.meanStdDev(grey, mask=field.around)
    contrast = float(deviation[0, 0])
    if contrast < MIN_CONTRAST:
        return math.nan
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125)
    power = cv2.mean(across * across + down * down, mask=field.around)[0]
    return math.sqrt(power) / contrast


def edge_blur_px(image: np.ndarray, outline: Outline, field: AimField) -> float:
    """Return the standard deviation of the blur of the plate's edges in an image (H, W) or (H, W,
    3) [px]. The result is the median of contrast / (sqrt(2 pi) slope) over the visible edges. The
    result is NaN if no edge is visible."""
    calibration, along = field.vision.calibration, field.grid.along
    grey = contrast_channel(image, field.grid)
    middle, slope, bow = (column[:, None] for column in outline.edges.T)
    edge_offset = middle + slope * along + bow * (1 - along**2)
    foot = edge_points(field.grid.half, along)
    steps = np.arange(-ESF_PX, ESF_PX + 1.0)
    blurs = []
    for edge in np.flatnonzero(outline.seen):
        offset = edge_offset[edge, :, None] + steps / field.grid.scale[edge]
        point = foot[edge, :, None] + offset[..., None] * OUTWARD[edge]
        x, y = calibration.to_image(point.reshape(-1, 2)).reshape(*offset.shape, 2).T
        x, y = (np.nan_to_num(axis, nan=-1e4).astype(np.float32) for axis in (x, y))
        profile = np.median(cv2.remap(grey, x, y, cv2.INTER_LINEAR), axis=1)
        contrast = abs(float(np.median(profile[:ESF_ENDS]) - np.median(profile[-ESF_ENDS:])))
        steepest = float(np.abs(np.diff(profile)).max())
        blurs.append(contrast / (math.sqrt(2 * math.pi) * max(steepest, 1e-9)))
    return float(np.median(blurs)) if blurs else math.nan


@dataclass(frozen=True)
class Focus:
    """The sharpness of the last minute, and whether the focus was found.

    The focus is found if the plate's edges are sharp, or if the sharpness rose, fell, and is back
    near its maximum. The focus is lost if the sharpness falls far below its maximum.

    Attributes
    ----------
    values : tuple of (float, float)
        Stamps [s] and sharpness [1/px] of the images, oldest first.
    blur_px : float
        Blur of the plate's edges in the newest image [px]. NaN if the blur is unknown.
    peaked : bool
        Whether the sharpness has passed its maximum since the focus was last lost.
    sharp : bool
        Whether the edges were sharp in the last image in which their blur could be measured. False
        after the focus was lost.
    """

    values: tuple[tuple[float, float], ...] = ()
    blur_px: float = math.nan
    peaked: bool = False
    sharp: bool = False

    def add(self, stamp: float, sharpness: float, blur_px: float = math.nan) -> Focus:
        """Return a copy with the stamp [s], the sharpness [1/px] and the blur of the plate's edges
        [px] of one more image. If this stamp is not later than the last one, because the clock was
        set back, the earlier images are dropped."""
        kept = self.values if self.values and stamp > self.values[-1][0] else ()
        values = (
            *(measured for measured in kept if measured[0] > stamp - BEST_S),
            (stamp, sharpness),
        )
        focus = replace(self if kept else Focus(), values=values, blur_px=blur_px)
        lost = not focus.now >= BLURRED * focus.best
        known = math.isfinite(blur_px)
        return replace(
            focus,
            peaked=not lost and (focus.peaked or focus._has_passed_maximum),
            sharp=not lost and (blur_px <= SHARP_PX if known else focus.sharp),
        )

    @property
    def _has_passed_maximum(self) -> bool:
        """Whether the sharpness rose, fell, and is back near its maximum."""
        value = np.array([value for _, value in self.values if math.isfinite(value)])
        best = int(np.argmax(value)) if len(value) else 0
        before, after = value[:best], value[best + 1 :]
        if not (len(before) and len(after)):
            return False
        low = PASSED * value[best]
        return bool(before.min() < low and after.min() < low and self.now >= BACK * value[best])

    @property
    def now(self) -> float:
        """The newest sharpness [1/px]. NaN if the sharpness could not be measured."""
        return self.values[-1][1] if self.values else math.nan

    @property
    def best(self) -> float:
        """The maximum sharpness of the last minute [1/px]. NaN if no sharpness was measured."""
        known = [value for _, value in self.values if math.isfinite(value)]
        return max(known, default=math.nan)

    @property
    def change(self) -> float:
        """Relative change of the sharpness during the last `LATELY_S` [-]. The change is the mean
        of the second half of this time divided by the mean of the first half, minus one. NaN if one
        of the halves contains no value."""
        if not self.values:
            return math.nan
        age = self.values[-1][0] - np.array([stamp for stamp, _ in self.values])
        value = np.array([value for _, value in self.values])
        late, early = age < LATELY_S / 2, (age >= LATELY_S / 2) & (age <= LATELY_S)
        known = np.isfinite(value)
        if not (np.any(late & known) and np.any(early & known)):
            return math.nan
        return float(np.mean(value[late & known]) / np.mean(value[early & known])) - 1

    @property
    def trend(self) -> str:
        """Description of the change of the sharpness: steady, rises or falls."""
        change = self.change
        if not math.isfinite(change) or abs(change) <= STEADY:
            return "steady"
        return "rises" if change > 0 else "falls"

    @property
    def finding(self) -> Finding:
        """Finding about the focus, with a remedy if the image is not in focus."""
        if not math.isfinite(self.now):
            text = "too little contrast to measure the sharpness; check that the lens is uncovered"
            return Finding(Level.ERROR, text)
        text = f"sharpness is {self.now:.3f} per px and {self.trend}"
        ratio = self.now / self.best
        if ratio < BLURRED:
            why = f"{ratio:.0%} of the last minute's best value ({self.best:.3f})"
            why += "; turn the focus back"
            return Finding(Level.WARN, f"{text}, {why}")
        edges = ""
        if math.isfinite(self.blur_px):
            edges = f"; blur of the plate's edges is {self.blur_px:.1f} px"
        if self.sharp or self.peaked:
            return Finding(Level.OK, f"{text}; best value is {self.best:.3f}{edges}")
        advice = "turn the focus past the best value and back"
        if edges:
            return Finding(Level.WARN, f"{text}{edges}, allowed: up to {SHARP_PX:g} px; {advice}")
        return Finding(Level.STALE, f"{text}; the best value is not known yet; {advice}")


def outline_px(outline: Outline, field: AimField) -> np.ndarray:
    """Return points (m, 2) [px] on the detected edges of the plate."""
    along = np.linspace(-1, 1, EDGE_POINTS)
    middle, slope, bow = (column[:, None] for column in outline.edges.T)
    edge_offset = middle + slope * along + bow * (1 - along**2)
    point = edge_points(field.grid.half, along) + edge_offset[..., None] * OUTWARD[:, None]
    return field.vision.calibration.to_image(point[outline.seen].reshape(-1, 2))


def outline_finding(
    image: np.ndarray, outline: Outline, field: AimField, moving: bool = False
) -> Finding:
    """Return a finding about the outline in an image (H, W) or (H, W, 3). The finding states
    whether this outline agrees with the expected outline.

    If `moving` is true, the plate may be away from home.
    """
    grid, bends = field.grid, field.vision.calibration.lens is not None
    facts = outline, grid, field.radius, bends, moving
    finding, text = evaluate_outline(*facts)
    seen = int(np.count_nonzero(outline.seen))
    if finding is not None:
        finding, text = evaluate_outline(*facts, find_fitting_flips(image, grid))
    if finding is not None:
        return finding
    if seen < 3:
        hint = "move the camera until the plate fills the drawn outline, or call find_home"
        return Finding(Level.WARN, f"the plate's outline is {text}: {hint}")
    return Finding(Level.OK, text)


def light_finding(image: np.ndarray, light: Light, field: AimField) -> Finding:
    """Return a finding about the light in an image (H, W) or (H, W, 3), with the remedy."""
    vision = field.vision
    problem = light_problem(image, vision.options.min_plate_grey, vision.lit_region)
    if problem:
        return Finding(Level.ERROR, problem)
    if light.white > CLIPPED:
        why = "clipped at 255; reduce light or exposure"
        return Finding(Level.WARN, f"{light.white:.1%} of the plate's pixels are {why}")
    if light.black > CLIPPED:
        why = "clipped at 0; increase light, exposure or black level"
        return Finding(Level.WARN, f"{light.black:.1%} of the plate's pixels are {why}")
    middle = (float(np.argmax(np.cumsum(light.histogram) * 2 >= light.histogram.sum())) + 0.5) * 4
    few = f"at most {CLIPPED:.0%} of its pixels are clipped"
    return Finding(Level.OK, f"median brightness of the plate is {middle:.0f} grey levels; {few}")


def size_finding(part_px: tuple[float, float]) -> Finding:
    """Return a finding that states whether parts are large enough in the image. `part_px` contains
    the minimum and the maximum diameter of the parts [px]."""
    low, high = part_px
    text = f"diameter of the parts is {low:.1f} to {high:.1f} px"
    if low < MIN_PART_PX:
        why = f"allowed: at least {MIN_PART_PX:g} px (move the camera nearer, or use more pixels)"
        return Finding(Level.WARN, f"{text}, {why}")
    return Finding(Level.OK, text)


@dataclass(frozen=True)
class Thing:
    """An object in an image: a part, or an object that is rejected as a part.

    Attributes
    ----------
    id : str
        Id of the part. Empty if the object is not a part.
    x_px, y_px, radius_px : float
        Centre of the object, and radius of the disc with the same area [px].
    reason, remedy : str
        Reason why the object is rejected as a part, and the remedy. Both texts are empty for a
        part.
    """

    id: str
    x_px: float
    y_px: float
    radius_px: float
    reason: str = ""
    remedy: str = ""


@dataclass(frozen=True, eq=False)
class Situation:
    """State of the detector when it measures a picture for the view in which a user aims the
    camera.

    Attributes
    ----------
    rig : Rig
    vision : Vision
    expected : Expected
        Sizes of the rig's parts.
    things : tuple of Thing
        Parts and rejected objects in the last image that was not refused.
    findings : tuple of (str, Finding)
        Names and findings that do not depend on this picture. An example is the state of the lens.
    lens : Lens or None
        Lens in use. None: the lens of the rig file, if the file has one.
    moving : bool
        Whether the plate may be away from home.
    """

    rig: Rig
    vision: Vision
    expected: Expected
    things: tuple[Thing, ...]
    findings: tuple[tuple[str, Finding], ...]
    lens: Lens | None
    moving: bool
