"""The messages to the page, as mappings for JSON. The units are metres, radians and seconds. The
frame is plate_home."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np

from plate_core import CycleRequest, Parts, PlateCycle, Rig, part_class
from plate_core.colours import class_colour, lab_to_srgb
from plate_core.motion import motor_state, usage
from plate_core.rig import PartType
from plate_core.tasks import (
    AssembleTask,
    FeedTask,
    FollowTask,
    PoseTask,
    SortTask,
    Task,
    pick_window,
    region_outline,
)

from .field import drift, grid, mean_force

SAMPLES = 65
"""Number of samples of a cycle's motion."""

MAX_HALVES = 3.0
"""Maximum distance between the plate's centre and a displayed centre of rotation, in half lengths
of the plate."""

CAMERA_PX = 960
"""Maximum width of the camera's picture in browsers [px]."""

CAMERA_QUALITY = 80
"""Quality of the camera's JPEG [%]."""

Scene = dict[str, Any]


def camera_scene(stamp: float, image: np.ndarray) -> Scene:
    """Return a picture of the camera, scaled and compressed. The input is (H, W) or (H, W, 3), in
    the order blue, green, red."""
    height, width = image.shape[:2]
    scale = min(1.0, CAMERA_PX / width)
    if scale < 1:
        size = (CAMERA_PX, max(1, round(scale * height)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, CAMERA_QUALITY])
    jpeg = base64.b64encode(data.tobytes()).decode("ascii")
    return {"kind": "camera", "stamp": stamp, "width": width, "height": height, "jpeg": jpeg}


def rig_scene(rig: Rig, name: str) -> Scene:
    """Return the properties of a rig that the page uses."""
    return {
        "name": name, "length": rig.plate.length_m, "width": rig.plate.width_m,
        "radius": rig.parts.radius_m, "gamma": rig.gamma, "stroke": rig.limits.stroke_m,
        "motors": [motor.name for motor in rig.motors],
    }  # fmt: skip


def type_scene(kind: PartType) -> Scene:
    """Return the appearance of a type of part."""
    colour = (
        class_colour(kind.name)
        if kind.colour_lab is None
        else tuple(lab_to_srgb(np.array(kind.colour_lab)).round().astype(int).tolist())
    )
    return {
        "colour": "#{:02x}{:02x}{:02x}".format(*colour),
        "outline": np.round(kind.polygon, 6).tolist(),
        "holes": [np.round(np.array(hole), 6).tolist() for hole in kind.holes],
        "symmetry": kind.symmetry,
        "reach": kind.reach_m,
    }


def parts_scene(
    rig: Rig, stamp: float, parts: Parts, deviation: np.ndarray, seen: Sequence[bool]
) -> Scene:
    """Return the parts of an image. `deviation` (M, 3) are standard deviations [m, m, rad]. A value
    is NaN if it is unknown."""
    return {
        "kind": "parts",
        "stamp": stamp,
        "parts": [
            {
                "id": name, "type": part_class(name), "x": x, "y": y, "angle": angle,
                "turns": rig.part_type(part_class(name)).symmetry > 0,
                "sd": spread if np.all(np.isfinite(spread)) else None, "seen": bool(is_seen),
            }
            for name, (x, y), angle, spread, is_seen in zip(
                parts.ids, _round_values(parts.position), _round_values(parts.angle),
                _round_values(deviation, 7), seen, strict=True,
            )
        ],
    }  # fmt: skip


def request_scene(rig: Rig, stamp: float, request: CycleRequest) -> Scene:
    """Return the planner's request for each part: the target and the mean force [mu m g]."""
    to, count = request.targets, len(request.parts)
    unasked: list[list[Any]] = [[None, None, None]] * count
    intervals = unasked
    if to is not None:
        low, high, weight = (_round_values(each) for each in (to.low, to.high, to.weight))
        angles = to.angles
        intervals = [
            [
                *([low[i][k], high[i][k]] if weight[i][k] > 0 else None for k in range(2)),
                [float(angles.low[i]), float(angles.high[i])]
                if angles is not None and angles.weight[i] > 0
                else None,
            ]
            for i in range(count)
        ]
    force = _round_values(np.clip(request.forces.force / rig.force_unit, -9, 9), 3)
    rows = zip(request.parts.ids, intervals, force, strict=True)
    return {
        "kind": "wanted",
        "stamp": stamp,
        "parts": [
            {"id": name, "x": x, "y": y, "angle": angle, "force": each}
            for name, (x, y, angle), each in rows
        ],
    }


