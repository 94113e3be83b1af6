"""Difficult scenes of parts of any outline, drawn at sub-pixels.

The scenes have uneven light, shadows, blur and noise.

The parts are those of config/parts.yaml at the scale of the default rig. The detector gets images
of the bare plate before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from harness import ROOT
from plate_core.rig import PartType, load_part_types, moments
from plate_vision.shapes import Background, learn_plate

SIZE_PX = (640, 480)
"""Width and height of the scenes."""

SCALE_PX_M = 1000.0
"""Scale: one pixel per millimetre, as in images of the default rig's camera [px/m]."""

SUB = 8
"""Number of sub-pixels along each side of a pixel."""

PARTS = 20
"""Number of parts in a scene."""

PLATES_LAB = ((80.0, 0.0, 2.0), (78.0, 6.0, 28.0), (14.0, 0.0, 0.0))
"""Colours of the plate, used in turn: light, wooden, black."""

BARE = 5
"""Number of images of the bare plate."""

NOISE = 2.0
"""Standard deviation of the camera's noise in each colour [grey levels]."""

TRIES = 4000
"""Maximum number of attempts to place the parts."""


@dataclass(frozen=True)
class Part:
    """A part in a scene: its type, centre (2,) [px], angle [rad] and scale [px/m]."""

    kind: PartType
    centre_px: np.ndarray
    angle_rad: float
    scale: float = SCALE_PX_M

    @property
    def reach_px(self) -> float:
        """Maximum distance of its contour from its centre [px]."""
        return self.kind.reach_m * self.scale

    @property
    def radius_px(self) -> float:
        """Radius of the disc with the same area [px]."""
        return float(np.sqrt(self.kind.area_m2 / np.pi)) * self.scale

    def corners_px(self, polygon: np.ndarray) -> np.ndarray:
        """Return the corners (n, 2) [px], y down, of a polygon (n, 2) [m] of its type."""
        c, s = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.asarray(
            self.scale * (polygon @ np.array([[c, s], [-s, c]])) * (1, -1) + self.centre_px
        )

    @property
    def middle_px(self) -> np.ndarray:
        """Centre (2,) of its drawn area [px]."""
        kind = self.kind
        return self.corners_px(
            moments(kind.polygon, [np.array(hole) for hole in kind.holes])[1][None]
        )[0]


@dataclass(frozen=True)
class Kind:
    """A kind of scene, as its differences from an easy one."""

    name: str
    types: tuple[str, ...] = ()
    place: Callable[..., list[Part]] | None = None
    gap_px: float = 3.0
    blur_px: tuple[float, float] = (0.6, 0.6)
    highlight: bool = False
    shadow: bool = False
    jpeg: bool = False
    bayer: bool = False
    texture: bool = False
    vignetting: bool = False
    two_colours: bool = False
    grey: bool = False


def kinds() -> list[Kind]:
    """Return all kinds of scenes."""
    convex = ("nut", "washer", "square", "bar", "coin_small", "coin_middle", "coin_large")
    return [
        Kind("easy"),
        Kind("easy, grey levels", grey=True),
        Kind("highlight of 2 to 5 %", highlight=True),
        Kind("shadow", shadow=True, gap_px=8),
        Kind("shadow, grey levels", shadow=True, gap_px=8, grey=True),
        *(
            Kind(f"blur of {sigma} px", blur_px=(sigma, sigma), gap_px=3 * sigma)
            for sigma in (1, 2, 4, 6)
        ),
        Kind("JPEG quality 50 to 75", jpeg=True),
        Kind("Bayer mosaic", bayer=True),
        Kind("texture", texture=True),
        Kind("vignetting, other light", vignetting=True),
        Kind("holes", types=("nut", "washer")),
        Kind("two colours", two_colours=True),
        Kind("partly outside", place=at_the_border, gap_px=6),
        Kind("chains of convex parts", types=convex, place=chains),
        Kind("chains of discs", types=convex[4:], place=chains),
        Kind("clusters of convex parts", types=convex, place=clusters),
        Kind("chains of brackets and screws", types=("bracket", "screw"), place=chains),
        Kind("chains of all", place=chains),
        Kind(
            "all but touching", highlight=True, shadow=True, jpeg=True, bayer=True, texture=True,
            vignetting=True, gap_px=8, blur_px=(1, 1),
        ),
    ]  # fmt: skip


