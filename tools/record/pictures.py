"""The run in pictures: a strip like Figure 15 of the paper, and an animation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from PIL import Image, ImageDraw, ImageFont

from plate_core import Rig, part_class
from plate_core.rig import homography
from plate_core.tasks import AssembleTask, Bin, FollowTask, Scenario, Side, SortTask, circle_points
from plate_solver import average_force

from .film import Film

FACE = {"black": "#1a1a1a", "grey": "#a8a8a8"}
TRAIL = {"black": "#d1495b", "grey": "#2e86ab"}
FIELD, GOAL = "#8fa3ad", "#e9f0e4"

SAME = 12
"""Pixels that differ no more from the picture without parts show the plate [grey values]."""

BRIGHT = 85
"""Percentile of a pixel's values that shows the plate: parts are darker, and may lie there long."""

SNAPSHOTS = 8
COLUMNS = 2
ARROWS = (17, 9)
"""Arrows of the force field along x and y."""

FULL_LENGTH = 80
"""Arrows beyond this percentile of the forces are drawn equally long, so that weak ones show."""

GIF_FRAMES = 100
GIF_RATE = 12.5
"""Frames a second; GIF counts in hundredths of a second."""

PX_PER_M = 1150.0
"""Of the animation."""

SHIFT = 4
"""Lines are drawn in 1/16 px, so that they do not jitter."""

MARK = (0.5, 0.35)
"""Where on a part its mark is drawn, and how large [radii]."""


@dataclass(frozen=True)
class Scene:
    """What is the same in all pictures of a run."""

    rig: Rig
    scenario: Scenario
    film: Film

    @property
    def classes(self) -> list[str]:
        """Class of every part."""
        return [part_class(name) for name in self.film.ids]

    def until(self, t: float) -> np.ndarray:
        """Positions (n, M, 2) [m] from the task's beginning until t [s]."""
        shown = (self.film.time >= -1e-6) & (self.film.time <= t + 1e-6)
        return self.film.position[shown]

    def paths(self) -> list[np.ndarray]:
        """Polygons (n, 2) [m] that parts are to follow; closed ones end where they begin."""
        task = self.scenario.task
        if not isinstance(task, FollowTask):
            return []
        return [
            np.array([*path.waypoint, *(path.waypoint[:1] if path.closed else ())])
            for path in task.paths
        ]

    def goals(self) -> list[np.ndarray]:
        """Polygons (n, 2) [m] where parts belong."""
        task = self.scenario.task
        if isinstance(task, AssembleTask):
            radius = self.rig.parts.radius_m
            return [circle_points(place, radius, 0.0, True) for place in task.place]
        if not isinstance(task, SortTask):
            return []
        return [
            np.array(region.corner) if isinstance(region, Bin) else self._side(region, task)
            for region in dict.fromkeys(task.regions.values())
        ]

    def _side(self, side: Side, task: SortTask) -> np.ndarray:
        """Corners (4, 2) [m] of the part of the plate beyond the goal line, or lines."""
        half = self.rig.plate.half
        ranges = [
            (-h, h) if sign == 0 else tuple(sorted((sign * task.goal_fraction * h, sign * h)))
            for sign, h in zip((side.x, side.y), half, strict=True)
        ]
        (left, right), (bottom, top) = ranges
        return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])


def draw_strip(scene: Scene, path: Path, title: str) -> None:
    """Draw snapshots, left to right and top to bottom: parts, their trails, the force field."""
    rows = SNAPSHOTS // COLUMNS
    figure = Figure(figsize=(11, 0.6 + rows * 2.85), layout="constrained", facecolor="white")
    grid = figure.subplots(rows, COLUMNS)
    for t, axes in zip(np.linspace(0, scene.film.end, SNAPSHOTS), grid.flat, strict=True):
        draw_snapshot(scene, axes, float(t))
    figure.suptitle(title, fontsize=12)
    figure.savefig(path, dpi=110)


def draw_snapshot(scene: Scene, axes: Axes, t: float) -> None:
    """Draw the plate at one instant [s]."""
    half = scene.rig.plate.half
    left, bottom = -half
    size = scene.rig.plate.length_m, scene.rig.plate.width_m
    for goal in scene.goals():
        axes.add_patch(Polygon(goal, color=GOAL, lw=0, zorder=0))
    axes.add_patch(Rectangle((left, bottom), *size, fill=False, ec="#333333", lw=1, zorder=5))
    for polygon in scene.paths():
        axes.plot(*polygon.T, color="#777777", lw=0.8, ls=(0, (4, 3)), zorder=1)
    draw_field(scene, axes, t)
    position = scene.until(t)
    for part, label in enumerate(scene.classes):
        axes.plot(*position[:, part].T, color=TRAIL.get(label, "#555555"), lw=1.3, zorder=3)
        if len(position) and np.all(np.isfinite(position[-1, part])):
            axes.add_patch(
                Circle(
                    tuple(position[-1, part]),
                    scene.rig.parts.radius_m,
                    fc=FACE.get(label, "#555555"),
                    ec="#1a1a1a",
                    lw=0.8,
                    zorder=4,
                )
            )
    if scene.scenario.marked and len(position):
        angle, radius = scene.film.angle[scene.film.time <= t + 1e-6][-1], scene.rig.parts.radius_m
        there = position[-1] + MARK[0] * radius * np.column_stack([np.cos(angle), np.sin(angle)])
        for point in there[np.all(np.isfinite(there), axis=1)]:
            spot = Circle(tuple(point), MARK[1] * radius, color="#ffffff", lw=0, zorder=4.5)
            axes.add_patch(spot)
    axes.set_xlim(-half[0] - 0.004, half[0] + 0.004)
    axes.set_ylim(-half[1] - 0.004, half[1] + 0.004)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(f"{t:.1f} s", fontsize=10, loc="left", pad=2)


