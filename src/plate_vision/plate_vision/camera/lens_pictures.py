"""Pictures of a calibration board, collected one by one until they suffice to fit the lens.

`LensPictures.shown` keeps a picture if the board is at rest at a new place. `missing` gives
instructions for the next pictures: image corners to cover and tilts. `fit` fits the lens.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from plate_core.rig import project

from .boards import MAX_PICTURES, Board, Corners, LensFit, fit_lens

NEEDED = 10
"""Number of pictures that the user should take. The standard deviation of the focal length is 1 %
with five pictures and 0.4 % with ten."""

DIFFERS = 0.06
"""Minimum distance between the board's place in a new picture and its places in all kept pictures
[-]. The distance is the root mean square over the four outer corners, relative to the image's
width."""

STILL = 0.01
"""Maximum distance between the board's places in two successive pictures, measured as for `DIFFERS`
[-]. Up to this distance, the board counts as at rest, because the motion does not blur the
image."""

COLUMNS, ROWS = 4, 3
"""Numbers of columns and rows of the grid that divides the image into cells."""

CORNERS = {
    "top left": 0,
    "top right": COLUMNS - 1,
    "bottom left": (ROWS - 1) * COLUMNS,
    "bottom right": ROWS * COLUMNS - 1,
}
"""Cells of the image's corners. The board must be seen in each of these cells, because the
distortion of a lens is largest in the corners."""

TILTED_RAD = np.radians(12.0)
"""Minimum tilt of a tilted board. Below this tilt, the fit cannot separate the focal length from
the distance of the board."""

TILTS = ("left", "right", "top", "bottom")
"""Sides of the board. Each side must be the nearest one to the camera in at least one picture."""

GUESSED_FOCAL = 1.2
"""Focal length assumed in the estimate of the tilt, relative to the longer side of the image [-]. A
lens with a field of view of 45 degrees has this focal length. For fields of view of 30 to 70
degrees, the nearest side is determined correctly, and the relative error of the tilt is up to a
third."""


@dataclass(frozen=True, eq=False)
class LensPictures:
    """The pictures of the calibration board that were collected so far.

    Attributes
    ----------
    board : Board
    size_px : (int, int)
        Width and height of all pictures.
    kept : tuple of Corners
        Corners of the board seen in each kept picture.
    places : tuple of (8,)
        Outer corners of the board in each kept picture, relative to the image's width [-].
    tilts : frozenset of str
        Tilts that the kept pictures show, each one of `TILTS`.
    last : (8,) or None
        Outer corners of the board in the last picture, as in `places`; None if the board was not
        seen.
    """

    board: Board
    size_px: tuple[int, int]
    kept: tuple[Corners, ...] = ()
    places: tuple[np.ndarray, ...] = ()
    tilts: frozenset[str] = frozenset()
    last: np.ndarray | None = None

    def shown(self, board: Board, corners: Corners | None) -> tuple[LensPictures, str]:
        """Return a copy with one more picture, and a message about this picture for the user.

        `board` is the board as printed. A picture is kept if the board is at rest and its place
        differs from its places in all kept pictures.
        """
        if corners is None:
            return replace(self, last=None), "the board is not detected"
        corner_ids, place_px = corners
        outer = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * [board.columns, board.rows]
        matrix, _ = cv2.findHomography(board.corners[corner_ids], np.asarray(place_px))
        if matrix is None:
            return replace(self, last=None), "too little of the board is detected"
        place = (project(matrix, board.square_m * outer) / self.size_px[0]).ravel()
        now = replace(self, board=board, last=place)
        if self.last is None or _corner_distance(place, self.last) > STILL:
            return now, "hold the board still"
        if any(_corner_distance(place, earlier) < DIFFERS for earlier in self.places):
            return now, "similar to an earlier picture: hold the board differently"
        if len(self.kept) >= MAX_PICTURES:
            return now, f"{MAX_PICTURES} pictures are enough"
        tilt = _tilted_side(board, corners, self.size_px)
        now = replace(
            now,
            kept=(*self.kept, corners),
            places=(*self.places, place),
            tilts=self.tilts | ({tilt} if tilt else set()),
        )
        return now, f"picture {len(now.kept)} taken"

    @property
    def cover(self) -> np.ndarray:
        """Whether the board's corners were seen in each cell of the image, (ROWS * COLUMNS,)
        bool."""
        cover = np.zeros(ROWS * COLUMNS, bool)
        for _, place_px in self.kept:
            column, row = (np.asarray(place_px) / self.size_px * [COLUMNS, ROWS]).astype(int).T
            cover[np.clip(row, 0, ROWS - 1) * COLUMNS + np.clip(column, 0, COLUMNS - 1)] = True
        return cover

    @property
    def missing(self) -> tuple[str, ...]:
        """Instructions for the next pictures. Empty if the pictures suffice."""
        cover = self.cover
        lacks = [f"hold it in the {name} corner" for name, k in CORNERS.items() if not cover[k]]
        lacks += [f"tilt it: {side} side nearer" for side in TILTS if side not in self.tilts]
        if not lacks and len(self.kept) < NEEDED:
            lacks.append(f"{NEEDED - len(self.kept)} more pictures at other distances")
        return tuple(lacks)

    def fit(self, model: str = "plumb_bob") -> LensFit:
        """Fit the lens. Raises the errors of `fit_lens`."""
        return fit_lens(self.board, self.kept, self.size_px, model)


def _corner_distance(place: np.ndarray, other: np.ndarray) -> float:
    """Return the root mean square distance between the outer corners (8,) of the board in two
    pictures."""
    return float(np.sqrt(np.sum((place - other) ** 2) / 4))


def _tilted_side(board: Board, corners: Corners, size_px: tuple[int, int]) -> str:
    """Return the side of the board that is nearest to the camera, one of `TILTS`. Return "" if the
    board is not tilted."""
    corner_ids, place_px = corners
    focal = GUESSED_FOCAL * max(size_px)
    middle = (np.array(size_px) - 1) / 2
    matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
    points = np.column_stack([board.corners[corner_ids], np.zeros(len(corner_ids))])
    found, rotation, _ = cv2.solvePnP(points, np.asarray(place_px, float), matrix, None)
    if not found:
        return ""
    normal = cv2.Rodrigues(rotation)[0][:, 2]
    normal = normal if normal[2] < 0 else -normal  # the normal must point towards the camera
    # If the board's normal points to the right, the left side of the board is nearer to the camera.
    x, y = float(normal[0]), float(normal[1])
    if np.hypot(x, y) < np.sin(TILTED_RAD):
        return ""
    if abs(x) >= abs(y):
        return TILTS[0] if x > 0 else TILTS[1]
    return TILTS[2] if y > 0 else TILTS[3]