def has_room(part: Part, others: list[Part], gap_px: float) -> bool:
    """Whether the gap between a part and all others is large enough, between their circumscribed
    discs."""
    return all(
        np.hypot(*(part.centre_px - other.centre_px)) > part.reach_px + other.reach_px + gap_px
        for other in others
    )


def scattered(
    parts: list[Part], count: int, gap_px: float, drawn: Callable[[], Part]
) -> list[Part]:
    """Add random parts that keep the gap to others, until there are `count` parts or after
    `TRIES`."""
    for _ in range(TRIES):
        if len(parts) >= count:
            break
        part = drawn()
        if has_room(part, parts, gap_px):
            parts.append(part)
    return parts


def apart(kind: Kind, types: list[PartType], rng: np.random.Generator) -> list[Part]:
    """Scatter parts that are completely in the image, with a gap between any two."""

    def drawn() -> Part:
        part = any_part(types, rng)
        room = part.reach_px + 4
        return moved(part, rng.uniform((room, room), np.array(SIZE_PX) - room))

    return scattered([], PARTS, kind.gap_px, drawn)


def at_the_border(kind: Kind, types: list[PartType], rng: np.random.Generator) -> list[Part]:
    """Scatter parts, and eight more at the border of the image."""
    width, height = SIZE_PX

    def drawn() -> Part:
        part = any_part(types, rng)
        side, along, out = rng.integers(4), rng.uniform(0.1, 0.9), rng.uniform(-0.4, 0.4)
        away, x, y = out * part.radius_px, along * width, along * height
        places = (x, away), (x, height - 1 - away), (away, y), (width - 1 - away, y)
        return moved(part, np.array(places[side]))

    return scattered(apart(kind, types, rng), PARTS + 8, kind.gap_px, drawn)


def chains(kind: Kind, types: list[PartType], rng: np.random.Generator) -> list[Part]:
    """Scatter rows of three to five parts. Each part touches the previous one."""
    return touching(kind, types, rng, np.deg2rad(40), around=False)


def clusters(kind: Kind, types: list[PartType], rng: np.random.Generator) -> list[Part]:
    """Scatter groups of three to five parts. All others touch the first one."""
    return touching(kind, types, rng, np.pi, around=True)


def touching(
    kind: Kind, types: list[PartType], rng: np.random.Generator, bend: float, around: bool
) -> list[Part]:
    """Scatter groups of parts that touch each other."""
    parts: list[Part] = []
    for _ in range(60):
        if len(parts) >= PARTS:
            break
        heading = rng.uniform(0, 2 * np.pi)
        group = [moved(any_part(types, rng), rng.uniform((60, 60), np.array(SIZE_PX) - 60))]
        count = int(rng.integers(3, 6))
        any_part(types, rng)  # this call draws random numbers, so that later scenes do not change
        for _ in range(count - 1):
            base = group[0] if around else group[-1]
            part = attached(any_part(types, rng), base, group, heading, bend, rng)
            if part is None:
                break
            group.append(part)
        if all(seen_inside(part) and has_room(part, parts, kind.gap_px) for part in group):
            parts += group
    return parts


def seen_inside(part: Part) -> bool:
    """Whether the circumscribed disc of a part is at least 3 px from the border of the image."""
    room = part.reach_px + 3
    return bool(np.all(part.centre_px > room) and np.all(part.centre_px < np.array(SIZE_PX) - room))


def attached(
    part: Part, base: Part, group: list[Part], heading: float, bend: float, rng: np.random.Generator
) -> Part | None:
    """Return a part that touches only the base of its group, or None if none is found. It is pushed
    from a random direction within `bend` of `heading` [rad]."""
    for _ in range(20):
        part = pushed(part, base, heading + rng.uniform(-bend, bend))
        if not any(overlap(part, other) for other in group if other is not base):
            return part
    return None


def pushed(part: Part, base: Part, way: float) -> Part:
    """Return a part moved towards another one from a direction [rad] until they touch."""
    ray = np.array([np.cos(way), np.sin(way)])
    near, far = 0.0, base.reach_px + part.reach_px + 1
    while far - near > 0.05:
        middle = 0.5 * (near + far)
        if overlap(moved(part, base.centre_px + middle * ray), base):
            near = middle
        else:
            far = middle
    return moved(part, base.centre_px + far * ray)


