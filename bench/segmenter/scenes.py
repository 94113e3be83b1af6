"""Rendered scenes of small parts on all kinds of ground, with the parts that they show.

Everything is drawn at random from one generator: outlines, materials, ground, light, camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from segmenter.outlines import Outline, Rng, draw_outline

SIDE_PX = 192
"""Of a scene."""

RIM_PX = 64
"""Of what is drawn around it, so that parts are cut off by its border."""

RADIUS_PX = (4.0, 60.0)
"""Of parts."""

MOST_PARTS = 60

LEAST_PX = 30
"""Of a part that is drawn."""

FREE, LAID_OVER = 0.015, 0.15
"""Of a part so much may lie on others."""


@dataclass(frozen=True)
class Kind:
    """What parts of one kind look like.

    Attributes
    ----------
    outline : Outline
    radius_px, jitter : float
        Size, and its relative deviation from part to part.
    colour, second : (3,)
        Blue, green, red; of the main part, and of what `zone` tells.
    zone : int
        0: one colour; 1: one end, 2: both ends, 3: the middle, 4: a core has the second one.
    uneven : float
        Deviation of the colour from part to part.
    texture, bevel, shine : float
        Grey levels.
    printed : int
        Marks upon it.
    seed : int
        Of marks and texture that all parts of the kind have.
    """

    outline: Outline
    radius_px: float
    jitter: float
    colour: np.ndarray
    second: np.ndarray
    zone: int
    uneven: float
    texture: float
    bevel: float
    shine: float
    printed: int
    seed: int


def draw_scene(rng: Rng, side: int = SIDE_PX) -> tuple[np.ndarray, np.ndarray]:
    """Draw a scene.

    Returns
    -------
    image : (side, side, 3) uint8
        Blue, green, red.
    instances : (side, side) int32
        Number of the part that a pixel shows, its holes filled; 0: ground.
    """
    size = side + 2 * RIM_PX
    image, ground = _ground(rng, size)
    instances = np.zeros((size, size), np.int32)
    radius = float(np.exp(rng.uniform(*np.log(RADIUS_PX))))
    kinds = [_draw_kind(rng, radius, ground) for _ in range(int(rng.choice([1, 1, 2, 3, 5])))]
    most = int(min(MOST_PARTS, 0.55 * (size / radius) ** 2 / np.pi)) + 1
    wanted = int(rng.integers(1, most + 1)) if rng.random() > 0.05 else 0
    places = _clutter(rng, image, ground, radius)
    light = _direction(rng)
    shadow = rng.uniform(0, 0.65) * (rng.random() < 0.6), rng.uniform(0.05, 0.4)
    touching = rng.random() * (rng.random() < 0.8)
    over = LAID_OVER if rng.random() < 0.12 else FREE
    drawn: list[tuple[int, int, float]] = []
    for _ in range(wanted):
        kind = kinds[int(rng.integers(len(kinds)))]
        size_px = max(RADIUS_PX[0], kind.radius_px * (1 + kind.jitter * rng.normal()))
        turn = rng.uniform(0, 2 * np.pi)
        cover, solid = _masks(kind.outline, size_px, turn, rng.uniform(0, 1, 2))
        if len(solid) >= size or np.count_nonzero(solid) < LEAST_PX:
            continue
        place = _free_place(rng, instances, solid, size_px, drawn, touching, over, places)
        if place is None:
            continue
        drawn.append((*place, size_px))
        _lay(rng, image, kind, cover, turn, size_px, place, light, shadow)
        _window(instances, place, solid)[solid] = len(drawn)
    image = _photograph(rng, image, light)
    inner = np.s_[RIM_PX : RIM_PX + side, RIM_PX : RIM_PX + side]
    return image[inner], instances[inner]


# Ground


def _noise(rng: Rng, shape: tuple[int, int], grain: tuple[float, float]) -> np.ndarray:
    """Return smooth noise (h, w) of deviation 1, of a grain [px] along x and y."""
    small = [max(3, int(n / max(g, 0.3)) + 3) for n, g in zip(shape, grain[::-1], strict=True)]
    rough = rng.normal(0, 1, small).astype(np.float32)
    return np.asarray(cv2.resize(rough, shape[::-1], interpolation=cv2.INTER_CUBIC))


def _colour(rng: Rng) -> np.ndarray:
    """Return a colour (3,), more often dull than bright."""
    spread = 8 if rng.random() < 0.55 else 55
    return np.clip(rng.uniform(8, 250) + rng.normal(0, spread, 3), 2, 253).astype(np.float32)


def _direction(rng: Rng) -> np.ndarray:
    turn = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(turn), np.sin(turn)])


def _textured(rng: Rng, shape: tuple[int, int], colour: np.ndarray, strength: float) -> np.ndarray:
    """Return a surface (h, w, 3) float32: plain, grained, brushed, woven or of wood."""
    image = np.empty((*shape, 3), np.float32)
    image[:] = colour
    for _ in range(int(rng.integers(0, 4))):
        grain = np.exp(rng.uniform(0, 3.7, 2)) if rng.random() < 0.3 else [rng.uniform(1, 40)] * 2
        tint = 1 if rng.random() < 0.7 else (1 + rng.normal(0, 0.35, 3)).astype(np.float32)
        image += strength * rng.gamma(1, 5) * _noise(rng, shape, tuple(grain))[..., None] * tint
    if rng.random() < 0.2:
        y, x = np.mgrid[: shape[0], : shape[1]]
        wave = rng.normal(0, 0.25, 2) * rng.uniform(1, 4)
        phase = wave[0] * x + wave[1] * y + 2 * _noise(rng, shape, (30, 30))
        image += (strength * rng.gamma(1, 5) * np.sin(phase))[..., None]
    return image


def _ground(rng: Rng, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what parts lie on (size, size, 3) float32, and its colour (3,)."""
    colour = _colour(rng)
    image = _textured(rng, (size, size), colour, 1.2)
    if rng.random() < 0.12:  # it ends within the picture
        y, x = np.mgrid[:size, :size] / size - 0.5
        way = _direction(rng)
        beside = way[0] * x + way[1] * y > rng.uniform(0.1, 0.45)
        image[beside] = _textured(rng, (size, size), _colour(rng), 0.7)[beside]
    return image, colour


