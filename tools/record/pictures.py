"""Pictures of a run: a strip of snapshots like Figure 15 of the paper, and an animation over the
camera images.

A picture is a sheet of frames with a title and a legend. A frame shows the plate at one time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from plate_core import PlateCycle, Rig, part_class
from plate_core.colours import FORCE, INK, Colour, class_colour, lab_to_srgb, part_colour
from plate_core.rig import PartType, to_home
from plate_core.tasks import (
    AssembleTask,
    FeedTask,
    FollowTask,
    PoseTask,
    Scenario,
    Side,
    SortTask,
    circle_points,
    pick_window,
    region_outline,
)  # fmt: skip
from plate_solver import average_force
from plate_vision import calibrate_by_rig

from .canvas import Canvas, Sample, heading, key
from .film import Film

SNAPSHOTS = 8

ARROWS = 153
"""Approximate number of arrows of a strip's force field."""

FIELD_ARROW, PART_ARROW = 0.85, 6.0
"""Length of the longest arrows. `FIELD_ARROW`: in a force field [distances between arrows].
`PART_ARROW`: on parts [part radii]."""

FULL_FORCE = 80
"""Percentile of the forces above which all arrows have the same length, so that weak forces are
visible."""

TINT = 0.14
"""Opacity of targets."""

FILM_FRAMES, FILM_RATE = 100, 12.5
"""Maximum number of frames of an animation, and number of frames per second. GIF has a time
resolution of 0.01 s."""

LAST_MS = 2500
"""Time for which the last frame is shown [ms]."""

SAME = 12
"""Maximum difference between a pixel of the plate and the picture without parts [grey values]."""

BRIGHT = 85
"""Percentile of a pixel's values over time. This percentile is the brightness of the plate without
parts. The percentile is high because parts are darker than the plate, and can cover a pixel for a
long time."""

TRAIL_S = 2.0
"""Duration of the motion that the trails of parts show, in tasks in which parts are added and
removed [s]. In other tasks, trails begin at the start of the task."""

SAMPLE_REACH = 2.5
"""Maximum reach of a part in the legend [part radii]."""

NOW = 1e-6
"""Tolerance for rounding of times [s]."""

TRUE_RAY, REQUESTED_RAY, BESIDE = 2.8, 5.5, 4.5
"""`TRUE_RAY`: length of the line that shows a part's angle [part radii]. `REQUESTED_RAY`: length of
the line that shows its target angle. `BESIDE`: distance of the angle's text from the part's
centre."""


