"""The feed task: reading and checks of its keys, and the rule that decides which parts a robot is
allowed to grip.

A part is ready if it is of the right class, in the pick window, at the requested angle, and far
enough from all other parts (`ready_parts`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..errors import ScenarioError, did_you_mean
from ..parts import MAX_PARTS, Parts, part_class
from ..rig import PartType, Rig
from ..yaml_fields import Fields
from . import keys
from .edges import no_place_text
from .tasks import FeedTask, Hopper, PartGroup, Pick

ROUNDING_RAD = 1e-6
"""Tolerance for the rounding of angles converted from degrees [rad]."""

MAX_OPEN_S = 60.0
"""Maximum duration of one opening of a hopper [s]. The feeder never requests a longer opening, and
the simulated hopper refuses such a request."""

WHOLE = 1e-6
"""Tolerance of the sum of fractions, which must be 1."""

FULL = ((-math.inf, -math.inf), (math.inf, math.inf))
"""Default pick window. This window is infinite, and `pick_window` limits it to the plate."""


def read_feed(fields: Fields, parts: Sequence[PartGroup]) -> FeedTask:
    """Read the keys of a feed task. The function raises the same errors as `load_scenario`."""
    labels = tuple(group.label for group in parts)
    picks = tuple(_read_pick(child, labels) for child in fields.children("picks"))
    if not picks or len({pick.label for pick in picks}) < len(picks):
        raise fields.fail("picks", "at least one pick, each class at most once")
    hopper = None
    if fields.has("hopper"):
        hopper = _read_hopper(fields.child("hopper"), labels, picks)
    ready = sum(pick.ready for pick in picks)
    if hopper is not None and ready > hopper.fill:
        raise fields.fail(
            "picks",
            f"picks whose ready add up to at most {hopper.fill}, the hopper's fill (now {ready})",
        )
    chute = fields.value(keys.FEED["chute"])
    return FeedTask(
        picks=picks,
        clearance_m=fields.value(keys.FEED["clearance_m"]),
        chute=None if chute is None else keys.SIDES[chute],
        hopper=hopper,
        timeout_s=fields.value(keys.FEED["timeout_s"]),
        valid_s=fields.value(keys.FEED["valid_s"]),
    )


def _read_pick(fields: Fields, labels: tuple[str, ...]) -> Pick:
    window = fields.value(keys.PICK["window_m"])
    low, high = FULL
    if window is not None:
        if not np.all(window[0] < window[1]):
            raise fields.fail(
                "window_m", "[x, y] of the lower left corner, then of the upper right corner"
            )
        (x0, y0), (x1, y1) = window.tolist()
        low, high = (x0, y0), (x1, y1)
    angle = fields.value(keys.PICK["angle_deg"])
    pick = Pick(
        label=fields.value(keys.class_key(*labels)),
        ready=fields.value(keys.PICK["ready"]),
        low=low,
        high=high,
        angle=None if angle is None else math.radians(angle),
        tolerance_rad=math.radians(fields.value(keys.PICK["tolerance_deg"])),
    )
    fields.finish()
    return pick


def _read_hopper(fields: Fields, labels: tuple[str, ...], picks: tuple[Pick, ...]) -> Hopper:
    mix = {pick.label: 1 / len(picks) for pick in picks}
    if fields.has("mix"):
        child = fields.child("mix")
        mix = {label: child.number(label, 0, 1) for label in child.keys()}  # noqa: SIM118 - no mapping
        known = ", ".join(labels)
        if unknown := [label for label in mix if label not in labels]:
            hint = did_you_mean(unknown[0], labels)
            raise fields.fail(
                "mix", f"only the classes of parts ({known}); {unknown[0]!r} is unknown{hint}"
            )
        total = sum(mix.values())
        if abs(total - 1) > WHOLE:
            raise fields.fail("mix", f"fractions of {known} whose sum is 1")
        mix = {label: part / total for label, part in mix.items()}
        if missing := [pick.label for pick in picks if not mix.get(pick.label)]:
            raise fields.fail(
                "mix", f"more than 0 for each class of picks; missing: {', '.join(missing)}"
            )
    fill = fields.value(keys.HOPPER["fill"])
    least = fields.value(keys.HOPPER["least"])
    if least is not None and least > fill:
        raise fields.fail("least", f"at most fill, which is {fill}")
    place = fields.value(keys.HOPPER["place_m"])
    hopper = Hopper(
        fill=fill,
        least=fill if least is None else least,
        rate=fields.value(keys.HOPPER["rate_ps"]),
        place=(float(place[0]), float(place[1])),
        spread_m=fields.value(keys.HOPPER["spread_m"]),
        mix=mix,
    )
    fields.finish()
    return hopper


def check_feed(task: FeedTask, where: str, rig: Rig) -> None:
    """Check a feed task against a rig.

    Raises
    ------
    ScenarioError
        If the task is impossible. The message states the file, the key, its value and the allowed
        values.
    """
    for pick in task.picks:
        if problem := pick_problem(pick, rig) or _space_problem(pick, task.clearance_m, rig):
            raise ScenarioError(f"{where}: task: picks: {problem}")
    if task.hopper is not None:
        reach = max(rig.part_type(label).reach_m for label in task.hopper.mix)
        limit = rig.plate.half - reach
        if np.any(np.abs(task.hopper.place) > limit):
            x, y = task.hopper.place
            raise ScenarioError(
                f"{where}: task: hopper: place_m is ({x:g}, {y:g}) m, allowed: |x| up to "
                f"{limit[0]:g}, |y| up to {limit[1]:g} m on this plate"
            )


def _space_problem(pick: Pick, clearance_m: float, rig: Rig) -> str:
    """Return the reason why the window is too small for `pick.ready` parts. Return "" if it may be
    large enough.

    The estimate replaces each part by a disc. The disc is the largest disc about the part's centre
    inside the part's outline, enlarged by half the clearance. These discs must not overlap, and
    their centres must be inside the window.
    """
    from shapely import Point, Polygon

    (low, high), centre = pick_window(pick, rig), Point(0, 0)
    outline = Polygon(rig.part_type(pick.label).polygon)
    # The centre of a part may be outside its outline, for example if the part is L-shaped.
    if not outline.contains(centre):
        return ""
    free = clearance_m / 2 + outline.exterior.distance(centre)
    fitting = int(np.prod(high - low + 2 * free) / (np.pi * free**2))
    # If two parts do not fit on the diagonal of the pick window, only one part fits into the
    # window.
    if np.hypot(*(high - low)) < 2 * free:
        fitting = 1
    if pick.ready <= max(fitting, 1):
        return ""
    return (
        f"ready of {pick.label} is {pick.ready}, allowed: at most {max(fitting, 1)}, because more "
        f"parts do not fit into the window of {1e3 * (high[0] - low[0]):g} by "
        f"{1e3 * (high[1] - low[1]):g} mm with a clearance of {1e3 * clearance_m:g} mm"
    )


def pick_problem(pick: Pick, rig: Rig) -> str:
    """Return the reason why a pick is impossible on this rig. Return "" if it is possible."""
    low, high = pick_window(pick, rig)
    limit = rig.plate.half - rig.part_type(pick.label).reach_m
    if not (np.all(low <= high) and np.all(low >= -limit - 1e-9) and np.all(high <= limit + 1e-9)):
        return (
            f"window of {pick.label} is ({low[0]:g}, {low[1]:g}) to ({high[0]:g}, {high[1]:g}) m, "
            f"allowed: |x| up to {limit[0]:g}, |y| up to {limit[1]:g} m, the lower corner first"
        )
    inner = rig.plate.half - rig.edge_margin(pick.label).min_m
    if np.any(low > inner) or np.any(high < -inner):
        return f"window of {pick.label} has {no_place_text(pick.label, rig)}"
    if not 1 <= pick.ready <= MAX_PARTS:
        return f"ready of {pick.label} is {pick.ready}, allowed: 1 to {MAX_PARTS}"
    if pick.angle is None:
        return ""
    if not (math.isfinite(pick.angle) and 0 < pick.tolerance_rad <= math.pi):
        return (
            f"angle of {pick.label} is {pick.angle:g}, its tolerance {pick.tolerance_rad:g} rad, "
            "allowed: a finite angle, and a tolerance above 0, up to 3.14 rad"
        )
    if rig.part_type(pick.label).symmetry == 0:
        return f"angle of {pick.label} is given, allowed: none, because the part is round"
    return ""


def pick_window(pick: Pick, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and the upper corner (2,), (2,) [m, plate_home] of a pick window on this
    rig's plate. By default, this is the whole safe area, at least `wall_m` from the edges."""
    limit = rig.plate.half - rig.edge_margin(pick.label).wall_m
    low, high = np.array(pick.low, dtype=float), np.array(pick.high, dtype=float)
    return np.where(np.isinf(low), -limit, low), np.where(np.isinf(high), limit, high)