def overlap(one: Part, other: Part) -> bool:
    """Whether two parts overlap by more than a few sub-pixels."""
    if np.hypot(*(one.centre_px - other.centre_px)) > one.reach_px + other.reach_px:
        return False
    low = np.floor(one.centre_px - one.reach_px - 1).astype(int)
    side = int(2 * one.reach_px + 4)
    both = solid(one, low, side) & solid(other, low, side)
    return bool(np.count_nonzero(both) > SUB)


def any_part(types: list[PartType], rng: np.random.Generator) -> Part:
    """Return a part of a random type at a random angle."""
    return Part(types[rng.integers(len(types))], np.zeros(2), float(rng.uniform(0, 2 * np.pi)))


def moved(part: Part, centre_px: np.ndarray) -> Part:
    """Return a part at another centre."""
    return Part(part.kind, np.asarray(centre_px, float), part.angle_rad)


def seen_whole(part: Part) -> bool:
    """Whether a part is completely in the image."""
    corners = part.corners_px(part.kind.polygon)
    return bool(np.all(corners > 0.5) and np.all(corners < np.array(SIZE_PX) - 1.5))


def solid(part: Part, low: np.ndarray, side: int) -> np.ndarray:
    """Return the sub-pixels (SUB side, SUB side) bool of a part without its holes, in a window of
    the image with the first pixel `low`."""
    inside = np.zeros((SUB * side, SUB * side), np.uint8)
    kind = part.kind
    for polygon, value in [(kind.polygon, 1), *((np.array(hole), 0) for hole in kind.holes)]:
        corners = (part.corners_px(polygon) - low + 0.5) * SUB - 0.5
        fixed = np.rint(corners * 16).astype(np.int32)
        cv2.fillPoly(inside, [fixed], value, shift=4)
    return np.asarray(inside > 0)


def cover(part: Part, low: np.ndarray, side: int) -> np.ndarray:
    """Return the fraction of each pixel (side, side) of such a window that a part covers."""
    return np.asarray(solid(part, low, side).reshape(side, SUB, side, SUB).mean(axis=(1, 3)))


def window(part: Part) -> tuple[np.ndarray, int]:
    """Return the first pixel (2,) and the side [px] of a window of the image around a part."""
    low = np.floor(part.centre_px - part.reach_px - 2).astype(int)
    return low, int(2 * part.reach_px + 6)


def draw(
    kind: Kind, parts: list[Part], plate: np.ndarray, light: float, rng: np.random.Generator
) -> np.ndarray:
    """Return an image (H, W, 3) or (H, W) uint8 of parts on a plate (H, W, 3)."""
    width, height = SIZE_PX
    picture = plate.astype(np.float32)
    covers = []
    for part in parts:
        low, side = window(part)
        share = cover(part, low, side)
        covers.append(np.zeros((height, width), np.float32))
        x0, y0 = np.maximum(low, 0)
        x1, y1 = np.minimum(low + side, SIZE_PX)
        covers[-1][y0:y1, x0:x1] = share[y0 - low[1] : y1 - low[1], x0 - low[0] : x1 - low[0]]
    if kind.shadow:
        way, depth = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 0.4)
        shift = np.array([[1, 0, 4 * np.cos(way)], [0, 1, 4 * np.sin(way)]])
        cast = cv2.warpAffine(np.max(covers, axis=0), shift, SIZE_PX)
        picture *= 1 - depth * cv2.GaussianBlur(cast, (0, 0), rng.uniform(1.5, 3))[:, :, None]
    for part, share in zip(parts, covers, strict=True):
        low, side = np.maximum(window(part)[0], 0), window(part)[1]
        here = np.s_[low[1] : low[1] + side, low[0] : low[0] + side]
        paint = np.tile(bgr(lab_of(part, rng)), (*share[here].shape, 1))
        y, x = np.mgrid[: paint.shape[0], : paint.shape[1]] + low[::-1][:, None, None]
        way = rng.uniform(0, 2 * np.pi)
        along = (x - part.centre_px[0]) * np.cos(way) + (y - part.centre_px[1]) * np.sin(way)
        if kind.two_colours:
            lab = rng.uniform((25, -40, -40), (60, 40, 40))
            paint[along > rng.uniform(-0.3, 0.3) * part.radius_px] = bgr(lab)
        if kind.highlight:
            paint = shine(paint, share[here], x, y, part, rng)
        inside = share[here][:, :, None]
        picture[here] = picture[here] * (1 - inside) + paint * inside
    return photographed(kind, picture, light, rng)