@dataclass(frozen=True)
class Scene:
    """Data that all pictures of a run share."""

    rig: Rig
    scenario: Scenario
    film: Film

    @cached_property
    def labels(self) -> list[str]:
        """Class of each part."""
        return [part_class(name) for name in self.film.ids]

    @property
    def feeds(self) -> bool:
        """Whether parts are added to and removed from the plate during the task."""
        return isinstance(self.scenario.task, FeedTask)

    @property
    def chute(self) -> Side | None:
        """Edge over which unwanted parts leave the plate. None if the task is not `feed`."""
        return self.scenario.task.chute if isinstance(self.scenario.task, FeedTask) else None

    @cached_property
    def targets(self) -> list[tuple[str, np.ndarray]]:
        """Class and polygon (n, 2) [m] of each target."""
        task, rig = self.scenario.task, self.rig
        if isinstance(task, SortTask):
            return [(label, region_outline(task, label, rig.plate.half)) for label in task.regions]
        if isinstance(task, FeedTask):
            windows = [(pick.label, *pick_window(pick, rig)) for pick in task.picks]
            return [
                (label, np.array([a, (b[0], a[1]), b, (a[0], b[1])])) for label, a, b in windows
            ]
        if isinstance(task, AssembleTask):
            places = zip(task.labels, task.place, strict=True)
            return [(label, self._circle(position)) for label, position in places]
        return [
            (label, self._circle(position))
            if rig.part_type(label).radius_m
            else (label, to_home(np.array([*position, angle]), rig.part_type(label).polygon))
            for label, position, angle in self.poses
        ]

    def _circle(self, centre: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the points of a circle slightly larger than a part."""
        x, y = centre
        return circle_points((x, y), 1.25 * self.rig.parts.radius_m, 0.0, True)

    @cached_property
    def paths(self) -> list[tuple[str, np.ndarray]]:
        """Class and points (n, 2) [m] of each path. A closed path ends at its first point."""
        task = self.scenario.task
        return [
            (path.label, np.array([*path.waypoint, *(path.waypoint[:1] if path.closed else ())]))
            for path in (task.paths if isinstance(task, FollowTask) else ())
        ]

    @cached_property
    def poses(self) -> list[tuple[str, np.ndarray, float]]:
        """Class, position [m] and angle [rad] of each target pose. Empty if only the angles are
        targets."""
        task = self.scenario.task
        free, found = list(range(len(self.labels))), []
        for pose in task.poses if isinstance(task, PoseTask) and not task.anywhere else ():
            position = np.array(pose.place or (0.0, 0.0))
            if pose.place is None:
                part = next(k for k in free if self.labels[k] == pose.label)
                free.remove(part)
                position = self.until(0.0)[-1, part]
            found.append((pose.label, position, pose.angle))
        return found

    def until(self, t: float) -> np.ndarray:
        """Return the positions (n, M, 2) [m] from the start of the trails until t [s]. The result
        contains at least one position per part."""
        first = int(np.searchsorted(self.film.time, -NOW))
        if self.feeds:
            first = max(first, int(np.searchsorted(self.film.time, t - TRAIL_S)))
        last = int(np.searchsorted(self.film.time, t + NOW, side="right"))
        return self.film.position[min(first, len(self.film.time) - 1) :][: max(1, last - first)]

    def clock(self, t: float) -> str:
        """Return a text with the time and the number of the cycle."""
        done = int(np.sum((self.film.starts > NOW) & (self.film.starts <= t + NOW)))
        return f"{t:.1f} s, cycle {min(done, self.film.cycles)} of {self.film.cycles}"

    def motion(self, t: float) -> PlateCycle | None:
        """Return the plate's motion at t [s]. At the start, return the first motion of the task.
        None if there is no motion."""
        film = self.film
        if t <= 0:
            stamps = zip(film.table_time, film.tables, strict=True)
            first = next((s for s, table in stamps if s >= -NOW and np.any(table.knot_twist)), 0.0)
            later = film.starts[film.starts > first + NOW]
            t = float(later[0]) + NOW if len(later) else 0.0
        return film.running(min(t, film.end - 1e-3))

    def forces(self, t: float, point: np.ndarray) -> np.ndarray:
        """Return the mean friction forces (n, 2) [mu m g] on parts at points (n, 2) [m], for the
        cycle that runs at t [s]."""
        cycle = self.motion(t)
        return np.zeros_like(point) if cycle is None else average_force(cycle, point)


@dataclass(frozen=True)
class Layout:
    """Size of a picture: number of columns of frames, maximum width and height of a frame [px],
    size of the text [px]."""

    columns: int
    frame: tuple[int, int]
    text_px: int

    GAP = 14
    """Gap between frames [px]."""

    THIN = 1 / 560
    """Width of thin lines [frame widths]."""

    def canvas(self, scene: Scene, pixels: np.ndarray | None = None) -> Canvas:
        """Return a canvas for a frame, white or with these pixels. The margin of the canvas also
        shows parts on the plate's edge."""
        half = scene.rig.plate.half + 1.5 * scene.rig.parts.radius_m
        scale = float(np.min(np.array(self.frame) / (2 * half)))
        wide, high = self.frame[0], round(2 * half[1] * scale)
        if pixels is None:
            pixels = np.full((high, wide, 3), 255, np.uint8)
        return Canvas(pixels.copy(), scale, (wide / 2, high / 2), wide * self.THIN, self.text_px)

    def sheet(
        self, frames: list[np.ndarray], clocks: list[str], title: str, right: str, key: np.ndarray
    ) -> Image.Image:
        """Return a picture that consists of the title, the frames in rows with their times, and the
        legend."""
        gap = np.full((frames[0].shape[0] + round(1.6 * self.text_px), self.GAP, 3), 255, np.uint8)
        tiles = [
            np.vstack([heading(self.frame[0], self.text_px, clock), frame])
            for clock, frame in zip(clocks, frames, strict=True)
        ]
        rows = [
            np.hstack([piece for frame in tiles[k : k + self.columns] for piece in (gap, frame)])
            for k in range(0, len(tiles), self.columns)
        ]
        top = heading(self.width, self.text_px, title, right)
        page = np.vstack([top, *(row[:, self.GAP :] for row in rows), key])
        return Image.fromarray(np.pad(page, ((0, 0), (8, 8), (0, 0)), constant_values=255))

    @property
    def width(self) -> int:
        """Width of a row of frames [px]."""
        return self.columns * (self.frame[0] + self.GAP) - self.GAP

    def key(self, scene: Scene, arrows: Arrows) -> np.ndarray:
        """Return the legend of the frames."""
        canvas = self.canvas(scene)
        return key(samples(scene, arrows, canvas), self.width, canvas)


STRIP = Layout(2, (680, 420), 25)
FILM = Layout(1, (700, 460), 19)
"""Layouts of the strip and of the film. The text of a strip is large because pages show it at half
its size or less."""


@dataclass(frozen=True)
class Arrows:
    """Scale of force arrows. Forces of `force` [mu m g] or more have arrows of `length` [m]."""

    force: float
    length: float

    @classmethod
    def of(cls, forces: np.ndarray, length: float) -> Arrows:
        """Choose the scale from all forces (..., 2) of a picture."""
        size = np.hypot(*forces.reshape(-1, 2).T)
        size = size[size > 0]
        return cls(round_number(np.percentile(size, FULL_FORCE)) if len(size) else 1.0, length)

    def draw(
        self, canvas: Canvas, point: np.ndarray, force: np.ndarray, width: float, pivot: float
    ) -> None:
        """Draw arrows for forces (n, 2) at points (n, 2) [m]. `pivot` is the fraction of an arrow's
        length that is before the given point."""
        size = np.maximum(np.hypot(*force.T), self.force)
        arrows = self.length * force / size[:, None]
        for start, arrow in zip(point - pivot * arrows, arrows, strict=True):
            canvas.arrow(start, start + arrow, FORCE, width)


def draw_strip(scene: Scene, path: Path, title: str) -> None:
    """Draw snapshots in rows, with the parts, their trails and the force field. Save the picture as
    an image."""
    times, half = np.linspace(0, scene.film.end, SNAPSHOTS), scene.rig.plate.half
    counts = np.maximum(1, np.round(half * np.sqrt(ARROWS / np.prod(half))).astype(int))
    x, y = (np.linspace(-h + h / n, h - h / n, n) for h, n in zip(half, counts, strict=True))
    point = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    forces = np.array([scene.forces(t, point) for t in times])
    arrows = Arrows.of(forces, FIELD_ARROW * 2 * float(half[0] / counts[0]))
    frames = []
    for t, force in zip(times, forces, strict=True):
        canvas = STRIP.canvas(scene)
        draw_task(scene, canvas)
        arrows.draw(canvas, point, force, 0.8, 0.5)
        draw_trails(scene, canvas, t)
        draw_parts(scene, canvas, t, faces=True)
        frames.append(canvas.pixels)
    clocks = [scene.clock(t) for t in times]
    STRIP.sheet(frames, clocks, title, "", STRIP.key(scene, arrows)).save(path)


def draw_film(scene: Scene, path: Path, title: str) -> float:
    """Draw the camera images with trails and forces, and save them as a GIF. Return the ratio of
    the animation's speed to real time."""
    film = scene.film
    shown = np.flatnonzero((film.image_time >= -NOW) & (film.image_time <= film.end + NOW))
    if not len(shown):
        return 1.0
    count = min(FILM_FRAMES, math.ceil(FILM_RATE * film.end) + 1)  # no slow motion
    chosen = shown[np.unique(np.linspace(0, len(shown) - 1, count).round().astype(int))]
    speed = max(1.0, film.end / (len(chosen) / FILM_RATE))
    bare, views, seen = rectify_images(scene, FILM.canvas(scene), [film.images[k] for k in chosen])
    times = film.image_time[chosen]
    places = [scene.until(t)[-1] for t in times]
    forces = [
        scene.forces(t, np.nan_to_num(positions))
        for t, positions in zip(times, places, strict=True)
    ]
    arrows = Arrows.of(np.array(forces), PART_ARROW * scene.rig.parts.radius_m)
    key, pages = FILM.key(scene, arrows), []
    for t, positions, force, view, part in zip(times, places, forces, views, seen, strict=True):
        canvas = FILM.canvas(scene, bare)
        draw_task(scene, canvas)
        draw_trails(scene, canvas, t)
        canvas.pixels[part] = view[part]  # draw the parts on top of their trails
        draw_parts(scene, canvas, t, faces=False)
        visible = np.all(np.isfinite(positions), axis=1)
        arrows.draw(canvas, positions[visible], force[visible], 1.6, 0.0)
        life = f"{speed:.1f} x real time"
        pages.append(FILM.sheet([canvas.pixels], [scene.clock(t)], title, life, key))
    palette = pages[-1].quantize(96, dither=Image.Dither.NONE)
    pages = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in pages]
    duration = [round(1000 / FILM_RATE)] * (len(pages) - 1) + [LAST_MS]
    pages[0].save(
        path, save_all=True, append_images=pages[1:], duration=duration, loop=0, optimize=False
    )
    return speed


