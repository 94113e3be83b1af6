"""Pictures of a board that are taken one after the other until they tell the lens."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from plate_core.rig import project

from .boards import Board, Corners, LensFit, fit_lens

NEEDED = 10
"""Pictures that are asked for: with five the focal length scatters by 1 %, with ten by 0.4 %."""

MOST = 40
"""Maximum number of pictures: more take long in the fit and improve little."""

DIFFERS = 0.06
"""Distance of a board from those of all kept pictures, root mean square over its four outer
corners, relative to the image's width [-]."""

STILL = 0.01
"""The same from the picture before, below which the board rests: it is not blurred then [-]."""

COLUMNS, ROWS = 4, 3
"""Cells of the grid over the image."""

CORNERS = {
    "top left": 0,
    "top right": COLUMNS - 1,
    "bottom left": (ROWS - 1) * COLUMNS,
    "bottom right": ROWS * COLUMNS - 1,
}
"""Cells into which the board must be held: there a lens bends most."""

TILTED_RAD = np.radians(12.0)
"""Tilt from which a picture counts as tilted: below it the focal length and the distance are not
told apart."""

TILTS = ("left", "right", "top", "bottom")
"""Sides of the board that must be nearer to the camera in some picture."""

GUESSED_FOCAL = 1.2
"""Focal length from which the tilt is estimated, relative to the longer side of the image [-]: of a
lens with 45 degrees. Lenses of 30 to 70 degrees give the right side, and the tilt to a third."""


@dataclass(frozen=True, eq=False)
class LensPictures:
    """The pictures so far.

    Attributes
    ----------
    board : Board
    size_px : (int, int)
        Width and height of all pictures.
    kept : tuple of Corners
        What was seen of the board in the pictures that were kept.
    places : tuple of (8,)
        Their outer corners [widths of the image].
    tilts : frozenset of str
        Those of `TILTS` that were seen.
    last : (8,) or None
        Outer corners in the last picture; None: the board was not seen.
    """

    board: Board
    size_px: tuple[int, int]
    kept: tuple[Corners, ...] = ()
    places: tuple[np.ndarray, ...] = ()
    tilts: frozenset[str] = frozenset()
    last: np.ndarray | None = None

    def shown(self, board: Board, corners: Corners | None) -> tuple[LensPictures, str]:
        """Return it with what one more picture shows, and what became of the picture.

        `board` is the board as it is printed. A picture is kept if the board rests and is in a
        place unlike those of the pictures kept.
        """
        if corners is None:
            return replace(self, last=None), "the board is not seen"
        which, place_px = corners
        outer = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * [board.columns, board.rows]
        matrix, _ = cv2.findHomography(board.corners[which], np.asarray(place_px))
        if matrix is None:
            return replace(self, last=None), "too little of the board is seen"
        place = (project(matrix, board.square_m * outer) / self.size_px[0]).ravel()
        now = replace(self, board=board, last=place)
        if self.last is None or _away(place, self.last) > STILL:
            return now, "hold the board still"
        if any(_away(place, one) < DIFFERS for one in self.places):
            return now, "like a picture that was taken: hold the board otherwise"
        if len(self.kept) >= MOST:
            return now, f"{MOST} pictures are enough"
        tilt = _tilt(board, corners, self.size_px)
        now = replace(
            now,
            kept=(*self.kept, corners),
            places=(*self.places, place),
            tilts=self.tilts | ({tilt} if tilt else set()),
        )
        return now, f"picture {len(now.kept)} taken"

    @property
    def cover(self) -> np.ndarray:
        """In which cells (ROWS * COLUMNS,) of the image corners were seen: bool."""
        cover = np.zeros(ROWS * COLUMNS, bool)
        for _, place_px in self.kept:
            column, row = (np.asarray(place_px) / self.size_px * [COLUMNS, ROWS]).astype(int).T
            cover[np.clip(row, 0, ROWS - 1) * COLUMNS + np.clip(column, 0, COLUMNS - 1)] = True
        return cover

    @property
    def missing(self) -> tuple[str, ...]:
        """What the next pictures must show; empty: these tell the lens."""
        cover = self.cover
        lacks = [f"hold it into the {name} corner" for name, k in CORNERS.items() if not cover[k]]
        lacks += [f"tilt it: {side} side nearer" for side in TILTS if side not in self.tilts]
        if not lacks and len(self.kept) < NEEDED:
            lacks.append(f"{NEEDED - len(self.kept)} more, at other distances")
        return tuple(lacks)

    def fit(self, model: str = "plumb_bob") -> LensFit:
        """Fit the lens; raises as `fit_lens`."""
        return fit_lens(self.board, self.kept, self.size_px, model)


def _away(place: np.ndarray, other: np.ndarray) -> float:
    """Return the distance of two boards' outer corners (8,), root mean square."""
    return float(np.sqrt(np.sum((place - other) ** 2) / 4))


def _tilt(board: Board, corners: Corners, size_px: tuple[int, int]) -> str:
    """Return which side of the board is nearer to the camera, one of `TILTS`; "" if it faces it."""
    which, place_px = corners
    focal = GUESSED_FOCAL * max(size_px)
    middle = (np.array(size_px) - 1) / 2
    matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
    points = np.column_stack([board.corners[which], np.zeros(len(which))])
    found, turn, _ = cv2.solvePnP(points, np.asarray(place_px, float), matrix, None)
    if not found:
        return ""
    normal = cv2.Rodrigues(turn)[0][:, 2]
    normal = normal if normal[2] < 0 else -normal  # towards the camera
    # The far side recedes against the normal: one that points right has the left side nearer.
    x, y = float(normal[0]), float(normal[1])
    if np.hypot(x, y) < np.sin(TILTED_RAD):
        return ""
    if abs(x) >= abs(y):
        return TILTS[0] if x > 0 else TILTS[1]
    return TILTS[2] if y > 0 else TILTS[3]
