"""Images of discs by casting a ray through each of many points of a pixel: an independent truth.

It shares no code with the simulator's camera. Cylinders stand on a plate; a pinhole camera or one
with a lens looks at it; one far lamp casts shadows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from plate_core import load_rig
from plate_core.rig import Lens

SIZE = (480, 300)
HALF = np.array([0.2, 0.12])
"""Width and height of the images [px], half sides of the plate [m]."""

FINE = 4
"""Points of a pixel along each axis."""

SLICES = 20
"""Circles of which the side face of a cylinder is made."""


@dataclass(frozen=True)
class Look:
    """A camera `distance` [m] from the middle of the plate, turned about the image's axes."""

    distance: float = 0.9
    focal_px: float = 1000.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    @property
    def matrix(self):
        middle = (np.array(SIZE) - 1) / 2
        return np.array([[self.focal_px, 0, middle[0]], [0, self.focal_px, middle[1]], [0, 0, 1.0]])

    @property
    def rotation(self):
        about_x = cv2.Rodrigues(np.array([np.radians(self.tilt_deg[0]), 0, 0]))[0]
        about_y = cv2.Rodrigues(np.array([0, np.radians(self.tilt_deg[1]), 0]))[0]
        return about_x @ about_y @ np.diag([1.0, -1.0, -1.0])

    @property
    def place(self):
        return -self.rotation.T @ [0, 0, self.distance]

    def project(self, point):
        """Return image points (n, 2) [px] of points (n, 3) [m, plate_home]."""
        turn = cv2.Rodrigues(self.rotation)[0]
        middle = np.array([0, 0, self.distance])
        seen, _ = cv2.projectPoints(np.asarray(point, float), turn, middle, self.matrix, None)
        return seen.reshape(-1, 2)

    def rig(self, radius=0.008, height=0.0, calibrated=True):
        """Return the rig that this camera belongs to."""
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * HALF
        seen = self.project(np.column_stack([corners, np.zeros(4)]))
        matrix = self.matrix
        lens = Lens((matrix[0, 0], matrix[1, 1]), (matrix[0, 2], matrix[1, 2]))
        rig = load_rig()
        camera = replace(
            rig.camera,
            width_px=SIZE[0],
            height_px=SIZE[1],
            corners_px=tuple(map(tuple, seen.tolist())),
            lens=lens if calibrated else None,
        )
        return replace(
            rig,
            plate=replace(rig.plate, length_m=2 * HALF[0], width_m=2 * HALF[1]),
            parts=replace(rig.parts, radius_m=radius, height_m=height),
            camera=camera,
        )


@lru_cache(maxsize=2)  # 37 MB each
def places_of(look):
    """Return where the rays of a camera through the fine points meet the plate (h, w, 2) [m]. The
    array must not be changed."""
    step = (np.arange(FINE) + 0.5) / FINE - 0.5
    x = (np.arange(SIZE[0])[:, None] + step).ravel()
    y = (np.arange(SIZE[1])[:, None] + step).ravel()
    ray = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], axis=-1)
    ray = ray @ np.linalg.inv(look.matrix).T @ look.rotation
    far = -look.place[2] / ray[..., 2]
    places = look.place[:2] + far[..., None] * ray[..., :2]
    places.flags.writeable = False
    return places


def cast(
    look,
    position,
    colour,
    rng,
    *,
    radius=0.008,
    height=0.0,
    side=0.65,
    plate=220.0,
    gloss=0.0,
    shadow=(0.0, 0.0, 0.0),
    soft_px=0.0,
    blur_px=0.5,
    noise=2.0,
):
    """Return the image (h, w) or (h, w, 3) uint8 of parts at places (n, 2) [m].

    `colour` (n,) or (n, 3) are their grey values, or blue, green and red; `radius` a number or (n,)
    [m]; `side` the brightness of side faces relative to the top; `gloss` the radius of a highlight
    relative to the part's; `shadow` x, y of its end [m], and the fraction of the light that is
    missing in it, which fades over `soft_px`.
    """
    places, above = places_of(look), look.place
    colour = np.asarray(colour, float)
    channels = colour.shape[1] if colour.ndim == 2 else 1
    radii = np.broadcast_to(radius, len(position))
    inside = np.all(np.abs(places) < HALF, axis=-1)[..., None]

    def window(at, reach):
        """Rows and columns of the fine points that look within a reach [m] of a place."""
        rim = reach * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        around = look.project(np.column_stack([at + rim, np.zeros(4)]))
        low = np.maximum(FINE * np.floor(around.min(axis=0)).astype(int), 0)
        high = np.maximum(FINE * np.ceil(around.max(axis=0) + 1).astype(int), 0)
        return np.s_[low[1] : high[1], low[0] : high[0]]

    image = np.where(inside, plate, 60.0) * np.ones(channels)
    way, depth = np.array(shadow[:2]), shadow[2]
    if depth:
        dark = np.zeros(places.shape[:2])
        for at, r in zip(position, radii, strict=True):
            here = window(at, r + np.hypot(*way))
            offset = places[here] - at
            along = np.clip(offset @ way / (way @ way), 0, 1)
            dark[here][np.hypot(*np.moveaxis(offset - along[..., None] * way, -1, 0)) < r] = 1
        if soft_px:
            dark = cv2.GaussianBlur(dark, (0, 0), soft_px * FINE)
        image *= 1 - depth * dark[..., None]
    order = np.argsort(-np.hypot(*(np.asarray(position) - above[:2]).T))
    for k in order:
        at, r = position[k], radii[k]
        lean = np.hypot(*(at - above[:2])) * height / (above[2] - height)
        here = window(at, 1.1 * r + lean)
        seen, part = places[here], image[here]
        for level in np.linspace(0, height, SLICES if height else 1):
            growth = above[2] / (above[2] - level)
            top = np.hypot(*np.moveaxis(seen - above[:2] - growth * (at - above[:2]), -1, 0))
            part[top < growth * r] = colour[k] * (side if level < height else 1.0)
        if gloss:
            spot = at + r * np.array([0.25, 0.15])
            off = np.hypot(*np.moveaxis(seen - above[:2] - growth * (spot - above[:2]), -1, 0))
            part[off < gloss * r] = 250.0
    small = image.reshape(SIZE[1], FINE, SIZE[0], FINE, channels).mean(axis=(1, 3))
    small = cv2.GaussianBlur(small, (0, 0), blur_px).reshape(small.shape)
    small = np.clip(np.rint(small + rng.normal(0, noise, small.shape)), 0, 255).astype(np.uint8)
    return small if colour.ndim == 2 else small[..., 0]