def draw_task(scene: Scene, canvas: Canvas) -> None:
    """Draw the plate, targets and paths."""
    x, y = scene.rig.plate.half
    for label, corner in scene.targets:
        canvas.area(corner, class_colour(label), TINT)
    canvas.line([(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)], INK, 1.2)
    if scene.chute is not None:
        out = np.array([scene.chute.x, scene.chute.y])
        side = np.where(out != 0, out, [[-1], [1]]) * (x, y)
        canvas.line(side, FORCE, 6)
    for label, line in scene.paths:
        canvas.line(line, class_colour(label), 1.2, dashed=True)


def draw_trails(scene: Scene, canvas: Canvas, t: float) -> None:
    """Draw the trails of the parts until t [s]."""
    position = scene.until(t)
    for part, label in enumerate(scene.labels):
        track = position[:, part]
        canvas.line(track[np.all(np.isfinite(track), axis=1)], class_colour(label), 2)


def draw_parts(scene: Scene, canvas: Canvas, t: float, faces: bool) -> None:
    """Draw the parts at t [s] with their angles and target angles, and crosses at the last
    positions of parts that have left the plate or are not detected. Without `faces`, draw only the
    parts' edges."""
    position = scene.until(t)
    now = max(0, int(np.searchsorted(scene.film.time, t + NOW, side="right")) - 1)
    for label, place, angle in scene.poses:
        reach = scene.rig.part_type(label).reach_m
        draw_angle(canvas, place, angle, reach, class_colour(label), dashed=True)
    for part, label in enumerate(scene.labels):
        seen_at = np.flatnonzero(np.all(np.isfinite(position[:, part]), axis=1))
        if not len(seen_at):
            continue
        centre = position[seen_at[-1], part]
        if seen_at[-1] + 1 < len(position):
            canvas.cross(centre, scene.rig.part_type(label).reach_m, class_colour(label))
            continue
        angle = float(scene.film.angle[now, part])
        draw_part(scene, canvas, label, np.append(centre, angle), faces)
        if scene.scenario.marked:
            draw_angle(canvas, centre, angle, scene.rig.parts.radius_m, INK, dashed=False)


