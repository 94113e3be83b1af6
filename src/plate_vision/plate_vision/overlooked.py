"""Overlooked objects: objects on the plate that the detector rejects as parts.

Each object has one of the reasons in `REASONS`. `OverlookedTally` counts the objects over several
images and returns a finding with the remedies. `may_be_parts` selects the objects that the planner
must treat as obstacles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from plate_core import GROUP, NAMELESS, PLAUSIBLE_AREA, Rig
from plate_core.status import Finding, Level

REASONS = (
    "too small",
    "too large",
    "too faint",
    "misfit",
    "at the edge",
    "beyond the plate",
    "group",
    "blurred",
    "unsettled",
)
"""Reasons why an object is not a part:

- "too small", "too large": the object is smaller or larger than the rig's parts.
- "too faint": the contrast of the object to the plate is too low.
- "misfit": the object has another shape than a part.
- "at the edge": the plate's edge cuts the object.
- "beyond the plate": the centre of the object is not on the plate.
- "group": the object consists of several parts that could not be separated.
- "blurred": the image is too blurred to recognise the type of the object.
- "unsettled": the object is a part in this image, but was not one in earlier images.
"""

OVERLOOKED = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("x", "f8"),
        ("y", "f8"),
        ("reason", "U16"),
    ]
)
"""One object that is rejected as a part, with these fields:

