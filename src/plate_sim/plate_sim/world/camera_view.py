"""Camera of the simulated world. The inputs are the present and past states of parts, plate and
robot. From them, `CameraView` computes images, or the exact positions of the parts that an image
would show."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from plate_core import PlateError, Rig, part_class
from plate_core.rig import PartType, camera_position, row_delay

from ..camera import Camera, part_colours
from ..plate import PlateState
from .disturbances import Disturbances
from .history import History
from .robot import Robot
from .state import WorldState

EXPOSURES = 5
"""Minimum number of times at which parts and plate are sampled during the exposure of an image."""

MAX_STEP_S = 3e-3
"""Maximum time between two of these samples [s]. The value is short compared with the periods of
the plate's motion, which are at least 20 ms."""

NEEDS_NEW_CAMERA = ("plate_grey", "room_grey", "defocus_px")
"""Disturbances whose change requires a new object `Camera`, because a `Camera` caches drawings that
depend on them."""

FINEST_STAMP_S = 1e-4
"""Minimum difference between the stamps of two consecutive images [s]."""

BANDS = 8
"""Number of bands of image rows. If the camera has a rolling shutter, the poses of the plate are
computed separately for each band."""


@dataclass(frozen=True)
class Shot:
    """Times of one image of a free-running camera [s]. The times are the middle of the exposure,
    the stamp, and the delivery."""

    middle: float
    stamp: float
    delivered: float


class VisibleParts(NamedTuple):
    """Exact positions of the parts that an image shows.

    Attributes
    ----------
    position : (M, 2)
        Positions of the parts [m, plate_home].
    angle : (M,)
        Angles of the parts [rad].
    seen : (M,)
        Whether the image shows each part.
    false : (F, 2)
        Positions of false parts, which do not exist on the plate [m, plate_home].
    """

    position: np.ndarray
    angle: np.ndarray
    seen: np.ndarray
    false: np.ndarray


