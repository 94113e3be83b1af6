"""Disturbances of the simulation. Disturbances are effects of a real rig that the model neglects.
By default, all disturbances are off."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property

from plate_core import PlateError
from plate_core.rig import MAX_HEIGHT_M

from ..camera import (
    GREY_OF_CLASS,
    PENUMBRA_M,
    PLATE,
    SHADOW_DEG,
    SHADOW_M,
    SIDE_SHADE,
    SURROUNDINGS,
    Lighting,
)
from ..plate.ground import HEAVE, SLOPE, STATIC, TILT, Ground

RANGES: dict[str, tuple[float, float]] = {
    "friction_spread": (0.0, 0.9),
    "friction_patches": (0.0, 0.9),
    "static_ratio": STATIC,
    "friction_slope": SLOPE,
    "heave": HEAVE,
    "tilt_x": (-TILT, TILT),
    "tilt_y": (-TILT, TILT),
    "latency": (0.0, 1.0),
    "image_rate": (0.0, 200.0),
    "stamp_jitter": (0.0, 0.05),
    "missed_images": (0.0, 0.95),
    "missed_parts": (0.0, 1.0),
    "false_parts": (0.0, 1.0),
    "highlights": (0.0, 0.2),
    "shadows": (0.0, 0.9),
    "pick_failure": (0.0, 1.0),
    "part_height_m": (0.0, MAX_HEIGHT_M),
    "side_shade": (0.0, 2.0),
    "size_spread": (0.0, 0.5),
    "gloss": (0.0, 0.6),
    "shadow_length_m": (0.0, 0.1),
    "shadow_deg": (-360.0, 360.0),
    "penumbra_m": (0.0, 0.05),
    "light_step": (-0.9, 1.0),
    "light_step_s": (0.0, 3600.0),
    "flicker": (0.0, 0.5),
    "flicker_hz": (0.0, 1000.0),
    "defocus_px": (0.0, 20.0),
    "plate_grey": (0.0, 255.0),
    "room_grey": (0.0, 255.0),
    "black_grey": (0.0, 255.0),
    "grey_grey": (0.0, 255.0),
}
"""Allowed range of each disturbance."""

FLICKER_HZ = 97.0
"""Default frequency of flicker [Hz]. This frequency is close to the flicker of lamps on mains
power, and is not a multiple of usual image rates."""

SLOWEST_RATE = 1.0
"""Minimum image rate of a free-running camera [1/s]. At a lower rate, the other nodes would report
missing images."""


@dataclass(frozen=True)
class Disturbances:
    """Deviations of the simulated world from the rig model.

    Attributes
    ----------
    friction_spread : float
        Maximum relative deviation of a part's friction from the model. The deviations of the parts
        have a uniform distribution.
    friction_patches : float
        Maximum relative deviation of the friction at a place of the plate from the model. The
        deviations have a uniform distribution over the plate (`friction_field`).
    static_ratio : float
        Ratio of static to dynamic friction.
    friction_slope : float
        Relative change of friction with the slip speed [1/(m/s)], see `Ground`.
    heave : float
        Upward motion of the plate divided by its motion along x, see `Ground`.
    tilt_x, tilt_y : float
        Tilt of the plate along x and y [rad]. With positive values, gravity pulls parts along +x
        and +y.
    latency : float
        Time from the exposure of an image to its delivery [s]. The stamp of the image is the time
        of delivery, as with a real camera driver that does not know the time of exposure.
    image_rate : float
        Image rate of a free-running camera [1/s]. With 0, the start of each cycle triggers an
        image. The latency of a free-running camera begins in the middle of the exposure. The
        latency of a triggered camera begins at the start of the exposure.
    stamp_jitter : float
        Standard deviation of the stamps of a free-running camera [s]. The order of the stamps does
        not change.
    blur : bool
        Whether images show motion blur over the camera's exposure time.
    missed_images : float
        Fraction of images that are not delivered.
    missed_parts : float
        Fraction of the parts on the plate that an image does not show.
    false_parts : float
        Number of false parts in an image, divided by the number of true parts. False parts
        represent reflections and specks of dirt.
    highlights : float
        Fraction of the area of each part that a highlight covers.
    shadows : float
        Fraction by which the plate is darker in the shadows of parts.
    pick_failure : float
        Fraction of the robot's grips in which the part slips.
    part_height_m : float
        Height of all parts in images [m]. With 0, the height in the rig file is used. The height
        affects only images, because simulated parts neither roll nor topple.
    side_shade : float
        Brightness of the parts' side faces, divided by the brightness of their top faces.
    size_spread : float
        Maximum relative deviation of a part's size from the size of its type in images. The
        deviations have a uniform distribution. In contacts, parts have the sizes of their types.
    gloss : float
        Radius of the lamp's reflection on each part, divided by the part's radius (see `Lighting`).
    shadow_length_m, shadow_deg, penumbra_m : float
        Length of the shadows [m], their direction as an angle from the x axis [degrees], and the
        width of their soft edge [m].
    light_step, light_step_s : float
        Relative change of the brightness, and the time from the start of the simulation to this
        change [s]. The change is permanent.
    flicker, flicker_hz : float
        Relative amplitude and frequency [Hz] of a sinusoidal change of the brightness over time.
    defocus_px : float
        Standard deviation of the Gaussian blur that simulates defocus [px].
    plate_grey, room_grey, black_grey, grey_grey : float
        Grey values of the plate, the surroundings, black parts and grey parts at full brightness.

    Raises
    ------
    PlateError
        If a value is out of range.
    """

    friction_spread: float = 0.0
    friction_patches: float = 0.0
    static_ratio: float = 1.0
    friction_slope: float = 0.0
    heave: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    latency: float = 0.0
    image_rate: float = 0.0
    stamp_jitter: float = 0.0
    blur: bool = True
    missed_images: float = 0.0
    missed_parts: float = 0.0
    false_parts: float = 0.0
    highlights: float = 0.0
    shadows: float = 0.0
    pick_failure: float = 0.0
    part_height_m: float = 0.0
    side_shade: float = SIDE_SHADE
    size_spread: float = 0.0
    gloss: float = 0.0
    shadow_length_m: float = SHADOW_M
    shadow_deg: float = SHADOW_DEG
    penumbra_m: float = PENUMBRA_M
    light_step: float = 0.0
    light_step_s: float = 0.0
    flicker: float = 0.0
    flicker_hz: float = FLICKER_HZ
    defocus_px: float = 0.0
    plate_grey: float = PLATE
    room_grey: float = SURROUNDINGS
    black_grey: float = GREY_OF_CLASS["black"]
    grey_grey: float = GREY_OF_CLASS["grey"]

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise PlateError(f"{name} is {value!r}, allowed: {low:g} to {high:g}")
        if 0 < self.image_rate < SLOWEST_RATE:
            allowed = f"0, or {SLOWEST_RATE:g} to {RANGES['image_rate'][1]:g}"
            raise PlateError(f"image_rate is {self.image_rate:g}, allowed: {allowed}")
        if not isinstance(self.blur, bool):
            raise PlateError(f"blur is {self.blur!r}, allowed: true or false")
        self.ground  # creating `ground` checks the total tilt # noqa: B018

    @cached_property
    def ground(self) -> Ground:
        """Friction and tilt of the plate's surface."""
        tilt = self.tilt_x, self.tilt_y
        return Ground(self.static_ratio, tilt, self.friction_slope, self.heave)

    @cached_property
    def greys(self) -> dict[str, float]:
        """Grey values of the parts, by class."""
        return {"black": self.black_grey, "grey": self.grey_grey}

    def lighting(self, time_s: float) -> Lighting:
        """Return the lighting of an image that is taken `time_s` [s] after the start of the
        simulation."""
        level = 1 + self.flicker * math.sin(2 * math.pi * self.flicker_hz * time_s)
        if time_s >= self.light_step_s:
            level *= 1 + self.light_step
        return Lighting(
            self.highlights, self.shadows, self.shadow_length_m, self.shadow_deg, self.penumbra_m,
            self.gloss, self.side_shade, level,
        )  # fmt: skip

    @property
    def summary(self) -> str:
        """Text that lists all values that differ from their defaults, such as `latency 0.05, tilt_x
        0.01`. The text is `none` if all values are defaults."""
        unlike = [
            f"{f.name} {getattr(self, f.name)}"
            for f in fields(self)
            if getattr(self, f.name) != f.default
        ]
        return ", ".join(unlike) or "none"


NONE = Disturbances()
"""World without disturbances."""