`x_px`, `y_px`: centre [px].
`radius_px`: radius of the disc of the same area [px].
`x`, `y`: centre [m, plate_home].
`reason`: one of `REASONS`.
"""

NONE_OVERLOOKED = np.empty(0, OVERLOOKED)
"""Empty array (0,) `OVERLOOKED`, for images without overlooked objects."""
NONE_OVERLOOKED.setflags(write=False)

APART = 0.9
"""Minimum distance between an object and a part, relative to the sum of their radii [-]. A nearer
object is the shadow or the side face of the part. For two parts that touch, the relative distance
is 1."""

WARN_FRACTION, WARN_COUNT = 0.1, 2
"""Minimum number of overlooked objects that cause a warning, as a fraction of all objects [-] and
as a number. A single object causes no warning, because it may be a tool or a marker that was put
there intentionally. If a part of a task is missing, the planner reports it."""

SPECK_RADIUS = 0.3
"""Minimum radius of an object that counts for the warning while parts are detected, relative to the
smallest part's radius [-]. An object with a tenth of a part's area is dust or a reflection."""

EDGE_REASONS = ("at the edge", "beyond the plate")
"""Objects with these reasons do not count for the warning. If the plate is away from home, the
plate's edge can be detected as such an object. This happens, for example, in images of a camera
that is not triggered."""

LARGE_RADII = 3.0
"""Minimum radius of an object that cannot be the shadow of a part, relative to the part's radius
[-]."""

COVER_RADII, EDGE_COVER_RADII = 4.0, 8.0
"""Minimum radius of an object that counts as covering the plate, inside the plate and at its edge,
relative to the largest part's radius [-]. Such objects are, for example, a hand, a cable, a lamp's
reflection, or rows that the camera lost. The visible strip beside a plate that is 10 mm away from
home is smaller than the second limit."""

REMEDIES = {
    "too faint": "use more light, or parts with more contrast to the plate",
    "at the edge": "move them inwards, or move the plate to home (the object may be its edge)",
    "beyond the plate": "check corners_px in section camera, or clear the surroundings",
    "group": "move them apart",
    "blurred": "focus the camera, or reduce the exposure time, to distinguish types",
    "unsettled": "wait for a few images, because light or shadow has changed",
}
"""Remedy for each reason. Reasons whose remedies depend on the rig are not included."""


def may_be_parts(
    things: np.ndarray,
    radius: np.ndarray,
    part_radius: float,
    inner: np.ndarray,
    centre: np.ndarray,
) -> np.ndarray:
    """Return which objects (n,) OVERLOOKED may be parts. An object may be a part if it has the size
    of a part, is on the plate, and does not belong to a detected part.

    Parameters
    ----------
    things : (n,) OVERLOOKED
    radius : (n,)
        Radii of the objects [m].
    part_radius : float
        Radius of a part [m].
    inner : (2,)
        Half side lengths of the plate's area in which objects count [m].
    centre : (M, 2)
        Centres of the parts in this image [m, plate_home].
    """
    place = np.column_stack([things["x"], things["y"]])
    area = (radius / part_radius) ** 2
    size = (PLAUSIBLE_AREA[0] <= area) & (area <= PLAUSIBLE_AREA[1])
    on_plate = np.all(np.abs(place) <= inner, axis=1)
    return np.asarray(size & on_plate & is_separate_object(things, radius, part_radius, centre))


def is_separate_object(
    things: np.ndarray, radius: np.ndarray, part_radius: float, centre: np.ndarray
) -> np.ndarray:
    """Return which objects (n,) OVERLOOKED do not belong to a detected part. The parameters are as
    in `may_be_parts`."""
    place = np.column_stack([things["x"], things["y"]])
    distance = np.hypot(*(place[:, None] - centre).transpose(2, 0, 1))
    is_apart = np.all(distance >= APART * (radius + part_radius)[:, None], axis=1)
    return np.asarray(is_apart | (radius > LARGE_RADII * part_radius))


def unnamed_objects(
    seen: np.ndarray, on_plate: np.ndarray, radius: np.ndarray, smallest: float, largest: float
) -> np.ndarray:
    """Return those detections that have no type as objects (k,) OVERLOOKED.

    Parameters
    ----------
    seen : (n,) `shapes.classes.DETECTED_OBJECT`
        The detections. Only detections with a class of `NAMELESS` are used.
    on_plate : (n,)
        Whether a detection is on the plate for every motor position, bool. Other detections are not
        used, because they may be the edge of a plate that is not at home.
    radius : (n,)
        Radii of the discs of the same area [m].
    smallest, largest : float
        Minimum and maximum radius of an object with the size of a part [m].
    """
    reason = np.full(len(seen), "misfit", OVERLOOKED["reason"])
    reason[radius > largest] = "too large"
    reason[seen["label"] == GROUP] = "group"
    reason[seen["blurred"]] = "blurred"
    reason[radius < smallest] = "too small"
    reason[~seen["whole"]] = "at the edge"
    rows = np.isin(seen["label"], NAMELESS) & on_plate
    things = np.zeros(np.count_nonzero(rows), OVERLOOKED)
    for name in ("x_px", "y_px", "radius_px", "x", "y"):
        things[name] = seen[name][rows]
    things["reason"] = reason[rows]
    return things


@dataclass(frozen=True)
class Expected:
    """Sizes of the parts in the rig file, for the remedies.

    Attributes
    ----------
    smallest, largest : float
        Radii of the discs of the same area as the smallest and the largest part [m].
    typed : bool
        Whether the parts have types.
    """

    smallest: float
    largest: float
    typed: bool = False

    @classmethod
    def of(cls, rig: Rig) -> Expected:
        """Return the sizes of a rig's parts."""
        if not rig.types:
            return cls(rig.parts.radius_m, rig.parts.radius_m)
        radii = [math.sqrt(part.area_m2 / math.pi) for part in rig.types.values()]
        return cls(min(radii), max(radii), typed=True)

    @property
    def size(self) -> str:
        """The sizes of the parts as text, with the key that contains the sizes in the rig file."""
        low, high = (f"{1e3 * radius:.3g}" for radius in (self.smallest, self.largest))
        span = low if low == high else f"{low} to {high}"
        return f"types have {span} mm" if self.typed else f"radius_m in section parts is {span} mm"