class CameraView:
    """Camera of a simulation. The object also stores the appearance and the past motion of the
    parts.

    Parameters
    ----------
    rig : Rig
    seed : int
        Random seed from which the sizes of the parts are computed.
    marked : bool
        Whether round parts have a mark that shows their angle.
    disturbances : Disturbances
    noise : float
        Standard deviation of the noise of a pixel [grey values].
    pixels, images, parts, stamps : Generator
        Random number generators for pixel noise, for missed images, for missed and false parts, and
        for stamps.

    Attributes
    ----------
    history : History
        Past motion of parts and plate, over the time that images can show.
    past : float
        Maximum age of the states that an image can show [s].
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

    def set_types(self, ids: tuple[str, ...], types: list[PartType]) -> None:
        """Set the appearance of the parts that exist now, and the attribute `past`."""
        world, camera = self._disturbances, self._rig.camera
        anytime = world.image_rate > 0 or camera.trigger is not None
        needed = anytime or camera.readout_s > 0
        self.past = world.latency + (camera.exposure_s + camera.readout_s if needed else 0.0)
        self._types = types
        self._grey = part_colours(types, self._rig.camera.colour, world.greys)
        height = np.array([world.part_height_m or part.height_m for part in types])
        self._height = height if np.any(height) else None
        self._size = None
        if world.size_spread:
            units = [_part_random_number(self._seed, name) for name in ids]
            self._size = 1 + world.size_spread * np.array(units)
        self._typed = any(part_class(name) in self._rig.types for name in ids)
        self._nothing = np.zeros(len(ids), bool), np.zeros((0, 2)), np.zeros(0, np.int64)

    def change(self, disturbances: Disturbances, noise: float) -> None:
        """Apply new disturbances. The caller must then call `set_types`."""
        before, self._disturbances, self._noise = self._disturbances, disturbances, noise
        if any(getattr(before, name) != getattr(disturbances, name) for name in NEEDS_NEW_CAMERA):
            # the cached renderer has the old settings, so create a new one
            self.__dict__.pop("_camera", None)
        self._camera.noise = noise

    @cached_property
    def _camera(self) -> Camera:
        """Renderer of images. The renderer is created when the first image is requested. The
        creation of the renderer takes as long as a hundred cycles, and simulations without images
        do not need a renderer."""
        world = self._disturbances
        return Camera(
            self._rig, self._noise, plate=world.plate_grey, room=world.room_grey,
            defocus_px=world.defocus_px,
        )  # fmt: skip

    def shots(self, begin: float) -> Iterator[Shot]:
        """Yield the times of the images of a free-running camera from the time `begin` [s] on. The
        sequence has no end."""
        camera, world, rng = self._rig.camera, self._disturbances, self._stamp_rng
        interval, last = 1 / max(world.image_rate, 1e-9), -np.inf
        shown = camera.exposure_s + camera.readout_s
        middle = begin + interval * rng.random()
        while True:
            jitter = world.stamp_jitter * rng.standard_normal()
            # Each stamp is after the last stamp, because the jitter of a real camera does not
            # change the order of the stamps.
            last = max(middle + world.latency + jitter, last + FINEST_STAMP_S)
            yield Shot(middle, last, middle + max(world.latency, shown / 2))
            middle += interval

    def capture(
        self, state: WorldState, plate: PlateState, robot: Robot, now: float, age: float | None
    ) -> np.ndarray | None:
        """Return the image (height, width), uint8, that is delivered at the time `now` [s]. Return
        None if this image is missing. See `Simulation.capture`."""
        shown = self._draw_errors()
        if shown is None:
            return None
        hidden, position, like = shown
        path, angle, seen, pose = self._make_view(state, plate, age)
        false = len(like)
        drawn = np.append(np.flatnonzero(seen & ~hidden), like)
        spots = np.broadcast_to(position, (len(path), false, 2))
        drawn_path = path[:, drawn[: len(drawn) - false]]
        turned = self._marked or self._typed
        old = self._disturbances.latency if age is None else age
        return self._camera.render(
            np.concatenate([drawn_path, spots], axis=1),
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

    def visible_parts(
        self, state: WorldState, plate: PlateState, age: float | None
    ) -> VisibleParts | None:
        """Return the exact positions of the parts in the image that `capture` would return. Return
        None if this image is missing."""
        shown = self._draw_errors()
        if shown is None:
            return None
        hidden, place, _ = shown
        if self._shows_past_state:
            path, angle, seen, _ = self._make_view(state, plate, age)
            return VisibleParts(path[len(path) // 2], angle, seen & ~hidden, place)
        position = state.position + self._exposure_s * state.velocity
        seen = state.on_plate if shown is self._nothing else state.on_plate & ~hidden
        return VisibleParts(position, state.angle, seen, place)

    def capture_bare(self, now: float) -> np.ndarray:
        """Return an image of the plate without parts, at home, at the time `now` [s]."""
        return self._camera.render(
            np.zeros((0, 2)), self._grey[:0], self._pixel_rng,
            lighting=self._disturbances.lighting(now),
        )  # fmt: skip

    def _draw_errors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Generate the random errors of an image. Return None if the image is missing, otherwise
        three arrays. The first array states for each part whether it is hidden (M,). The second
        array contains the positions of the false parts (F, 2) [m]. The third array contains, for
        each false part, the index (F,) of a part with the same appearance."""
        count, world = len(self._types), self._disturbances
        if not (world.missed_images or world.missed_parts or world.false_parts):
            return self._nothing
        missed = self._image_rng.random() < self._disturbances.missed_images
        hidden = self._part_rng.random(count) < self._disturbances.missed_parts
        false = self._part_rng.binomial(count, self._disturbances.false_parts)
        position = self._rig.plate.half * self._part_rng.uniform(-1, 1, (false, 2))
        like = self._part_rng.choice(count, false)
        return None if missed else (hidden, position, like)

    @property
    def _shows_past_state(self) -> bool:
        """Whether images show an earlier state than the present one."""
        return bool(self.past and self.history.passages)

    @property
    def _exposure_s(self) -> float:
        """Exposure time during which the motion of parts is visible [s]. 0 without motion blur."""
        return self._rig.camera.exposure_s if self._disturbances.blur else 0.0

    def _make_view(
        self, state: WorldState, plate: PlateState, age: float | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """Return what an image shows, as four arrays. The first three arrays contain the positions
        of the parts over the exposure (s, M, 2), the angles (M,), and whether each part is on the
        plate (M,). The fourth array contains the poses of the plate. The poses have the shape (s,
        3), or (b, s, 3) for b bands of image rows. If the plate is at home, the poses are None."""
        camera, exposure = self._rig.camera, self._exposure_s
        if self._shows_past_state:
            shown = exposure + camera.readout_s
            first = self._disturbances.latency if age is None else age + shown / 2
            return self._make_past_view(state, first, exposure, shown)
        later = np.array([0.0, exposure])[:, None]
        path = state.position + later[:, None] * state.velocity
        if self._rig.suspension is None:
            return path, state.angle, state.on_plate, None
        pose = plate.pose + later * plate.twist
        return path, state.angle, state.on_plate, pose

    def _make_past_view(
        self, state: WorldState, first: float, exposure: float, shown: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the four arrays of `_make_view` for an image that shows an earlier time. The
        exposure of the image's first row started `first` [s] ago.

        The exposure of the image's last row ended `shown` [s] after the exposure of the first row
        had started.
        """
        count = max(EXPOSURES, 1 + int(np.ceil(shown / MAX_STEP_S)))
        time = shown * np.linspace(0, 1, count)
        views = [self.history.ago(first - t) for t in time]
        path, pose = (np.stack([getattr(v, n) for v in views]) for n in ("position", "pose"))
        middle, readout = views[count // 2], self._rig.camera.readout_s
        # Since the last cycle, parts may have been added or removed. `state` contains these
        # changes, but the history does not.
        on_plate = middle.on_plate if first >= time[count // 2] else state.on_plate
        if readout == 0:
            return path, middle.angle, on_plate, pose
        row = np.clip(row_delay(self._rig, middle.position) / readout + 0.5, 0, 1)
        begin = readout * np.append(row, (np.arange(BANDS) + 0.5) / BANDS)
        times = begin[:, None] + exposure * np.linspace(0, 1, EXPOSURES)
        parts = len(row)
        seen = np.empty((EXPOSURES, parts, 2))
        for i in range(parts):
            for axis in range(2):
                seen[:, i, axis] = np.interp(times[i], time, path[:, i, axis])
        poses = np.empty((BANDS, EXPOSURES, 3))
        for band in range(BANDS):
            for axis in range(3):
                poses[band, :, axis] = np.interp(times[parts + band], time, pose[:, axis])
        return seen, middle.angle, on_plate, poses


def check_height(rig: Rig, disturbances: Disturbances) -> None:
    """Raise an error if parts have a height and the position of the camera is unknown, or if a part
    is as high as the camera."""
    named = {f"types: {name}: height_m": part.height_m for name, part in rig.types.items()}
    heights = {
        "part_height_m": disturbances.part_height_m,
        "parts: height_m": rig.parts.height_m,
        **named,
    }
    high = [(name, value) for name, value in heights.items() if value > 0]
    if not high or (position := camera_position(rig)) is None:
        if high:
            raise PlateError(
                f"{high[0][0]} is {high[0][1]:g}, allowed: 0, because the rig file gives neither "
                "focal_px nor camera: height_m, so the camera's position is unknown"
            )
        return
    for name, value in high:
        if value >= position[2]:
            raise PlateError(
                f"{name} is {value:g}, allowed: less than the camera's height, {position[2]:.3g} m"
            )


def _part_random_number(seed: int, part_id: str) -> float:
    """Return a random number from -1 to 1 (uniform distribution) for a part. The number depends
    only on the seed and on the id of the part."""
    rng = np.random.default_rng([seed, zlib.crc32(part_id.encode())])
    return float(rng.uniform(-1, 1))