def draw_part(scene: Scene, canvas: Canvas, label: str, pose: np.ndarray, face: bool) -> None:
    """Draw a part of a class at a pose (3,) [m, m, rad]. Without `face`, draw only its edges."""
    part, edge = scene.rig.part_type(label), class_colour(label)
    filled = face_colour(part) if face else None
    if part.radius_m and not part.holes:
        canvas.disc(pose[:2], part.radius_m, filled, edge)
        return
    holes = [to_home(pose, np.array(hole)) for hole in part.holes]
    canvas.outline(to_home(pose, part.polygon), holes, filled, edge)


def face_colour(part: PartType) -> Colour:
    """Return the face colour of a part type."""
    if part.colour_lab is None:
        return part_colour(part.name)
    red, green, blue = lab_to_srgb(np.array(part.colour_lab)).round().astype(int).tolist()
    return red, green, blue


def draw_angle(
    canvas: Canvas, centre: np.ndarray, angle: float, radius: float, colour: Colour, dashed: bool
) -> None:
    """Draw a line for the angle of a part. If `dashed` is False, the line shows the angle, and its
    value is beside the part. If `dashed` is True, the line shows the target angle, and its value is
    at the end of the line."""
    along, ray = np.array([np.cos(angle), np.sin(angle)]), REQUESTED_RAY if dashed else TRUE_RAY
    canvas.line(centre + radius * np.outer([1.0, ray], along), colour, 2, dashed)
    side = [-BESIDE if along[0] > 0.1 else BESIDE, 0.0]
    text_place = centre + radius * (np.array(side) if not dashed else (ray + 1.5) * along)
    canvas.write(text_place, f"{(np.degrees(angle) + 180) % 360 - 180:.0f}°")


