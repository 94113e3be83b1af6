"""Outlines of small parts of all kinds, drawn at random: rings of points, in radii of the part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

Rng = np.random.Generator
Ring = np.ndarray
"""(n, 2): a closed line, in radii."""

ROUND = 72
"""Points of a circle."""


@dataclass(frozen=True)
class Outline:
    """Solid rings, whose union the part is, and holes in it."""

    solid: list[Ring]
    holes: list[Ring] = field(default_factory=list)


def circle(radius: float, x: float = 0.0, y: float = 0.0, squeezed: float = 1.0) -> Ring:
    """Return an ellipse, whose second half axis is `squeezed` radii."""
    t = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    return np.stack([x + radius * np.cos(t), y + radius * squeezed * np.sin(t)], axis=1)


def box(width: float, height: float, x: float = 0.0, y: float = 0.0) -> Ring:
    """Return a rectangle by its half sides and its middle."""
    return np.array([[-width, -height], [width, -height], [width, height], [-width, height]]) + (
        x, y
    )  # fmt: skip


def polygon(corners: int, radius: float) -> Ring:
    """Return a regular polygon."""
    t = 2 * np.pi * np.arange(corners) / corners
    return radius * np.stack([np.cos(t), np.sin(t)], axis=1)


def polar(radius: np.ndarray) -> Ring:
    """Return the ring whose radius over equal steps of angle is given (n,)."""
    t = np.linspace(0, 2 * np.pi, len(radius), endpoint=False)
    return radius[:, None] * np.stack([np.cos(t), np.sin(t)], axis=1)


def _disc(rng: Rng) -> Outline:
    return Outline([circle(1.0)])


def _ellipse(rng: Rng) -> Outline:
    return Outline([circle(1.0, squeezed=rng.uniform(0.35, 0.95))])


def _polygon(rng: Rng) -> Outline:
    return Outline([polygon(int(rng.choice([3, 4, 5, 6, 6, 8])), 1.05)])


def _nut(rng: Rng) -> Outline:
    return Outline([polygon(6, 1.05)], [circle(rng.uniform(0.35, 0.65))])


def _washer(rng: Rng) -> Outline:
    return Outline([circle(1.0)], [circle(rng.uniform(0.3, 0.85))])


def _screw(rng: Rng) -> Outline:
    shank, head = rng.uniform(0.12, 0.35), rng.uniform(1.3, 2.4)
    top = (
        box(0.2, shank * head, -0.85)
        if rng.random() < 0.5
        else circle(shank * head, -0.8, squeezed=1.0)
    )
    thread = box(1.0, shank, 0.3)
    if rng.random() < 0.5:
        x = np.linspace(-0.7, 1.3, 80)
        y = shank * (1 + 0.12 * np.sign(np.sin(x * rng.uniform(25, 60))))
        thread = np.vstack([np.stack([x, y], axis=1), np.stack([x, -y], axis=1)[::-1]])
    return Outline([thread, top])


def _bar(rng: Rng) -> Outline:
    return Outline([box(1.2, rng.uniform(0.12, 0.9))])


def _gear(rng: Rng) -> Outline:
    t = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    teeth = np.clip(2.5 * np.sin(int(rng.integers(8, 24)) * t), -1, 1)
    rim = polar(1 + rng.uniform(0.04, 0.14) * teeth)
    spokes = int(rng.integers(0, 7))
    size, out = rng.uniform(0.1, 0.22), rng.uniform(0.5, 0.65)
    turns = 2 * np.pi * np.arange(spokes) / max(spokes, 1)
    holes = [circle(size, out * np.cos(a), out * np.sin(a)) for a in turns]
    return Outline([rim], [circle(rng.uniform(0.1, 0.3)), *holes])


def _bracket(rng: Rng) -> Outline:
    wide = rng.uniform(0.22, 0.6)
    foot = box(1.0, wide / 2, 0.0, -1 + wide / 2)
    leg = box(wide / 2, 1.0, -1 + wide / 2)
    kind = int(rng.integers(4))
    if kind == 0:  # an L
        rings = [foot, leg]
    elif kind == 1:  # a U
        rings = [foot, leg, box(wide / 2, 1.0, 1 - wide / 2)]
    elif kind == 2:  # a T
        rings = [foot, box(wide / 2, 1.0)]
    else:  # a Z
        rings = [box(0.7, wide / 2, -0.3, -0.8), box(wide / 2, 0.9), box(0.7, wide / 2, 0.3, 0.8)]
    drilled = [circle(0.25 * wide, -1 + wide / 2, -1 + wide / 2)] if kind < 2 else []
    return Outline(rings, drilled if rng.random() < 0.4 else [])


def _pill(rng: Rng) -> Outline:
    half, radius = rng.uniform(0.1, 1.2), rng.uniform(0.3, 0.8)
    return Outline([circle(radius, -half), circle(radius, half), box(half, radius)])


def _blob(rng: Rng) -> Outline:
    t = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    waves = [rng.normal(0, 0.22 / j) * np.cos(j * t + rng.uniform(0, 6.3)) for j in range(1, 7)]
    return Outline([polar(np.maximum(1 + np.sum(waves, axis=0), 0.25))])


def _splinter(rng: Rng) -> Outline:
    corners = int(rng.integers(3, 9))
    t = np.sort(rng.uniform(0, 2 * np.pi, corners))
    return Outline([rng.uniform(0.5, 1.2, corners)[:, None] * np.stack([np.cos(t), np.sin(t)], 1)])


def _chip(rng: Rng) -> Outline:
    half = rng.uniform(0.4, 0.9), rng.uniform(0.3, 0.7)
    pin, rows = rng.uniform(0.04, 0.12), int(rng.integers(1, 6))
    pins = [
        box(0.22, pin, side * (half[0] + 0.18), y)
        for side in (-1, 1)
        for y in np.linspace(-0.75 * half[1], 0.75 * half[1], rows)
    ]
    return Outline([box(*half), *pins])


def _two_ends(rng: Rng) -> Outline:
    end, neck = rng.uniform(0.25, 0.5), rng.uniform(0.06, 0.3)
    return Outline([circle(end, -0.9), circle(end, 0.9), box(0.9, neck)])


def _wire(rng: Rng) -> Outline:
    body = box(rng.uniform(0.3, 0.6), rng.uniform(0.15, 0.35))
    x, thick = np.linspace(-1.5, 1.5, 40), rng.uniform(0.03, 0.08)
    bend = rng.uniform(0, 0.25) * np.sin(rng.uniform(0.5, 3) * x) * (np.abs(x) > 0.5)
    wire = np.vstack(
        [np.stack([x, bend + thick], axis=1), np.stack([x, bend - thick], axis=1)[::-1]]
    )
    return Outline([body, wire])


def _jigsaw(rng: Rng) -> Outline:
    t = np.linspace(np.pi, 0, 15)
    ring = []
    for quarter in range(4):
        size, way = rng.uniform(0.18, 0.3), rng.choice([-1, 0, 1])
        lobe = np.stack([size * np.cos(t), 0.8 + way * 1.3 * size * np.sin(t)], axis=1)
        side = np.vstack([[-0.8, 0.8], lobe if way else [0.0, 0.8]])
        turn = -0.5 * np.pi * quarter
        c, s = np.cos(turn), np.sin(turn)
        ring.append(side @ np.array([[c, s], [-s, c]]))
    return Outline([np.vstack(ring)])


def _plate_with_holes(rng: Rng) -> Outline:
    half = 1.0, rng.uniform(0.4, 1.0)
    size = rng.uniform(0.06, 0.2)
    places = [(sx * 0.7 * half[0], sy * 0.7 * half[1]) for sx in (-1, 1) for sy in (-1, 1)]
    return Outline([box(*half)], [circle(size * half[1], *place) for place in places])


FAMILIES: tuple[tuple[float, Callable[[Rng], Outline]], ...] = (
    (3, _disc), (2, _ellipse), (1.5, _polygon), (2, _nut), (2, _washer), (2, _screw), (1.5, _bar),
    (1.5, _gear), (1.5, _bracket), (2, _pill), (1.5, _blob), (1, _splinter), (1.5, _chip),
    (1, _two_ends), (1, _wire), (1, _plate_with_holes), (1, _jigsaw),
)  # fmt: skip
"""How often each family is drawn, relative to the others."""

SHARES = np.array([share for share, _ in FAMILIES]) / sum(share for share, _ in FAMILIES)


def draw_outline(rng: Rng) -> Outline:
    """Draw the outline of a kind of part."""
    return FAMILIES[int(rng.choice(len(FAMILIES), p=SHARES))][1](rng)