def shine(
    paint: np.ndarray, cover: np.ndarray, x: np.ndarray, y: np.ndarray, part: Part,
    rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """Return the colours (h, w, 3) of a part with a white spot on it, 2 to 5 % of its area."""
    rows, columns = np.nonzero(cover > 0.99)
    spot = rng.integers(len(rows))
    radius = part.radius_px * np.sqrt(rng.uniform(0.02, 0.05))
    gap = np.hypot(x - x[rows[spot], columns[spot]], y - y[rows[spot], columns[spot]])
    share = np.clip(radius + 0.5 - gap, 0, 1)[:, :, None]
    return np.asarray(paint * (1 - share) + 252 * share)


def photographed(
    kind: Kind, picture: np.ndarray, light: float, rng: np.random.Generator
) -> np.ndarray:
    """Return the camera image of a scene (H, W, 3), uint8."""
    blur = rng.uniform(*kind.blur_px)
    picture = cv2.GaussianBlur(picture, (0, 0), blur) * light
    if kind.vignetting:
        y, x = np.mgrid[-1 : 1 : SIZE_PX[1] * 1j, -1 : 1 : SIZE_PX[0] * 1j]
        picture = picture * (1 - 0.2 * (x * x + y * y))[:, :, None]
    picture = picture + NOISE * rng.standard_normal(picture.shape)
    image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    if kind.bayer:
        mosaic = image[:, :, 1].copy()
        mosaic[::2, ::2], mosaic[1::2, 1::2] = image[::2, ::2, 2], image[1::2, 1::2, 0]
        image = np.asarray(cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2BGR))
    if kind.jpeg:
        quality = int(rng.integers(50, 76))
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        image = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if kind.grey else image


def bare_plate(kind: Kind, lab: tuple[float, ...], rng: np.random.Generator) -> np.ndarray:
    """Return the colours (H, W, 3) of a plate without parts."""
    width, height = SIZE_PX
    plate = np.tile(bgr(np.array(lab)), (height, width, 1))
    if kind.texture:
        grain = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), 1.2)
        scratches = cv2.GaussianBlur(rng.standard_normal((height, width)), (31, 1), 10, sigmaY=0.1)
        both = grain / np.std(grain) + scratches / np.std(scratches)
        plate = plate * (1 + 0.05 * both[:, :, None])
    return plate


def lab_of(part: Part, rng: np.random.Generator) -> np.ndarray:
    """Return the colour (3,) of one part, with a small random deviation from its type's."""
    return np.asarray(part.kind.colour_lab) + rng.normal(0, 2, 3)


def bgr(lab: np.ndarray) -> np.ndarray:
    """Return blue, green, red (3,) [grey levels] of a colour L, a, b."""
    colour = cv2.cvtColor(np.asarray(lab, np.float32)[None, None], cv2.COLOR_Lab2BGR)
    return np.asarray(255 * colour[0, 0], float)


def scenes(
    kind: Kind, numbers: Iterable[int]
) -> Iterator[tuple[Background, np.ndarray, list[Part]]]:
    """Yield scenes of one kind: the learned background, an image, and the parts in it."""
    every = all_types()
    types = [every[name] for name in kind.types or every]
    for number in numbers:
        rng = np.random.default_rng([number, *kind.name.encode()])
        plate = bare_plate(kind, PLATES_LAB[number % len(PLATES_LAB)], rng)
        learned = learn_plate(np.stack([photographed(kind, plate, 1, rng) for _ in range(BARE)]))
        parts = (kind.place or apart)(kind, types, rng)
        light = float(rng.uniform(0.88, 1.08)) if kind.vignetting else 1.0
        yield learned, draw(kind, parts, plate, light, rng), parts


def all_types() -> Mapping[str, PartType]:
    """Return all types of parts, by their names."""
    return load_part_types(ROOT / "config/parts.yaml")