def _clutter(
    rng: Rng, image: np.ndarray, ground: np.ndarray, radius: float
) -> list[tuple[int, int]]:
    """Draw what is no part: dust, scratches, print, pockets of a tray, holes of a tape.

    Returns the middles of pockets that parts are to lie in; none: parts lie anywhere.
    """
    size = len(image)
    count = int(rng.integers(1, 7)) if rng.random() < 0.35 else 0
    for _ in range(count):
        colour = (ground + rng.normal(0, 50, 3)).tolist()
        begin, end = (tuple(int(v) for v in rng.integers(0, size, 2)) for _ in range(2))
        kind = int(rng.integers(3))
        if kind == 0:
            cv2.circle(image, begin, int(rng.integers(1, 3)), colour, -1, cv2.LINE_AA)
        elif kind == 1:
            cv2.line(image, begin, end, colour, 1, cv2.LINE_AA)
        else:
            word = "".join(rng.choice(list("A7xk20.-"), 5))
            scale = rng.uniform(0.3, 1.2)
            ink = np.zeros((size, size), np.uint8)
            cv2.putText(ink, word, begin, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, 1, cv2.LINE_AA)
            image[ink > 90] = colour
    if rng.random() > 0.12:
        return []
    pitch = radius * rng.uniform(2.6, 4.0)
    turn = rng.uniform(0, np.pi) if rng.random() < 0.3 else rng.normal(0, 0.03)
    along = np.array([np.cos(turn), np.sin(turn)])
    across = np.array([-along[1], along[0]]) * rng.choice([1.0, 1.0, 1.6])
    half, round_ones = pitch * rng.uniform(0.3, 0.46), rng.random() < 0.4
    depth, edge = rng.normal(0, 25), rng.normal(0, 50)
    reach = int(size / pitch)
    middles = []
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            middle = size / 2 + pitch * (i * along + j * across)
            middles.append((int(middle[0]), int(middle[1])))
            if round_ones:
                ring = middle + half * _CIRCLE
            else:
                ring = middle + half * (_SQUARE @ np.array([along, [-along[1], along[0]]]))
            points = [np.rint(16 * ring).astype(np.int32)]
            inside = np.zeros((size, size), np.uint8)
            cv2.fillPoly(inside, points, 1, cv2.LINE_8, 4)
            image[inside > 0] += depth
            rim = (ground + edge).tolist()
            cv2.polylines(image, points, True, rim, int(rng.integers(1, 3)), cv2.LINE_AA, 4)
    return middles


_CIRCLE = np.stack([f(np.linspace(0, 2 * np.pi, 40, endpoint=False)) for f in (np.cos, np.sin)], 1)
_SQUARE = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])


# Parts


