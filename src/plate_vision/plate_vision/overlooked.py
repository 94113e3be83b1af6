"""Overlooked objects: objects on the plate that the detector rejects as parts.

Each has one of `REASONS`. `OverlookedTally` averages them over images and gives a finding with the
remedies; `may_be_parts` selects those that the planner must treat as obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from plate_core import GROUP, NAMELESS, PLAUSIBLE_AREA
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
"""Why an object is not a part, in this order: smaller or larger than the rig's parts; contrast to
the plate too low; another shape; cut by the plate's edge; centre not on the plate; several parts
that could not be separated; image too blurred for its type; a part now, but not in earlier
images."""

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
"""One object that is rejected as a part: centre and radius [px] of the disc of the same area;
centre [m, plate_home]; one of `REASONS`."""

NONE_OVERLOOKED = np.empty(0, OVERLOOKED)
"""No overlooked objects, (0,) `OVERLOOKED`."""
NONE_OVERLOOKED.setflags(write=False)

APART = 0.9
"""An object nearer to a part than this fraction of the sum of their radii [-] belongs to that part,
as its shadow or its side face. Two parts that touch are at 1."""

WARN_FRACTION, WARN_COUNT = 0.1, 2
"""Minimum fraction of all objects [-], and minimum number, of overlooked objects that cause a
warning. A single object may be a tool or a marker that belongs there. If a task misses a part, the
planner reports it."""

SPECK_RADIUS = 0.3
"""Objects smaller than this, relative to the smallest part's radius [-], do not count for the
warning while parts are seen. An object of a tenth of a part's area is dust or a reflection."""

EDGE_REASONS = ("at the edge", "beyond the plate")
"""Objects with these reasons do not count either. A plate that is away from home shows its own
edge, for example in images of a free-running camera."""

COVER_RADII = 8.0
"""Minimum radius of an object that covers the plate, relative to the largest part's radius [-], for
example a hand, a cable, a lamp's reflection. The strip beside a plate 10 mm away from home is
smaller."""

REMEDIES = {
    "too faint": "use more light, or parts with more contrast to the plate",
    "at the edge": "move them inwards; or the plate is not at home and this is its edge",
    "beyond the plate": "check camera: corners_px, or clear the surroundings",
    "group": "move them apart",
    "blurred": "types cannot be distinguished: focus the camera, or reduce the exposure time",
    "unsettled": "light or shadow has changed: wait for a few images",
}
"""Remedy for each reason whose remedy is the same for all rigs."""


def may_be_parts(
    things: np.ndarray,
    radius: np.ndarray,
    part_radius: float,
    inner: np.ndarray,
    centre: np.ndarray,
) -> np.ndarray:
    """Return which objects (n,) OVERLOOKED may be parts: those that have a part's size, are on the
    plate and are apart from all parts.

    Parameters
    ----------
    things : (n,) OVERLOOKED
    radius : (n,)
        Radii of the objects [m].
    part_radius : float
        Radius of a part [m].
    inner : (2,)
        Half sides of the plate's area in which objects count [m].
    centre : (M, 2)
        Centres of the parts in this image [m, plate_home].
    """
    place = np.column_stack([things["x"], things["y"]])
    area = (radius / part_radius) ** 2
    size = (PLAUSIBLE_AREA[0] <= area) & (area <= PLAUSIBLE_AREA[1])
    on_plate = np.all(np.abs(place) <= inner, axis=1)
    return np.asarray(size & on_plate & beside_parts(things, radius, part_radius, centre))


def beside_parts(
    things: np.ndarray, radius: np.ndarray, part_radius: float, centre: np.ndarray
) -> np.ndarray:
    """Return which objects (n,) OVERLOOKED are apart from all parts. The parameters are those of
    `may_be_parts`."""
    place = np.column_stack([things["x"], things["y"]])
    away = np.hypot(*(place[:, None] - centre).transpose(2, 0, 1))
    return np.asarray(np.all(away >= APART * (radius + part_radius)[:, None], axis=1))


