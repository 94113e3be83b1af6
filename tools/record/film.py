"""Decodes a recorded run: positions of the parts, motions of the plate, and camera images."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from graph.observer import Record
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image
from trajectory_msgs.msg import JointTrajectory

from plate_core import PlateCycle, PlateError, Rig
from plate_core.ros import image_to_array, msg_to_motors, msg_to_parts, nanoseconds
from plate_interfaces.msg import Parts

ROUNDING = 1e-3
"""Resolution of the times that the planner reports [s]."""


@dataclass(frozen=True)
class Film:
    """A decoded run. Times are measured from the start of the task [s].

    Attributes
    ----------
    ids : tuple of str
        Names of all parts. The array `position` has the same order.
    time : (n,)
        Times of the positions [s]: starts of cycles or, if there is no simulator, stamps of images.
    position : (n, M, 2)
        Positions of the parts in plate_home [m]. NaN after a part has left the
        plate, or while it is not detected.
    angle : (n, M)
        Angles of the parts [rad].
    end : float
        End of the task [s]. If the task did not end, the value is the last known time.
    table_time : (m,)
        Stamps of the motor tables [s]. A table has the stamp of the image from which it was
        computed.
    tables : tuple of PlateCycle
        Motion of the plate in each motor table.
    image_time : (k,)
        Stamps of the recorded images [s].
    images : tuple of (H, W) arrays
    simulated : bool
        Whether the parts' positions are from the simulator, and not from the detector.
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
    simulated: bool = True

    @property
    def _count(self) -> np.ndarray:
        """Number of parts on the plate or, if there is no simulator, of detected parts (n,)."""
        return np.sum(np.isfinite(self.position[:, :, 0]), axis=1)

    @property
    def parts(self) -> int:
        """Number of parts. If there is no simulator, the value is the maximum number of parts in
        an image, because the detector can give a part that was lost a new name."""
        return len(self.ids) if self.simulated else int(np.max(self._count, initial=0))

    @property
    def dropped(self) -> int:
        """Number of parts that have left the plate or, if there is no simulator, that are not
        detected at the end."""
        return int(self.parts - self._count[-1]) if len(self.time) else 0

    @property
    def starts(self) -> np.ndarray:
        """Starts of cycles (k,) [s]. If there is no simulator, the stamps of the motor tables are
        used, because a free-running camera takes several images in a cycle."""
        return self.time if self.simulated else self.table_time

    @property
    def cycles(self) -> int:
        """Number of cycles that began during the task."""
        return int(np.sum((self.starts > -ROUNDING) & (self.starts < self.end - ROUNDING)))

    def running(self, t: float) -> PlateCycle | None:
        """Return the plate's motion at a time. This motion is the last table whose stamp is before
        the start of the cycle at this time. Return None if there is no such table."""
        k = int(np.searchsorted(self.starts, t, side="right")) - 1
        if k < 1:
            return None
        m = int(np.searchsorted(self.table_time, self.starts[k], side="left")) - 1
        return self.tables[m] if m >= 0 else None


def decode_record(record: Record, rig: Rig) -> Film:
    """Decode a record.

    Raises
    ------
    PlateError
        If no task was started.
    """
    # Each report has the stamp of its image. After the end of the task, `time_s` in the reports is
    # constant.
    reports = [r for r in record.reports("planner") if float(r.values.get("time_s", "0")) > 0]
    if not reports or not record.truth:
        raise PlateError("the task never began: there is nothing to evaluate or draw")
    began = reports[0].stamp - round(1e9 * float(reports[0].values["time_s"]))
    truth = [deserialize_message(data, Parts) for data in record.truth]
    ids = tuple(dict.fromkeys(part.id for msg in truth for part in msg.parts))
    position = np.full((len(truth), len(ids), 2), np.nan)
    angle = np.zeros((len(truth), len(ids)))
    for row, turned, msg in zip(position, angle, truth, strict=True):
        parts = msg_to_parts(msg)
        rows = [ids.index(name) for name in parts.ids]
        row[rows], turned[rows] = parts.position, parts.angle
    tables, cycles = [], []
    for data in record.tables:
        msg = deserialize_message(data, JointTrajectory)
        with suppress(PlateError):  # omit an invalid table, because `check_limits` reports it
            cycles.append(msg_to_motors(rig, msg))
            tables.append(msg)
    images, pictures = [], []
    for data in record.images.items:
        image = deserialize_message(data, Image)
        # omit an invalid image, because the detector has also refused it
        with suppress(PlateError):
            pictures.append(image_to_array(image))
            images.append(image)

    def since(messages: list) -> np.ndarray:
        return np.array([1e-9 * (nanoseconds(msg.header.stamp) - began) for msg in messages])

    time = since(truth)
    return Film(
        ids=ids,
        time=time,
        position=position,
        angle=angle,
        end=float(reports[-1].values["time_s"]) if record.ended else max(0.0, float(time[-1])),
        table_time=since(tables),
        tables=tuple(cycles),
        image_time=since(images),
        images=tuple(pictures),
        simulated=record.simulated,
    )