@dataclass
class OverlookedTally:
    """Counts of parts and overlooked objects over several images.

    Attributes
    ----------
    images, taken : int
        Number of images, and number of parts in them.
    things : list of (n,) OVERLOOKED
        Objects that are rejected as parts, image by image.
    radii : list of (n,)
        Radii of the objects [m], image by image.
    """

    images: int = 0
    taken: int = 0
    things: list[np.ndarray] = field(default_factory=list)
    radii: list[np.ndarray] = field(default_factory=list)

    def add(self, taken: int, things: np.ndarray, radius: np.ndarray) -> None:
        """Record an image. Input: its number of parts, and its objects (n,) OVERLOOKED with their
        radii (n,) [m]."""
        self.images += 1
        self.taken += taken
        self.things.append(things)
        self.radii.append(radius)

    def joined(self, other: OverlookedTally) -> OverlookedTally:
        """Return the combined counts of both tallies."""
        return OverlookedTally(
            self.images + other.images,
            self.taken + other.taken,
            self.things + other.things,
            self.radii + other.radii,
        )

    def finding(self, expected: Expected) -> Finding | None:
        """Return a finding about the objects that are rejected as parts, with reasons and remedies.
        Return None if there are no such objects.

        All numbers are averages over the images. The level is WARN if there are many such objects
        or if no part is detected. Otherwise, it is OK.
        """
        if not self.images:
            return None
        reason = np.concatenate([found["reason"] for found in self.things])
        radius = np.concatenate(self.radii)
        named = []
        for name in REASONS:
            rows = reason == name
            if count := round(np.count_nonzero(rows) / self.images):
                mm = 1e3 * float(np.median(radius[rows]))
                named.append((count, f"{count} {name} ({remedy(name, mm, expected)})"))
        total, taken = sum(count for count, _ in named), round(self.taken / self.images)
        if not total:
            return None
        why = ", ".join(text for _, text in named)
        at_edge = np.isin(reason, EDGE_REASONS)
        limit = np.where(at_edge, EDGE_COVER_RADII, COVER_RADII)
        largest = int(np.argmax(radius / limit))
        if radius[largest] > limit[largest] * expected.largest:
            thing = np.concatenate(self.things)[largest]
            return Finding(
                Level.WARN,
                f"a region of the plate around ({thing['x']:.3f}, {thing['y']:.3f}) m, as large as "
                f"a disc of {1e3 * radius[largest]:.0f} mm radius, differs from the bare plate, "
                "and parts in it may not be detected; remove what covers it, or check light, "
                "camera cable and corners_px",
            )
        if not self.taken:
            things = "1 other object" if total == 1 else f"{total} other objects"
            return Finding(Level.WARN, f"no part is detected, but {things}: {why}")
        of = f"{total} of {total + taken} objects on the plate"
        verb = "is not recognised as a part" if total == 1 else "are not recognised as parts"
        counts = (radius >= SPECK_RADIUS * expected.smallest) & ~at_edge
        large = np.count_nonzero(counts)
        many = large > WARN_FRACTION * (large + self.taken) and large >= WARN_COUNT * self.images
        return Finding(Level.WARN if many else Level.OK, f"{of} {verb}: {why}")

    def values(self) -> dict[str, str]:
        """Return the mean number of objects per image, in total and by reason."""
        reason = np.concatenate(
            [NONE_OVERLOOKED["reason"], *(found["reason"] for found in self.things)]
        )
        images = max(self.images, 1)
        values = {"overlooked": f"{len(reason) / images:.3g}"}
        for name in REASONS:
            key = f"overlooked_{name.replace(' ', '_')}"
            values[key] = f"{np.count_nonzero(reason == name) / images:.3g}"
        return values


def remedy(reason: str, radius_mm: float, expected: Expected) -> str:
    """Return the remedy for objects with the given reason (one of `REASONS`) and the given median
    radius [mm]."""
    if reason in ("too small", "too large"):
        return f"radius is {radius_mm:.3g} mm, but {expected.size}"
    if reason == "misfit":
        teach = "teach its type" if expected.typed else "parts that are not round require types"
        return f"check focus, light, lens, and height_m in section parts; {teach}"
    return REMEDIES[reason]