def samples(scene: Scene, arrows: Arrows, frame: Canvas) -> list[Sample]:
    """Return the entries of the legend for the frames of this run."""
    radius = min(scene.rig.parts.radius_m, 0.5 * frame.text_px / frame.scale)
    bar = round_number(scene.rig.plate.length_m / 6)
    ray, end = REQUESTED_RAY * radius, np.array([radius, 0.0])
    force = np.array([[arrows.force, 0.0]])
    found = [class_sample(scene, label, radius) for label in dict.fromkeys(scene.labels)]
    found.append(
        Sample(
            arrows.length,
            lambda c: arrows.draw(c, np.zeros((1, 2)), force, 1.2, 0.0),
            f"mean force; longest arrows: {arrows.force:g} mu mg or more (a part's friction)",
        )
    )
    if scene.scenario.marked:
        text = "angle of a part" + "; dashed: target" * bool(scene.poses)
        found.append(Sample(ray, lambda c: c.line([(0, 0), (ray, 0)], INK, 2), text))
    if scene.chute is not None:
        found.append(Sample(2 * radius, lambda c: c.line([(0, 0), 2 * end], FORCE, 6), "chute"))
    if scene.feeds:
        text = "just taken, or fallen over the edge"
        found.append(Sample(2 * radius, lambda c: c.cross(end, radius, INK), text))
    elif np.any(np.isnan(scene.film.position[-1:])):
        text = "fell off here" if scene.film.simulated else "last detected here"
        found.append(Sample(2 * radius, lambda c: c.cross(end, radius, INK), text))
    mark = radius / 2
    ruler = [(0, mark), (0, -mark), (0, 0), (bar, 0), (bar, mark), (bar, -mark)]
    found.append(Sample(bar, lambda c: c.line(ruler, INK, 1.5), f"{1e3 * bar:g} mm"))
    return found


def class_sample(scene: Scene, label: str, radius: float) -> Sample:
    """Return the legend's entry for a class: its target or path, a trail, and a part with the given
    radius [m]."""
    colour = class_colour(label)
    wide, labels = 6 * radius, [f"{label}: part, trail"]
    target = label in [name for name, _ in scene.targets]
    path = label in [name for name, _ in scene.paths]
    labels += ["target"] * target + ["path"] * path

    def draw(canvas: Canvas) -> None:
        high = 1.6 * radius
        if target:
            corners = [[0, -high], [wide, -high], [wide, high], [0, high]]
            canvas.area(np.array(corners), colour, TINT)
        if path:
            canvas.line([(0, -high / 2), (wide, -high / 2)], colour, 1.2, dashed=True)
        canvas.line([(0.5 * radius, 0), (4.5 * radius, 0)], colour, 2)
        # a long part is drawn smaller, so that it stays in its line
        shrink = min(1.0, SAMPLE_REACH * radius / scene.rig.part_type(label).reach_m)
        small = replace(canvas, scale=shrink * canvas.scale)
        draw_part(scene, small, label, np.array([4.5 * radius / shrink, 0, 0]), face=True)

    return Sample(wide, draw, ", ".join(labels))


def rectify_images(
    scene: Scene, canvas: Canvas, images: Sequence[np.ndarray]
) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Rectify images to a view from above, in the scale of the canvas.

    Returns
    -------
    bare : (H, W, 3)
        The plate without parts: the percentile `BRIGHT` of each pixel over time.
    views : list of (H, W, 1) or (H, W, 3)
        Rectified images.
    parts : list of (H, W)
        True at pixels that show a part, because they differ from `bare` by more than `SAME`.
    """
    rows, columns = np.indices(canvas.pixels.shape[:2])
    point = np.stack([columns - canvas.origin[0], canvas.origin[1] - rows], axis=-1) / canvas.scale
    pixel = calibrate_by_rig(scene.rig).to_image(point.reshape(-1, 2)).reshape(point.shape)
    x, y = np.moveaxis(pixel.astype(np.float32), -1, 0)
    views = [
        cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for image in images
    ]
    if views[0].ndim == 2:
        views = [view[..., None] for view in views]
    # convert the colour order from blue, green, red to red, green, blue
    views = [view[..., ::-1] for view in views]
    bare = np.percentile(views[:: max(1, len(views) // 31)], BRIGHT, axis=0).astype(np.uint8)
    # lamps can flicker, so compare at equal brightness
    levels = [float(np.median(bare) / max(np.median(view), 1)) for view in views]
    even = [cv2.convertScaleAbs(view, alpha=a) for view, a in zip(views, levels, strict=True)]
    parts = [np.any(cv2.absdiff(view, bare).reshape(bare.shape) > SAME, axis=2) for view in even]
    return np.ascontiguousarray(np.broadcast_to(bare, (*bare.shape[:2], 3))), views, parts


def round_number(value: float) -> float:
    """Return the largest number of the form 1, 2 or 5 times a power of ten that does not exceed a
    value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + NOW)))