def cycle_scene(rig: Rig, stamp: float, cycle: PlateCycle, field: bool) -> Scene:
    """Return the plate's motion in a cycle. If `field`, include the drift and the mean force of
    parts."""
    t = np.linspace(0, cycle.period, SAMPLES)
    pose, twist = cycle.pose(t), cycle.twist(t)
    with np.errstate(all="ignore"):
        centre = pose[:, :2] + np.stack([-twist[:, 1], twist[:, 0]], axis=1) / twist[:, 2:]
    near = np.max(np.abs(centre), axis=1) < MAX_HALVES * rig.plate.half.max()
    sense = np.sign(twist[near, 2:])
    return {
        "kind": "cycle",
        "stamp": stamp,
        "period": cycle.period,
        "pose": _round_values(pose, 6),
        "centres": _round_values(np.hstack([centre[near], sense])),
        "field": field_scene(rig, cycle) if field else None,
    }


def field_scene(rig: Rig, cycle: PlateCycle) -> Scene:
    """Return the drift [m/s] and the mean force [mu m g] over the plate, row by row."""
    x, y = grid(rig)
    point = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return {
        "x": _round_values(x), "y": _round_values(y),
        "drift": _round_values(drift(cycle, point, rig.friction.accel)),
        "force": _round_values(mean_force(cycle, point), 3),
    }  # fmt: skip


def motors_scene(rig: Rig, cycle: PlateCycle) -> Scene:
    """Return the motion of the motors in a cycle, and the fractions of their limits that it
    uses."""
    t = np.linspace(0, cycle.period, SAMPLES)
    position, _, _ = motor_state(rig, cycle.pose(t), cycle.twist(t), cycle.accel(t))
    used, limits = usage(rig, cycle), rig.limits
    return {
        "kind": "motors",
        "names": [motor.name for motor in rig.motors],
        "lo": _round_values(position.min(axis=0), 6), "hi": _round_values(position.max(axis=0), 6),
        "position": _round_values(position[0], 6),
        "used": {
            "stroke": round(used.stroke_m / limits.stroke_m, 4),
            "speed": round(used.speed / limits.speed, 4),
            "acceleration": round(used.accel / limits.accel, 4),
            "force": round(used.force / limits.force, 4),
        },
    }  # fmt: skip


def task_scene(rig: Rig, task: Task | None) -> Scene:
    """Return the targets of a task: paths, regions and places. The lists are empty if there is no
    task."""
    scene: Scene = {"kind": "paths", "paths": [], "regions": [], "places": []}
    match task:
        case FollowTask():
            scene["paths"] = [
                {"type": path.label, "points": _round_values(path.waypoint), "closed": path.closed}
                for path in task.paths
            ]
        case SortTask():
            scene["regions"] = [
                {
                    "type": label,
                    "polygon": _round_values(region_outline(task, label, rig.plate.half)),
                }
                for label in task.regions
            ]
        case FeedTask():
            windows = [(pick.label, *pick_window(pick, rig)) for pick in task.picks]
            scene["regions"] = [
                {"type": label, "polygon": _round_values([a, (b[0], a[1]), b, (a[0], b[1])])}
                for label, a, b in windows
            ]
        case AssembleTask():
            scene["places"] = [
                {"type": label, "x": x, "y": y, "angle": None}
                for label, (x, y) in zip(task.labels, task.place, strict=True)
            ]
        case PoseTask():
            scene["places"] = [
                {"type": pose.label, "x": pose.place[0], "y": pose.place[1], "angle": pose.angle}
                for pose in task.poses
                if pose.place is not None
            ]
    return scene


def nodes_scene(reports: Mapping[str, tuple[float, str, str, Mapping[str, str]]]) -> Scene:
    """Return the diagnostics of all nodes by name: age [s], level, message and values."""
    return {
        "kind": "nodes",
        "nodes": [
            {"name": name, "age": round(age, 1), "level": level, "message": message,
             "values": dict(values)}
            for name, (age, level, message, values) in sorted(reports.items())
        ],
    }  # fmt: skip


def _round_values(values: Any, digits: int = 5) -> Any:
    return np.round(np.asarray(values, dtype=float), digits).tolist()
