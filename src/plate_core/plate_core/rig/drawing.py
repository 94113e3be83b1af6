"""Drawing of a rig, for visual checks of the rig file. Matplotlib draws the plate with motors,
markers and parts, and the plate's corners in the camera image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from .frames import part_radius_px, to_image
from .rig import Rig

__all__ = ["draw"]


def draw(rig: Rig, name: str, path: Path) -> None:
    """Draw the plate with motors, markers and parts, and the plate in the camera image.

    Raises
    ------
    ValueError
        If the file name does not end with a supported picture format.
    """
    figure = Figure(figsize=(13, 5.5), layout="constrained")
    above, image = figure.subplots(1, 2)
    figure.suptitle(f"{name}: Gamma = {rig.gamma:.1f}, limited by {rig.reach.limit}")
    _draw_plate(above, rig)
    _draw_image(image, rig)
    # write the text of the drawing as SVG text, not as curves
    with rc_context({"svg.fonttype": "none"}):
        figure.savefig(path, dpi=110)


def _draw_plate(axes: Axes, rig: Rig) -> None:
    half, size = rig.plate.half, 2 * float(np.max(rig.plate.half))
    axes.set_title("plate from above, x to the right, with parts of true size")
    axes.add_patch(Polygon(rig.plate.corners, facecolor="#eeeeee", edgecolor="black"))
    for motor in rig.motors:
        point, direction = np.array(motor.point), np.array(motor.direction)
        # Draw the motor's arrow outside the plate, away from the centre.
        out = direction if direction @ point > 0 else -direction
        (x, y), (end_x, end_y) = point, point + 0.14 * size * out
        style = "<|-" if direction @ out < 0 else "-|>"
        arrow = {"arrowstyle": style, "color": "#b2182b", "lw": 2}
        axes.annotate("", (end_x, end_y), (x, y), arrowprops=arrow, annotation_clip=False)
        axes.plot(x, y, "o", color="#b2182b", markersize=4)
        # Offset of the motor's name from the arrow [points].
        beside = (0, 5) if abs(out[0]) > abs(out[1]) else (30, 0)
        axes.annotate(
            motor.name, ((x + 2 * end_x) / 3, (y + 2 * end_y) / 3), beside, ha="center",
            textcoords="offset points", va="center" if beside[0] else "bottom",
        )  # fmt: skip
    if rig.fiducials is not None:
        for number, square in zip(rig.fiducials.numbers, rig.fiducials.corners, strict=True):
            axes.add_patch(Polygon(square, facecolor="#333333"))
            x, y = square.mean(axis=0)
            axes.text(x, y, str(number), color="white", ha="center", va="center")
    for x, y in ((-0.4, 0.2), (0.1, -0.3), (0.5, 0.4)):
        axes.add_patch(Circle((x * half[0], y * half[1]), rig.parts.radius_m, color="#666666"))
    axes.annotate("x", (0, 0), (0.15 * size, 0), arrowprops={"arrowstyle": "<-"}, va="center")
    axes.annotate("y", (0, 0), (0, 0.15 * size), arrowprops={"arrowstyle": "<-"}, ha="center")
    points = np.vstack([rig.plate.corners, [motor.point for motor in rig.motors]])
    low, high = points.min(axis=0) - 0.25 * size, points.max(axis=0) + 0.25 * size
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.locator_params(nbins=6)


def _draw_image(axes: Axes, rig: Rig) -> None:
    camera, corners = rig.camera, np.array(rig.camera.corners_px)
    axes.set_title("plate in the camera image, with a part in the middle")
    axes.add_patch(Rectangle((-0.5, -0.5), camera.width_px, camera.height_px, facecolor="#dddddd"))
    axes.add_patch(Polygon(corners, facecolor="#f7f7f7", edgecolor="black"))
    for corner, text in zip(corners, ("-x, -y", "+x, -y", "+x, +y", "-x, +y"), strict=True):
        axes.plot(*corner, "o", color="#2166ac")
        x, y = corner + 0.2 * (corners.mean(axis=0) - corner)
        axes.text(x, y, text, color="#2166ac", ha="center", va="center")
    try:
        middle = to_image(rig, np.zeros((1, 2)))[0]
        axes.add_patch(Circle((middle[0], middle[1]), part_radius_px(rig), color="#666666"))
    except np.linalg.LinAlgError:
        pass  # `rig_warnings` has already reported that these corners are impossible
    points = np.vstack([corners, [[0, 0], [camera.width_px, camera.height_px]]])
    low, high = points.min(axis=0) - 30, points.max(axis=0) + 30
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal")
    axes.set(xlabel="column [px]", ylabel="row [px]")
