"""A recorded run, decoded: where the parts went, how the plate moved, what the camera saw."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image, MultiDOFJointState
from trajectory_msgs.msg import JointTrajectory

from plate_core import PlateCycle, PlateError, Rig
from plate_core.motion import corner_accel, motor_state
from plate_core.rig import homography
from plate_core.ros import image_to_array, msg_to_motors, msg_to_parts, nanoseconds

from .record import Record

SAMPLES = 1000
"""Instants of every motor table at which the limits are checked."""

ROUNDING = 1e-6
"""Share of a limit that rounding may add."""

SAME = 12
"""Pixels that differ no more from the picture without parts show the plate [grey values]."""

BRIGHT = 85
"""Percentile of a pixel's values that shows the plate: parts are darker, and may lie there long."""


@dataclass(frozen=True)
class Film:
    """A run. Times are in seconds since the task began.

    Attributes
    ----------
    ids : tuple of str
        All parts, in the order of `position`.
    time : (n,)
        Starts of cycles [s].
    position : (n, M, 2)
        Parts in plate_home [m] at these times; NaN once off the plate.
    angle : (n, M)
        Their angles [rad].
    end : float
        When the task was over [s].
    table_time : (m,)
        Stamps of motor tables: of the images that they answer [s].
    tables : tuple of PlateCycle
        The plate's motion that the motors were told to make.
    image_time : (k,)
        Stamps of the images that were kept [s].
    images : tuple of (H, W) arrays
    """

    ids: tuple[str, ...]
    time: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    end: float
    table_time: np.ndarray
    tables: tuple[PlateCycle, ...]
    image_time: np.ndarray
    images: tuple[np.ndarray, ...]

    @property
    def dropped(self) -> int:
        """Number of parts that have left the plate."""
        return int(np.sum(np.isnan(self.position[-1, :, 0]))) if len(self.position) else 0

    @property
    def cycles(self) -> int:
        """Number of cycles that the task took."""
        return int(np.sum((self.time >= 0) & (self.time < self.end)))

    def running(self, t: float) -> PlateCycle | None:
        """Return the plate's motion at a time: the answer to the image before the newest."""
        k = int(np.searchsorted(self.time, t, side="right")) - 1
        if k < 1:
            return None
        m = int(np.searchsorted(self.table_time, self.time[k], side="left")) - 1
        return self.tables[m] if m >= 0 else None


@dataclass(frozen=True)
class LimitCheck:
    """All motor tables against the rig's limits.

    Attributes
    ----------
    tables : int
        How many there were.
    faults : tuple of str
        What was wrong; empty: all was well.
    stroke, speed, accel : float
        Greatest shares of the limits [-].
    """

    tables: int
    faults: tuple[str, ...]
    stroke: float
    speed: float
    accel: float


def check_limits(record: Record, rig: Rig) -> LimitCheck:
    """Evaluate every motor table at `SAMPLES` instants, independently of who made it."""
    faults: list[str] = []
    most = np.zeros(3)
    for number, data in enumerate(record.tables):
        try:
            cycle = msg_to_motors(rig, deserialize_message(data, JointTrajectory))
        except PlateError as error:
            faults.append(f"motor table {number}: {error}")
            continue
        share = limit_shares(rig, cycle)
        most = np.maximum(most, share)
        if np.any(share > 1 + ROUNDING):
            faults.append(
                f"motor table {number}: stroke {share[0]:.4f}, speed {share[1]:.4f}, "
                f"acceleration {share[2]:.4f} of the limit"
            )
        if not cycle.starts_at_rest:
            faults.append(f"motor table {number}: does not begin at rest at home")
    return LimitCheck(len(record.tables), tuple(faults), *(float(share) for share in most))


def limit_shares(rig: Rig, cycle: PlateCycle) -> np.ndarray:
    """Return the greatest shares (3,) of stroke, speed and acceleration in one cycle."""
    t = np.linspace(0, cycle.period, SAMPLES)
    state = cycle.pose(t), cycle.twist(t), cycle.accel(t)
    q, qd, _ = motor_state(rig, *state)
    return np.array(
        [
            np.max(np.abs(q)) / rig.limits.stroke_m,
            np.max(np.abs(qd)) / rig.limits.speed,
            np.max(corner_accel(rig, *state)) / rig.limits.accel,
        ]
    )


def develop(record: Record, rig: Rig) -> Film:
    """Decode a record.

    Raises
    ------
    PlateError
        If the task never began.
    """
    # Stamped by the image they tell of; once the task is over its time stands still.
    reports = [(ns, v) for ns, v in record.reports["planner"] if float(v.get("time_s", "0")) > 0]
    if not reports or not record.truth:
        raise PlateError("the task never began: there is nothing to judge or draw")
    began = reports[0][0] - round(1e9 * float(reports[0][1]["time_s"]))
    truth = [deserialize_message(data, MultiDOFJointState) for data in record.truth]
    ids = tuple(truth[0].joint_names)
    position = np.full((len(truth), len(ids), 2), np.nan)
    angle = np.zeros((len(truth), len(ids)))
    for row, turned, msg in zip(position, angle, truth, strict=True):
        parts = msg_to_parts(msg)
        rows = [ids.index(name) for name in parts.ids]
        row[rows], turned[rows] = parts.position, parts.angle
    tables, cycles = [], []
    for data in record.tables:
        msg = deserialize_message(data, JointTrajectory)
        with suppress(PlateError):  # check_limits tells what is wrong with it
            cycles.append(msg_to_motors(rig, msg))
            tables.append(msg)
    images = [deserialize_message(data, Image) for data in record.images.items]

    def since(messages: list) -> np.ndarray:
        return np.array([1e-9 * (nanoseconds(msg.header.stamp) - began) for msg in messages])

    return Film(
        ids=ids,
        time=since(truth),
        position=position,
        angle=angle,
        end=float(reports[-1][1]["time_s"]),
        table_time=since(tables),
        tables=tuple(cycles),
        image_time=since(images),
        images=tuple(image_to_array(msg) for msg in images),
    )


def from_above(
    film: Film, rig: Rig, px_per_m: float
) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Return the images as seen straight from above, plate_home, cut at the plate's edge.

    Returns
    -------
    bare : (H, W)
        The plate without parts: the bright end of what each pixel shows in the course of time.
    views : list of (H, W)
        The images.
    parts : list of (H, W)
        True where an image shows a part: where it differs from `bare` by more than the noise.
    """
    width, height = rig.plate.length_m * px_per_m, rig.plate.width_m * px_per_m
    to_picture = np.array([[px_per_m, 0, width / 2], [0, -px_per_m, height / 2], [0, 0, 1.0]])
    matrix = to_picture @ np.linalg.inv(homography(rig))
    size = round(width), round(height)
    views = [cv2.warpPerspective(i, matrix, size, flags=cv2.INTER_LINEAR) for i in film.images]
    step = max(1, len(views) // 31)
    bare = np.percentile(views[::step], BRIGHT, axis=0).astype(np.uint8)
    return bare, views, [cv2.absdiff(view, bare) > SAME for view in views]
