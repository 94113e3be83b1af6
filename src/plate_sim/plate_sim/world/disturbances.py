"""What a real rig has and a model leaves out. All of it off by default."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

from plate_core import PlateError

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
}
"""Allowed values."""

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