def unnamed_things(
    seen: np.ndarray, on_plate: np.ndarray, radius: np.ndarray, smallest: float, largest: float
) -> np.ndarray:
    """Return the objects (k,) OVERLOOKED among sightings without a type.

    Parameters
    ----------
    seen : (n,) `shapes.classes.SIGHTING`
        Only sightings with a class of `NAMELESS` count.
    on_plate : (n,)
        Whether a sighting is on the plate at every motor position, bool. Other sightings do not
        count, because they may be the edge of a plate that is not at home.
    radius : (n,)
        Radii of the discs of the same area [m].
    smallest, largest : float
        Radii between which an object has the size of a part [m].
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

    @property
    def size(self) -> str:
        """The sizes as text, with their key in the rig file."""
        low, high = (f"{1e3 * radius:.3g}" for radius in (self.smallest, self.largest))
        span = low if low == high else f"{low} to {high}"
        return f"types have {span} mm" if self.typed else f"parts: radius_m is {span} mm"


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
        """Record an image: its number of parts, and objects (n,) OVERLOOKED of radii (n,) [m]."""
        self.images += 1
        self.taken += taken
        self.things.append(things)
        self.radii.append(radius)

    def joined(self, other: OverlookedTally) -> OverlookedTally:
        """Return the tally of both sets of images."""
        return OverlookedTally(
            self.images + other.images,
            self.taken + other.taken,
            self.things + other.things,
            self.radii + other.radii,
        )

    def finding(self, expected: Expected) -> Finding | None:
        """Describe the objects that are rejected as parts, with reasons and remedies; None without
        such objects.

        All numbers are averages over the images. The level is WARN if the objects are many or if no
        part is detected, else OK.
        """
        if not self.images:
            return None
        reason = np.concatenate([one["reason"] for one in self.things])
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
        if not self.taken:
            things = "1 other object" if total == 1 else f"{total} other objects"
            return Finding(Level.WARN, f"no part is detected, but {things}: {why}")
        of = f"{total} of {total + taken} objects on the plate"
        verb = "is not recognised as a part" if total == 1 else "are not recognised as parts"
        counts = (radius >= SPECK_RADIUS * expected.smallest) & ~np.isin(reason, EDGE_REASONS)
        large = np.count_nonzero(counts)
        cover = float(np.max(radius, initial=0))
        if cover > COVER_RADII * expected.largest:
            mm = round(1e3 * cover)
            return Finding(
                Level.WARN,
                f"an object as large as a disc of {mm} mm radius covers the plate and hides parts: "
                f"remove it, or check corners_px and light; {of} {verb}: {why}",
            )
        many = large > WARN_FRACTION * (large + self.taken) and large >= WARN_COUNT * self.images
        return Finding(Level.WARN if many else Level.OK, f"{of} {verb}: {why}")

    def values(self) -> dict[str, str]:
        """Return the mean number of objects per image, in total and by reason."""
        reason = np.concatenate(
            [NONE_OVERLOOKED["reason"], *(one["reason"] for one in self.things)]
        )
        images = max(self.images, 1)
        values = {"overlooked": f"{len(reason) / images:.3g}"}
        for name in REASONS:
            key = f"overlooked_{name.replace(' ', '_')}"
            values[key] = f"{np.count_nonzero(reason == name) / images:.3g}"
        return values


def remedy(reason: str, radius_mm: float, expected: Expected) -> str:
    """Return the remedy for objects of one of `REASONS`, with this median radius [mm]."""
    if reason in ("too small", "too large"):
        return f"radius {radius_mm:.3g} mm, {expected.size}"
    if reason == "misfit":
        teach = "teach its type" if expected.typed else "parts that are not round require types"
        return f"check focus, light, lens and parts: height_m; {teach}"
    return REMEDIES[reason]