def remaining_rotation(parts: Parts, angle: float, symmetry: int) -> np.ndarray:
    """Return the smallest rotation (M,) [rad] that brings parts to an angle [rad]. `symmetry` is
    the order of the parts' rotational symmetry."""
    period = 2 * np.pi / max(symmetry, 1)
    return np.asarray((angle - parts.angle + period / 2) % period - period / 2)


def ready_parts(
    parts: Parts, pick: Pick, clearance_m: float, rig: Rig, gap: np.ndarray | None = None
) -> np.ndarray:
    """Whether a robot is allowed to grip each part (M,). The part must have the right class and
    angle, be inside the window, and be far enough from all other parts.

    Parameters
    ----------
    parts : Parts
        All parts on the plate.
    pick : Pick
    clearance_m : float
        Minimum distance between the edges of a part and of any other part [m].
    rig : Rig
    gap : (M,) or None
        Result of `free_gap` for these parts. If None, the function computes it.
    """
    gap = free_gap(parts, rig) if gap is None else gap
    return np.asarray(as_picked(parts, pick, rig) & (gap >= clearance_m))


def as_picked(parts: Parts, pick: Pick, rig: Rig) -> np.ndarray:
    """Whether each part (M,) has the class of the pick, is in its window, and has its angle."""
    ready = np.array([part_class(name) == pick.label for name in parts.ids], dtype=bool)
    low, high = pick_window(pick, rig)
    ready &= np.all((parts.position >= low) & (parts.position <= high), axis=1)
    if pick.angle is not None:
        rotation = remaining_rotation(parts, pick.angle, rig.part_type(pick.label).symmetry)
        ready &= np.abs(rotation) <= pick.tolerance_rad + ROUNDING_RAD
    return ready


