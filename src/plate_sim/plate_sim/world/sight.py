"""Camera of the simulated world: times and content of images. The inputs are the state and history
of parts, plate and robot, and the disturbances. The outputs are images, or the exact places of the
parts that an image shows."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from plate_core import PlateError, Rig, part_class
from plate_core.rig import PartType, camera_place, row_delay

from ..camera import Camera, part_colours
from ..plate import PlateState
from .disturbances import Disturbances
from .history import History
from .robot import Robot
from .state import WorldState

EXPOSURES = 5
"""Minimum number of sample times of parts and plate during an image."""

MAX_STEP_S = 3e-3
"""Maximum time between two samples [s]. The period of the plate's motion is at least 20 ms."""

DRAWN = ("plate_grey", "room_grey", "defocus_px")
"""Disturbances that require a new `Camera`. The camera caches images that depend on them."""

FINEST_STAMP_S = 1e-4
"""Minimum difference between two stamps [s]."""

BANDS = 8
"""Number of bands of image rows. If the camera has a rolling shutter, the pose of the plate is
sampled once per band."""


@dataclass(frozen=True)
class Shot:
    """An image of a free-running camera: middle of its exposure, stamp, and delivery time [s]."""

    middle: float
    stamp: float
    delivered: float


@dataclass(frozen=True)
class Sight:
    """Exact content of an image.

    - positions (M, 2) [m, plate_home] and angles (M,) [rad] of the parts
    - `seen` (M,): whether the image shows each part
    - positions (F, 2) of false parts [m]
    """

    position: np.ndarray
    angle: np.ndarray
    seen: np.ndarray
    false: np.ndarray


