"""Markers for RViz and Foxglove, in metres in plate_home. The markers are only for display."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ..colours import FORCE, PLATE, TURNING, VELOCITY, Colour, class_colour, part_colour
from ..cycle_request import CycleRequest
from ..motion import PlateCycle
from ..parts import Parts, part_class
from ..rig import Rig
from .convert import pose_to_msg
from .frames import FRAME

LIFETIME_S = 1.0
"""Lifetime of a marker that is not published again [s]."""

THICK_M = 0.004
"""Thickness of the plate and the parts [m]."""

LINE_M = 0.002
"""Width of lines and arrows [m]."""

AHEAD_S = 1.0
"""Prediction time of velocity arrows [s]. An arrow ends at the predicted position of the part after
this time."""

FORCE_M = 0.1
"""Length of the arrow for a force that is equal to the sliding friction of a part [m]."""

CENTRES = 200
"""Number of centres of rotation that are drawn per cycle, at equally spaced times."""

MAX_HALVES = 4.0
"""Maximum coordinate of a centre of rotation that is drawn, in half lengths of the plate."""


def scene_to_msg(
    rig: Rig,
    parts: Parts,
    trails: Mapping[str, Sequence[tuple[float, float]]],
    pose: np.ndarray,
    stamp: Time,
) -> MarkerArray:
    """Return markers of the plate and of the parts with names, velocities and trails.

    Parameters
    ----------
    rig : Rig
    parts : Parts
    trails : mapping of str to sequence of (x, y)
        Past positions of each part [m, plate_home], oldest first.
    pose : (3,)
        Pose of the plate [m, m, rad].
    stamp : Time
    """
    plate = _make_marker("plate", 0, Marker.CUBE, PLATE, stamp)
    plate.pose = pose_to_msg(pose, stamp).pose
    plate.pose.position.z = -1.5 * THICK_M
    plate.scale.x, plate.scale.y, plate.scale.z = rig.plate.length_m, rig.plate.width_m, THICK_M
    markers = [plate]
    for i, name in enumerate(parts.ids):
        place, colour = parts.position[i], class_colour(part_class(name))
        disc = _make_marker("parts", i, Marker.CYLINDER, part_colour(part_class(name)), stamp)
        disc.scale.x = disc.scale.y = 2 * rig.parts.radius_m
        disc.scale.z = THICK_M
        text = _make_marker("names", i, Marker.TEXT_VIEW_FACING, colour, stamp)
        text.text = name
        text.scale.z = 1.5 * rig.parts.radius_m
        text.pose.position.z = 2 * THICK_M
        for marker in (disc, text):
            marker.pose.position.x, marker.pose.position.y = float(place[0]), float(place[1])
        trail = _make_marker("trails", i, Marker.LINE_STRIP, colour, stamp)
        trail.scale.x = LINE_M / 2
        trail.points = [_to_point(position) for position in trails.get(name, ())]
        ahead = place + AHEAD_S * parts.velocity[i]
        markers += [disc, text, _make_arrow("velocities", i, place, ahead, VELOCITY, stamp)]
        markers += [trail] if len(trail.points) > 1 else []
    return MarkerArray(markers=markers)


def forces_to_msg(rig: Rig, request: CycleRequest, stamp: Time) -> MarkerArray:
    """Return the forces of a request as arrows. If the request has targets, the arrows show the
    forces that would move the parts to their targets."""
    starts = request.parts.position
    ends = starts + FORCE_M / rig.force_unit * request.forces.force
    pairs = enumerate(zip(starts, ends, strict=True))
    return MarkerArray(
        markers=[
            _make_arrow("forces", i, position, end, FORCE, stamp) for i, (position, end) in pairs
        ]
    )


def centres_to_msg(rig: Rig, cycle: PlateCycle, stamp: Time) -> MarkerArray:
    """Return the plate's instantaneous centres of rotation during a cycle, as points.

    The points belong to equally spaced times. Many points in a small region show that the plate
    rotates about this region for a long time. The colour shows the direction of rotation. When the
    plate hardly rotates, the centre is far away and is not drawn.
    """
    time = np.linspace(0, cycle.period, CENTRES, endpoint=False)
    pose, twist = cycle.pose(time), cycle.twist(time)
    with np.errstate(all="ignore"):
        centre = pose[:, :2] + np.stack([-twist[:, 1], twist[:, 0]], axis=1) / twist[:, 2:]
    reach = np.max(np.abs(centre), axis=1) < MAX_HALVES * rig.plate.half.max()
    points = _make_marker("centres", 0, Marker.POINTS, FORCE, stamp)
    points.scale.x = points.scale.y = LINE_M
    for position, spin in zip(centre[reach], twist[reach, 2], strict=True):
        points.points.append(_to_point(position))
        points.colors.append(_to_rgba(TURNING[0 if spin > 0 else 1]))
    return MarkerArray(markers=[points])


def _make_marker(kind: str, number: int, shape: int, colour: Colour, stamp: Time) -> Marker:
    marker = Marker(header=Header(stamp=stamp, frame_id=FRAME), ns=kind, id=number, type=shape)
    marker.action = Marker.ADD
    marker.color = _to_rgba(colour)
    marker.lifetime = Duration(sec=int(LIFETIME_S))
    marker.pose.orientation.w = 1.0
    return marker


def _to_rgba(colour: Colour) -> ColorRGBA:
    red, green, blue = (level / 255 for level in colour)
    return ColorRGBA(r=red, g=green, b=blue, a=1.0)


def _make_arrow(
    kind: str,
    number: int,
    start: np.ndarray,
    end: np.ndarray,
    colour: Colour,
    stamp: Time,
) -> Marker:
    arrow = _make_marker(kind, number, Marker.ARROW, colour, stamp)
    arrow.scale.x, arrow.scale.y = LINE_M, 2 * LINE_M  # diameters of the arrow's shaft and head
    arrow.points = [_to_point(start), _to_point(end)]
    return arrow


def _to_point(position: Sequence[float] | np.ndarray) -> Point:
    return Point(x=float(position[0]), y=float(position[1]), z=THICK_M)
