"""Drawing with metres as units, and the headings and legends for sheets of drawn pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from plate_core.colours import INK, Colour

WHITE: Colour = (255, 255, 255)

SHIFT = 4
"""Fractional bits of pixel coordinates. Lines have a resolution of 1/16 px, so that they do not
jitter."""


@dataclass(frozen=True)
class Canvas:
    """Image with a scale and an origin. All methods draw into `pixels`.

    Attributes
    ----------
    pixels : (H, W, 3) uint8
        Red, green, blue.
    scale : float
        Scale [px/m].
    origin : (x, y)
        Pixel of the point (0, 0) m. In metres, y points up. In pixels, y points down.
    unit : float
        Width of a thin line [px].
    text_px : int
        Size of text [px].
    """

    pixels: np.ndarray
    scale: float
    origin: tuple[float, float]
    unit: float
    text_px: int

    def _to_px(self, point: Sequence | np.ndarray) -> np.ndarray:
        place = np.reshape(point, (-1, 2)) * [self.scale, -self.scale] + self.origin
        return np.round(place * 2**SHIFT).astype(np.int32).reshape(-1, 1, 2)

    def _line_width(self, width: float) -> int:
        return max(1, round(width * self.unit))

    def line(
        self, point: Sequence | np.ndarray, colour: Colour, width: float = 1, dashed: bool = False
    ) -> None:
        """Draw a line through points (n, 2) [m]. Dashes are five line widths long."""
        pieces = dashes(point, 5 * width * self.unit / self.scale) if dashed else [point]
        lines = [self._to_px(piece) for piece in pieces]
        cv2.polylines(
            self.pixels, lines, False, colour, self._line_width(width), cv2.LINE_AA, SHIFT
        )

    def area(self, corner: Sequence | np.ndarray, colour: Colour, opacity: float) -> None:
        """Fill a polygon (n, 2) [m] with the opacity `opacity`, and draw its outline."""
        tinted = self.pixels.copy()
        cv2.fillPoly(tinted, [self._to_px(corner)], colour, cv2.LINE_AA, SHIFT)
        cv2.addWeighted(tinted, opacity, self.pixels, 1 - opacity, 0, dst=self.pixels)
        self.line(np.vstack([corner, corner[:1]]), colour, 1.5)

    def disc(
        self, centre: Sequence | np.ndarray, radius: float, face: Colour | None, edge: Colour
    ) -> None:
        """Draw a disc with an edge. If `face` is None, draw only the edge."""
        centre_px = self._to_px(centre)[0, 0].tolist()
        size = round(radius * self.scale * 2**SHIFT)
        if face is not None:
            cv2.circle(self.pixels, centre_px, size, face, -1, cv2.LINE_AA, SHIFT)
        cv2.circle(self.pixels, centre_px, size, edge, self._line_width(1.5), cv2.LINE_AA, SHIFT)

    def outline(
        self, corner: np.ndarray, holes: Sequence[np.ndarray], face: Colour | None, edge: Colour
    ) -> None:
        """Draw a polygon (n, 2) [m] with holes and an edge. If `face` is None, draw only the
        edge."""
        contours = [self._to_px(ring) for ring in (corner, *holes)]
        if face is not None:
            cv2.fillPoly(self.pixels, contours, face, cv2.LINE_AA, SHIFT)
        cv2.polylines(self.pixels, contours, True, edge, self._line_width(1.5), cv2.LINE_AA, SHIFT)

    def arrow(self, start: np.ndarray, end: np.ndarray, colour: Colour, width: float = 1) -> None:
        """Draw an arrow with a filled head."""
        along = (np.asarray(end) - start) * self.scale
        length = float(np.hypot(*along))
        if length < self.unit:
            return
        head = min(5.0 * self.unit * width, 0.6 * length) / self.scale
        along = along / length
        neck = np.asarray(end) - head * along
        side = 0.45 * head * np.array([-along[1], along[0]])
        self.line([start, neck], colour, width)
        corners = self._to_px([end, neck + side, neck - side])
        cv2.fillPoly(self.pixels, [corners], colour, cv2.LINE_AA, SHIFT)

    def cross(self, centre: np.ndarray, size: float, colour: Colour) -> None:
        """Draw a cross of half-width `size` [m]."""
        for tint, width in ((WHITE, 4.0), (colour, 2.2)):
            for sign in (1, -1):
                arm = np.array([size, sign * size])
                self.line([centre - arm, centre + arm], tint, width)

    def write(self, point: Sequence | np.ndarray, text: str) -> None:
        """Write a text centred at a point [m], with a white edge."""
        image = Image.fromarray(self.pixels)
        corner_px = tuple(self._to_px(point)[0, 0] / 2**SHIFT)
        ImageDraw.Draw(image).text(
            corner_px, text, INK, font(self.text_px), "mm", stroke_width=2, stroke_fill=WHITE
        )
        self.pixels[:] = np.asarray(image)


def dashes(point: Sequence | np.ndarray, length: float) -> list[np.ndarray]:
    """Cut a line through points (n, 2) into pieces of a given length, with gaps of two thirds of
    this length."""
    point = np.asarray(point, float)
    distance = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(point, axis=0).T))])
    starts = np.arange(0, distance[-1], 5 / 3 * length)
    pieces = []
    for start in starts:
        end = min(start + length, distance[-1])
        inner = distance[(distance > start) & (distance < end)]
        distances = np.array([start, *inner, end])
        pieces.append(np.column_stack([np.interp(distances, distance, axis) for axis in point.T]))
    return pieces


@cache
def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return Pillow's default font with the given size [px]."""
    return ImageFont.load_default(size)


def heading(width: int, size: int, left: str, right: str = "") -> np.ndarray:
    """Return an image (H, W, 3) of a text line with a left and a right text."""
    image = Image.new("RGB", (width, round(1.6 * size)), "white")
    pen, middle = ImageDraw.Draw(image), image.height / 2
    pen.text((size / 4, middle), left, INK, font(size), "lm")
    pen.text((width - size / 4, middle), right, INK, font(size), "rm")
    return np.array(image)


@dataclass(frozen=True)
class Sample:
    """Entry of a legend: width of the drawn sample [m], function that draws the sample from its
    left end, and text."""

    width: float
    draw: Callable[[Canvas], None]
    text: str


def key(samples: Sequence[Sample], width: int, frame: Canvas) -> np.ndarray:
    """Return the image (H, W, 3) of a legend for frames like `frame`. The legend shows samples in
    the same scale with their texts, in as many lines as needed."""
    size = frame.text_px
    high, x, row = round(1.7 * size), size / 4, 0
    places: list[tuple[float, float, float]] = []
    for sample in samples:
        left = sample.width * frame.scale + 0.5 * size
        end = x + left + font(size).getlength(sample.text)
        if places and end > width:
            row, end, x = row + 1, end - x + size / 4, size / 4
        places.append((x, (row + 0.5) * high, x + left))
        x = end + 1.3 * size
    image = Image.new("RGB", (width, (row + 1) * high), "white")
    for sample, (_, y, left) in zip(samples, places, strict=True):
        ImageDraw.Draw(image).text((left, y), sample.text, INK, font(size), "lm")
    pixels = np.array(image)
    for sample, (x, y, _) in zip(samples, places, strict=True):
        sample.draw(Canvas(pixels, frame.scale, (x, y), frame.unit, size))
    return pixels