def draw_field(scene: Scene, axes: Axes, t: float) -> None:
    """Draw the mean friction force of the cycle that runs at t, where a part would feel it."""
    cycle = scene.film.running(min(t, scene.film.end - 1e-3) if t > 0 else first_motion(scene))
    if cycle is None:
        return
    half = scene.rig.plate.half
    x, y = (np.linspace(-h + h / n, h - h / n, n) for h, n in zip(half, ARROWS, strict=True))
    point = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    force = average_force(cycle, point)
    if not np.any(force):
        return
    usual = float(np.percentile(np.hypot(*force.T), FULL_LENGTH))
    arrow = force * np.minimum(1 / usual, 1 / np.maximum(np.hypot(*force.T), 1e-9))[:, None]
    arrow *= 0.85 * (x[1] - x[0])
    axes.quiver(
        *point.T, *arrow.T, color=FIELD, angles="xy", scale_units="xy", scale=1, pivot="middle",
        width=0.0022, headwidth=4, headlength=4.5, headaxislength=4, zorder=2,
    )  # fmt: skip


def first_motion(scene: Scene) -> float:
    """Return a time within the first cycle that moves the plate [s]."""
    film = scene.film
    for stamp, table in zip(film.table_time, film.tables, strict=True):
        if stamp >= -1e-6 and np.any(table.knot_twist):
            later = film.time[film.time > stamp + 1e-6]
            return float(later[0]) + 1e-6 if len(later) else 0.0
    return 0.0


def draw_animation(scene: Scene, path: Path, title: str) -> float:
    """Draw what the camera saw, with trails, as a GIF; returns how much faster than life it is."""
    film = scene.film
    shown = np.flatnonzero((film.image_time >= -1e-6) & (film.image_time <= film.end + 1e-6))
    if not len(shown):
        return 1.0
    chosen = shown[np.unique(np.linspace(0, len(shown) - 1, GIF_FRAMES).round().astype(int))]
    seconds = len(chosen) / GIF_RATE
    speed = max(1.0, film.end / seconds)
    bare, views, parts = from_above(film, scene.rig, PX_PER_M)
    frames = []
    for k in chosen:
        picture = with_trails(scene, cv2.cvtColor(bare, cv2.COLOR_GRAY2RGB), film.image_time[k])
        picture[parts[k]] = views[k][parts[k], None]  # parts lie on top of their trails
        frames.append(page(picture, title, f"{film.image_time[k]:.1f} s", f"{speed:.1f} x"))
    palette = frames[-1].quantize(64, dither=Image.Dither.NONE)
    pages = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in frames]
    duration = [round(1000 / GIF_RATE)] * (len(pages) - 1) + [2500]
    pages[0].save(
        path, save_all=True, append_images=pages[1:], duration=duration, loop=0, optimize=False
    )
    return speed


def with_trails(scene: Scene, picture: np.ndarray, t: float) -> np.ndarray:
    """Draw the task, and where parts have been until t [s], into a picture (H, W, 3)."""
    half = scene.rig.plate.half

    def pixels(point: np.ndarray) -> np.ndarray:
        place = (point - [-half[0], half[1]]) * [PX_PER_M, -PX_PER_M]
        return np.round(place * 2**SHIFT).astype(np.int32).reshape(-1, 1, 2)

    lines = scene.paths()
    lines += [np.vstack([goal, goal[:1]]) for goal in scene.goals()]
    for line in lines:
        cv2.polylines(picture, [pixels(line)], False, (165, 165, 165), 1, cv2.LINE_AA, SHIFT)
    position = scene.until(t)
    for part, label in enumerate(scene.classes):
        track = position[:, part]
        track = track[np.all(np.isfinite(track), axis=1)]
        colour = tuple(int(TRAIL.get(label, "#555555")[i : i + 2], 16) for i in (1, 3, 5))
        if len(track) > 1:
            cv2.polylines(picture, [pixels(track)], False, colour, 2, cv2.LINE_AA, SHIFT)
    return picture


def page(picture: np.ndarray, title: str, clock: str, speed: str) -> Image.Image:
    """Return a picture with a white margin and a line above it."""
    height, width = picture.shape[:2]
    sheet = Image.new("RGB", (width + 20, height + 44), "white")
    sheet.paste(Image.fromarray(picture), (10, 34))
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(16)
    pen.text((12, 9), title, fill="black", font=font)
    pen.text((width // 2 + 40, 9), clock, fill="black", font=font, anchor="ra")
    pen.text((width + 8, 9), f"{speed} real time", fill="black", font=font, anchor="ra")
    return sheet


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