def _draw_kind(rng: Rng, radius: float, ground: np.ndarray) -> Kind:
    """Draw a kind of part that is seen before the ground."""
    least = 10 if rng.random() < 0.25 else 35
    colour = _colour(rng)
    for _ in range(9):
        if np.abs(colour - ground).max() > least:
            break
        colour = _colour(rng)
    zone = int(rng.integers(1, 5)) if rng.random() < 0.35 else 0
    second = _colour(rng)
    if zone == 3 and rng.random() < 0.5:
        second = ground + rng.normal(0, 6, 3)  # only its ends are seen well
    return Kind(
        outline=draw_outline(rng),
        radius_px=radius * np.exp(rng.normal(0, 0.3)),
        jitter=float(rng.choice([0, 0.02, 0.15])),
        colour=colour, second=second.astype(np.float32), zone=zone,
        uneven=rng.uniform(0, 12), texture=rng.gamma(1, 0.5),
        bevel=rng.gamma(1, 14) * rng.integers(2),
        shine=rng.uniform(40, 220) * (rng.random() < 0.45),
        printed=int(rng.integers(1, 5)) if rng.random() < 0.35 else 0,
        seed=int(rng.integers(2**30)),
    )  # fmt: skip


def _masks(
    outline: Outline, radius: float, turn: float, shift: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how much of each pixel (d, d) is part, 0 to 1, and which belong to it, holes
    filled."""
    rings = outline.solid + outline.holes
    reach = int(np.ceil(radius * max(np.hypot(*ring.T).max() for ring in rings))) + 3
    side = 2 * reach + 1
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    masks = np.zeros((2, side, side), np.uint8)
    for mask, those in zip(masks, (outline.solid, outline.holes), strict=True):
        for ring in those:
            points = radius * ring @ rotation.T + reach + shift
            cv2.fillPoly(mask, [np.rint(16 * points).astype(np.int32)], 255, cv2.LINE_AA, 4)
    solid, holes = masks.astype(np.float32) / 255
    return solid * (1 - holes), masks[0] > 127


def _window(image: np.ndarray, place: tuple[int, int], mask: np.ndarray) -> np.ndarray:
    """Return the part of an image in whose middle a mask (d, d) lies at a place (x, y)."""
    reach = len(mask) // 2
    x, y = place
    return image[y - reach : y + reach + 1, x - reach : x + reach + 1]


def _covered(instances: np.ndarray, place: tuple[int, int], solid: np.ndarray) -> float:
    """Return how much of a part would lie on others; infinite beyond the border."""
    here = _window(instances, place, solid)
    if here.shape != solid.shape or min(place) < len(solid) // 2:
        return float("inf")
    return np.count_nonzero(here[solid]) / np.count_nonzero(solid)


def _free_place(
    rng: Rng,
    instances: np.ndarray,
    solid: np.ndarray,
    radius: float,
    drawn: list[tuple[int, int, float]],
    touching: float,
    over: float,
    places: list[tuple[int, int]],
) -> tuple[int, int] | None:
    """Return where a part may lie: anywhere, in a pocket, or moved up to another one."""
    if places:
        place = places[int(rng.integers(len(places)))]
        return place if _covered(instances, place, solid) == 0 else None
    if not drawn or rng.random() >= touching:
        for _ in range(8):
            x, y = (int(v) for v in rng.integers(0, len(instances), 2))
            if _covered(instances, (x, y), solid) == 0:
                return x, y
        return None
    for _ in range(4):
        x, y, other = drawn[int(rng.integers(len(drawn)))]
        way = _direction(rng)
        near, far = 0.3 * (radius + other), 1.8 * (radius + other)
        for _ in range(7):
            middle = 0.5 * (near + far)
            place = int(x + middle * way[0]), int(y + middle * way[1])
            near, far = (
                (middle, far) if _covered(instances, place, solid) > over else (near, middle)
            )
        place = int(x + far * way[0]), int(y + far * way[1])
        if _covered(instances, place, solid) <= over:
            return place
    return None


def _lay(
    rng: Rng,
    image: np.ndarray,
    kind: Kind,
    cover: np.ndarray,
    turn: float,
    radius: float,
    place: tuple[int, int],
    light: np.ndarray,
    shadow: tuple[float, float],
) -> None:
    """Draw a part, and its shadow before."""
    darkness, softness = shadow
    if darkness:
        reach = len(cover) // 2
        wide = cv2.copyMakeBorder(cover, reach, reach, reach, reach, cv2.BORDER_CONSTANT)
        wide = cv2.GaussianBlur(wide, (0, 0), max(0.6, softness * radius))
        along, down = softness * radius * light
        moved = np.array([[1, 0, along], [0, 1, down]], np.float32)
        wide = cv2.warpAffine(wide, moved, wide.shape[::-1])
        x0, y0 = place[0] - 2 * reach, place[1] - 2 * reach
        left, top = max(-x0, 0), max(-y0, 0)
        here = image[max(y0, 0) : y0 + len(wide), max(x0, 0) : x0 + len(wide)]
        part = wide[top : top + here.shape[0], left : left + here.shape[1], None]
        here *= 1 - darkness * part
    surface = _surface(rng, kind, cover, turn, radius, light)
    here = _window(image, place, cover)
    here += cover[..., None] * (surface - here)


def _surface(
    rng: Rng, kind: Kind, cover: np.ndarray, turn: float, radius: float, light: np.ndarray
) -> np.ndarray:
    """Return the colours (d, d, 3) of a part."""
    own = np.random.default_rng(kind.seed)
    side = len(cover)
    surface = _textured(
        own if rng.random() < 0.5 else rng, cover.shape, kind.colour, kind.texture
    ) + rng.normal(0, kind.uneven)
    y, x = (np.mgrid[:side, :side] - side // 2) / radius
    along, across = x * np.cos(turn) + y * np.sin(turn), -x * np.sin(turn) + y * np.cos(turn)
    border = own.uniform(0.2, 0.5)
    zones = (None, along > border, np.abs(along) > border + 0.1, np.abs(along) < border,
             np.hypot(along, across) < border)  # fmt: skip
    zone = zones[kind.zone]
    if zone is not None:
        surface[zone] = kind.second + rng.normal(0, kind.uneven)
    for _ in range(kind.printed):
        ring = np.clip(draw_outline(own).solid[0], -1.2, 1.2) * own.uniform(0.1, 0.7)
        ring = ring + own.uniform(-0.4, 0.4, 2)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        points = [np.rint(16 * (radius * ring @ rotation.T + side // 2)).astype(np.int32)]
        colour = (kind.colour + own.normal(0, 60, 3)).tolist()
        if own.random() < 0.4:
            cv2.fillPoly(surface, points, colour, cv2.LINE_AA, 4)
        else:
            cv2.polylines(surface, points, True, colour, int(own.integers(1, 3)), cv2.LINE_AA, 4)
    if kind.bevel:
        depth = cv2.distanceTransform((cover > 0.5).astype(np.uint8), cv2.DIST_L2, 3)
        height = cv2.GaussianBlur(np.minimum(depth, np.float32(0.25 * radius + 1)), (0, 0), 0.8)
        slope = light[0] * cv2.Sobel(height, cv2.CV_32F, 1, 0, scale=0.25)
        slope += light[1] * cv2.Sobel(height, cv2.CV_32F, 0, 1, scale=0.25)
        surface += (2 * kind.bevel * slope)[..., None]
    surface += (rng.normal(0, 10) * along + rng.normal(0, 12) * (light[0] * x + light[1] * y))[
        ..., None
    ]
    if kind.shine:
        for _ in range(int(rng.integers(1, 3))):
            middle = -light * rng.uniform(0, 0.5) + rng.normal(0, 0.15, 2)
            wide = rng.uniform(0.04, 0.3)
            flat = rng.uniform(0.5, 1.5)
            away = (x - middle[0]) ** 2 + (flat * (y - middle[1])) ** 2
            surface += (kind.shine * np.exp(-away / (2 * wide**2)))[..., None]
    return np.clip(surface, 0, 255)


# Camera


def _photograph(rng: Rng, image: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return what a camera makes of it (n, n, 3) uint8: uneven light, blur, contrast, noise, JPEG,
    mosaic."""
    size = len(image)
    y, x = np.mgrid[:size, :size] / size - 0.5
    shade = 1 + 2 * rng.uniform(0, 0.35) * (light[0] * x + light[1] * y)
    if rng.random() < 0.3:
        shade -= 2 * rng.uniform(0, 0.6) * (x**2 + y**2)
    image = image * shade[..., None]
    if rng.random() < 0.1:  # a lamp is mirrored in the plate
        middle, wide = rng.uniform(-0.5, 0.5, 2), rng.uniform(0.05, 0.3)
        away = (x - middle[0]) ** 2 + (y - middle[1]) ** 2
        image = image + (rng.uniform(20, 120) * np.exp(-away / (2 * wide**2)))[..., None]
    if rng.random() < 0.2:
        image = image * rng.uniform(0.75, 1.25, 3)  # light has a colour
    blur = rng.gamma(1.2, 0.55)
    if blur > 0.25:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    image = np.clip(image, 0, 255) / 255
    image = (255 * image ** np.exp(rng.normal(0, 0.25)) - 127) * rng.uniform(0.6, 1.2) + 127
    image = image + rng.normal(0, rng.gamma(1, 2.5), image.shape)
    if rng.random() < 0.2:
        image = image.mean(axis=2, keepdims=True).repeat(3, axis=2)
    photo = np.clip(image, 0, 255).astype(np.uint8)
    if rng.random() < 0.4:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 96))]
        photo = cv2.imdecode(cv2.imencode(".jpg", photo, quality)[1], cv2.IMREAD_COLOR)
    if rng.random() < 0.2:
        mosaic = photo[..., 1].copy()
        mosaic[::2, ::2], mosaic[1::2, 1::2] = photo[::2, ::2, 2], photo[1::2, 1::2, 0]
        photo = cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2BGR)
    return np.asarray(photo)