class CameraView:
    """Camera of a simulation. The object also stores the appearance and the history of the parts.

    Parameters
    ----------
    rig : Rig
    seed : int
        Seed of the sizes of the parts.
    marked : bool
        Whether round parts show their angle.
    disturbances : Disturbances
    noise : float
        Standard deviation of the noise of a pixel [grey values].
    pixels, images, parts, stamps : Generator
        Random generators for pixel noise, for missed images, for missed and false parts, and for
        stamps.

    Attributes
    ----------
    history : History
        Past motion of parts and plate. The history covers the time that an image may show.
    """

    def __init__(
        self,
        rig: Rig,
        seed: int,
        marked: bool,
        disturbances: Disturbances,
        noise: float,
        *,
        pixels: np.random.Generator,
        images: np.random.Generator,
        parts: np.random.Generator,
        stamps: np.random.Generator,
    ) -> None:
        self._rig, self._seed, self._marked = rig, seed, marked
        self._disturbances, self._noise = disturbances, noise
        self._pixel_rng, self._image_rng = pixels, images
        self._part_rng, self._stamp_rng = parts, stamps
        self.history = History()

    def know(self, ids: tuple[str, ...], types: list[PartType]) -> None:
        """Set the appearance of the current parts."""
        world = self._disturbances
        self._types = types
        self._grey = part_colours(types, self._rig.camera.colour, world.greys)
        height = np.array([world.part_height_m or part.height_m for part in types])
        self._height = height if np.any(height) else None
        self._size = None
        if world.size_spread:
            units = [_own_number(self._seed, name) for name in ids]
            self._size = 1 + world.size_spread * np.array(units)
        self._typed = any(part_class(name) in self._rig.types for name in ids)

    def change(self, disturbances: Disturbances, noise: float) -> None:
        """Apply new disturbances. The caller must call `know` afterwards."""
        before, self._disturbances, self._noise = self._disturbances, disturbances, noise
        if any(getattr(before, name) != getattr(disturbances, name) for name in DRAWN):
            self.__dict__.pop("_camera", None)  # the images of the cached camera are outdated
        self._camera.noise = noise

    @cached_property
    def _camera(self) -> Camera:
        """Camera. The camera is created for the first image, because its creation takes as long as
        a hundred cycles."""
        world = self._disturbances
        return Camera(
            self._rig, self._noise, plate=world.plate_grey, room=world.room_grey,
            defocus_px=world.defocus_px,
        )  # fmt: skip

    @property
    def past(self) -> float:
        """Maximum age of the state that an image may show [s]."""
        camera = self._rig.camera
        shown = camera.exposure_s + camera.readout_s
        anytime = self._disturbances.image_rate > 0 or camera.trigger is not None
        needed = anytime or camera.readout_s > 0
        return self._disturbances.latency + (shown if needed else 0.0)

    def shots(self, begin: float) -> Iterator[Shot]:
        """Yield the images of a free-running camera from `begin` [s] on. The sequence has no
        end."""
        camera, world, rng = self._rig.camera, self._disturbances, self._stamp_rng
        interval, last = 1 / max(world.image_rate, 1e-9), -np.inf
        shown = camera.exposure_s + camera.readout_s
        middle = begin + interval * rng.random()
        while True:
            jitter = world.stamp_jitter * rng.standard_normal()
            # Stamps increase, as with a real camera driver.
            last = max(middle + world.latency + jitter, last + FINEST_STAMP_S)
            yield Shot(middle, last, middle + max(world.latency, shown / 2))
            middle += interval

    def capture(
        self, state: WorldState, plate: PlateState, robot: Robot, now: float, age: float | None
    ) -> np.ndarray | None:
        """Return the image (height, width), uint8, that is delivered at `now` [s]. Return None if
        it is missing. See `Simulation.capture`."""
        shown = self._chance()
        if shown is None:
            return None
        hidden, place, like = shown
        path, angle, seen, pose = self._view(state, plate, age)
        false = len(like)
        drawn = np.append(np.flatnonzero(seen & ~hidden), like)
        spots = np.broadcast_to(place, (len(path), false, 2))
        there = path[:, drawn[: len(drawn) - false]]
        turned = self._marked or self._typed
        old = self._disturbances.latency if age is None else age
        return self._camera.render(
            np.concatenate([there, spots], axis=1),
            self._grey[drawn],
            self._pixel_rng,
            pose=pose,
            angle=np.append(angle[drawn[: len(drawn) - false]], np.zeros(false))
            if turned
            else None,
            types=[self._types[i] for i in drawn] if self._typed else None,
            lighting=self._disturbances.lighting(now - old),
            gripper=robot.at(now - old),
            height=None if self._height is None else self._height[drawn],
            size=None if self._size is None else self._size[drawn],
        )

    def sight(self, state: WorldState, plate: PlateState, age: float | None) -> Sight | None:
        """Return the exact content of the image that `capture` would return. Return None if the
        image is missing."""
        shown = self._chance()
        if shown is None:
            return None
        hidden, place, _ = shown
        path, angle, seen, _ = self._view(state, plate, age)
        return Sight(path[len(path) // 2], angle, seen & ~hidden, place)

    def capture_bare(self, now: float) -> np.ndarray:
        """Return an image of the bare plate at home at `now` [s]."""
        return self._camera.render(
            np.zeros((0, 2)), self._grey[:0], self._pixel_rng,
            lighting=self._disturbances.lighting(now),
        )  # fmt: skip

    def _chance(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Draw random numbers for an image: whether each part is hidden (M,), the positions (F, 2)
        of false parts [m], and for each false part the index (F,) of the part with the same
        appearance. Return None if the image is missing."""
        count, world = len(self._types), self._disturbances
        if not (world.missed_images or world.missed_parts or world.false_parts):
            return np.zeros(count, bool), np.zeros((0, 2)), np.zeros(0, np.int64)
        missed = self._image_rng.random() < self._disturbances.missed_images
        hidden = self._part_rng.random(count) < self._disturbances.missed_parts
        false = self._part_rng.binomial(count, self._disturbances.false_parts)
        place = self._rig.plate.half * self._part_rng.uniform(-1, 1, (false, 2))
        like = self._part_rng.choice(count, false)
        return None if missed else (hidden, place, like)

    def _view(
        self, state: WorldState, plate: PlateState, age: float | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """Return the positions over the exposure (s, M, 2), the angles (M,), whether each part is
        on the plate, and the poses of the plate. The poses are (s, 3), or (b, s, 3) for bands of
        rows, or None if the plate is at home."""
        camera = self._rig.camera
        exposure = camera.exposure_s if self._disturbances.blur else 0.0
        if self.past and self.history.passages:
            shown = exposure + camera.readout_s
            first = self._disturbances.latency if age is None else age + shown / 2
            return self._past_view(state, first, exposure, shown)
        later = np.array([0.0, exposure])[:, None]
        path = state.position + later[:, None] * state.velocity
        if self._rig.suspension is None:
            return path, state.angle, state.on_plate, None
        pose = plate.pose + later * plate.twist
        return path, state.angle, state.on_plate, pose

    def _past_view(
        self, state: WorldState, first: float, exposure: float, shown: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the same as `_view` for an image that is exposed row by row. The exposure of the
        first row started `first` [s] ago.

        The exposure of the last row ends `shown` [s] after the exposure of the first row has
        started.
        """
        count = max(EXPOSURES, 1 + int(np.ceil(shown / MAX_STEP_S)))
        time = shown * np.linspace(0, 1, count)
        views = [self.history.ago(first - t) for t in time]
        path, pose = (np.stack([getattr(v, n) for v in views]) for n in ("position", "pose"))
        middle, readout = views[count // 2], self._rig.camera.readout_s
        # The history does not contain changes of parts since the last cycle.
        there = middle.on_plate if first >= time[count // 2] else state.on_plate
        if readout == 0:
            return path, middle.angle, there, pose
        row = np.clip(row_delay(self._rig, middle.position) / readout + 0.5, 0, 1)
        begin = readout * np.append(row, (np.arange(BANDS) + 0.5) / BANDS)
        at = begin[:, None] + exposure * np.linspace(0, 1, EXPOSURES)
        parts = len(row)
        seen = np.empty((EXPOSURES, parts, 2))
        for i in range(parts):
            for axis in range(2):
                seen[:, i, axis] = np.interp(at[i], time, path[:, i, axis])
        poses = np.empty((BANDS, EXPOSURES, 3))
        for band in range(BANDS):
            for axis in range(3):
                poses[band, :, axis] = np.interp(at[parts + band], time, pose[:, axis])
        return seen, middle.angle, there, poses


def check_height(rig: Rig, disturbances: Disturbances) -> None:
    """Raise an error if parts have a height and the position of the camera is unknown."""
    named = {f"types: {name}: height_m": part.height_m for name, part in rig.types.items()}
    heights = {
        "part_height_m": disturbances.part_height_m,
        "parts: height_m": rig.parts.height_m,
        **named,
    }
    high = [(name, value) for name, value in heights.items() if value > 0]
    if not high or (place := camera_place(rig)) is None:
        if high:
            raise PlateError(
                f"{high[0][0]} is {high[0][1]:g}, allowed: 0, because the rig file gives neither "
                "focal_px nor camera: height_m, so the camera's position is unknown"
            )
        return
    for name, value in high:
        if value >= place[2]:
            raise PlateError(f"{name} is {value:g}, allowed: below the camera, {place[2]:.3g} m")


def _own_number(seed: int, part_id: str) -> float:
    """Return a number for a part, uniform in -1 to 1. The number depends only on the seed and on
    the part's id."""
    rng = np.random.default_rng([seed, zlib.crc32(part_id.encode())])
    return float(rng.uniform(-1, 1))