def free_gap(parts: Parts, rig: Rig) -> np.ndarray:
    """Return the distance (M,) [m] between the edge of each part and the nearest edge of another
    part. The distance is at most 0 if parts overlap, and infinite if there is no other part."""
    types = [rig.part_type(part_class(name)) for name in parts.ids]
    count, reach = len(parts), np.array([kind.reach_m for kind in types])
    if count < 2:
        return np.full(count, np.inf)
    apart = np.hypot(*(parts.position[:, None] - parts.position[None]).transpose(2, 0, 1))
    # The gap between the circumscribed discs of two parts is a lower bound of the gap between the
    # parts.
    gap = apart - reach[:, None] - reach[None]
    np.fill_diagonal(gap, np.inf)
    if all(kind.radius_m for kind in types):
        return np.asarray(gap.min(axis=1))
    # Shapely is imported here, so that the stop command does not wait for this import.
    from shapely import distance

    shapes = map(PartType.placed, types, parts.position, parts.angle)
    shape, radius = np.array(list(shapes)), np.array([kind.radius_m for kind in types])
    # `upper` is an upper bound of the distance to the nearest part. Exact distances are computed
    # only for pairs below this bound.
    upper = np.min(apart + reach[:, None] + reach + np.diag(np.full(count, np.inf)), axis=1)
    i, j = np.nonzero(gap < upper[:, None])
    gap[i, j] = distance(shape[i], shape[j]) - radius[i] - radius[j]
    return np.asarray(gap.min(axis=1))
