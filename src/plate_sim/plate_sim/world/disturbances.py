"""What a real rig has and a model leaves out. All of it off by default."""

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
    ROOM,
    SHADOW_DEG,
    SHADOW_M,
    SIDE_SHADE,
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
"""Allowed values."""

FLICKER_HZ = 97.0
"""Default frequency of flicker [Hz]: that of mains light, but no multiple of the images' rate."""

SLOWEST_RATE = 1.0
"""Of a camera that runs free [1/s]: the next image of a slower one is taken for missing."""


@dataclass(frozen=True)
class Disturbances:
    """How far the world is from the model.

    Attributes
    ----------
    friction_spread : float
        Friction differs between parts by up to this share, evenly.
    friction_patches : float
        Friction differs over the plate by up to this share, evenly (`friction_field`).
    static_ratio : float
        Static over dynamic friction.
    friction_slope : float
        How friction changes with the slip [1/(m/s)] (`Ground`).
    heave : float
        How far the plate moves up and down, over its motion along x (`Ground`).
    tilt_x, tilt_y : float
        How far the plate leans [rad]: parts are pulled along +x and +y if positive.
    latency : float
        An image is this old [s] when it is delivered. Its stamp is the time of delivery, as a
        camera's driver gives it that does not know better.
    image_rate : float
        Images a second of a camera that runs free; 0: it is triggered at the start of each cycle.
        Their latency counts from the middle of the exposure, with a trigger from its beginning.
    stamp_jitter : float
        Standard deviation of the stamps of a camera that runs free [s]; they keep their order.
    blur : bool
        Whether motion blurs images over the rig's exposure.
    missed_images : float
        Share of images that are never delivered.
    missed_parts : float
        Share of parts that an image does not show.
    false_parts : float
        False parts, over true ones, that an image shows: reflections and specks.
    highlights : float
        Share of each part's area on which it mirrors the light.
    shadows : float
        How much darker the plate is in the parts' shadows, as a share.
    pick_failure : float
        Share of the robot's grips in which the part slips.
    part_height_m : float
        Height of all parts in images [m], whatever the rig file says; 0: that of the rig file.
        Height changes images only: parts neither roll nor topple.
    side_shade : float
        Brightness of parts' side faces, over that of their tops.
    size_spread : float
        In images, parts are larger or smaller than their type by up to this fraction, evenly. Parts
        touch each other as their types do.
    gloss : float
        Radius of the lamp's image on each part, over the part's radius (`Lighting`).
    shadow_length_m, shadow_deg, penumbra_m : float
        Length [m], direction from x [degrees], and width of the soft edge [m] of `shadows`.
    light_step, light_step_s : float
        The light changes by this fraction at this time [s] from the beginning, and stays so.
    flicker, flicker_hz : float
        The light of each image differs by up to this fraction to either side, as a sinusoid of
        this frequency [Hz].
    defocus_px : float
        Standard deviation of the Gaussian by which images are soft [px].
    plate_grey, room_grey, black_grey, grey_grey : float
        Grey values at full light: of plate and room, and of black and grey parts.

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
    room_grey: float = ROOM
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
        self.ground  # the two tilts together, too  # noqa: B018

    @cached_property
    def ground(self) -> Ground:
        """Return the plate's surface."""
        tilt = self.tilt_x, self.tilt_y
        return Ground(self.static_ratio, tilt, self.friction_slope, self.heave)

    @cached_property
    def greys(self) -> dict[str, float]:
        """Return the grey values of parts by class."""
        return {"black": self.black_grey, "grey": self.grey_grey}

    def lighting(self, time_s: float) -> Lighting:
        """Return the light of an image that is taken at a time from the beginning [s]."""
        level = 1 + self.flicker * math.sin(2 * math.pi * self.flicker_hz * time_s)
        if time_s >= self.light_step_s:
            level *= 1 + self.light_step
        return Lighting(
            self.highlights, self.shadows, self.shadow_length_m, self.shadow_deg, self.penumbra_m,
            self.gloss, self.side_shade, level,
        )  # fmt: skip

    @property
    def summary(self) -> str:
        """What differs from an undisturbed world: `latency 0.05, tilt_x 0.01`; `none`."""
        unlike = [
            f"{f.name} {getattr(self, f.name)}"
            for f in fields(self)
            if getattr(self, f.name) != f.default
        ]
        return ", ".join(unlike) or "none"


NONE = Disturbances()
"""A world as the model has it."""
