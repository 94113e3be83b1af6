"""Chessboards and ChArUco boards: drawn, found in pictures, and a camera's lens from those."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from plate_core.rig import project

from ..errors import CalibrationError
from .lens import Lens
from .markers import draw_marker, find_markers

REFINE_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
"""When refining of a corner ends: after 50 steps or one of less than 0.001 px."""

REFINE_FRACTION = 0.25
"""Half width of the window in which a corner is refined, over a square's side."""

LEAST_WINDOW_PX, MOST_WINDOW_PX = 2, 11
"""Bounds of that [px]."""

LEAST_CORNERS = 6
"""Corners that a picture needs: a homography takes four."""

NEAR = 4
"""Markers from whose corners the place of one between them is predicted, so that a lens that bends
is no matter."""


LEAST_SQUARE_M, MOST_SQUARE_M = 1e-3, 1.0
"""Bounds of a square's side [m]."""

MOST_PIXELS = 200_000_000
"""Of a board for the printer: A0 at 300 dpi has 140 million."""

LEAST_PICTURES = 5
"""Pictures that are needed: three tell K in principle, in noise more are wanted."""

WORST_ERROR_PX = 1.0
"""Root mean square of the errors above which a lens is refused: good pictures leave 0.1 to 0.3."""

LEAST_COVER = 0.5
"""Fraction of the image's width and height that the corners of all pictures should span: beyond
them the lens is a guess."""

Corners = tuple[np.ndarray, np.ndarray]
"""Of one picture: which (n,) of a board's corners are seen, and where (n, 2) [px]."""


@dataclass(frozen=True)
class Board:
    """A flat board of squares, black and white in turns; the one at the top left is black.

    Attributes
    ----------
    columns, rows : int
        Squares along x and y, 3 to 40; of a chessboard 4 at least.
    square_m : float
        Side of a square [m], 0.001 to 1.
    marker_m : float
        Side of the markers in the white squares [m] of a ChArUco board, numbered along the rows;
        0: a chessboard.
    dictionary : str
        Of the markers.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = "5X5_100"

    def __post_init__(self) -> None:
        least = 4 if self.marker_m == 0 else 3  # OpenCV finds no chessboard of fewer
        if not (least <= self.columns <= 40 and least <= self.rows <= 40):
            raise CalibrationError(
                f"board: {self.columns} x {self.rows} squares, allowed: {least} x {least} to "
                "40 x 40"
            )
        if not LEAST_SQUARE_M <= self.square_m <= MOST_SQUARE_M:
            raise CalibrationError(
                f"board: squares of {self.square_m:g} m, allowed: {LEAST_SQUARE_M:g} to "
                f"{MOST_SQUARE_M:g}"
            )
        if not 0 <= self.marker_m <= 0.9 * self.square_m:
            raise CalibrationError(
                f"board: markers of {self.marker_m:g} m, allowed: 0 to 0.9 squares"
            )

    @property
    def corners(self) -> np.ndarray:
        """Inner corners ((columns - 1) (rows - 1), 2) [m], row by row from the top left; y down."""
        y, x = np.mgrid[1 : self.rows, 1 : self.columns]
        return self.square_m * np.column_stack([x.ravel(), y.ravel()]).astype(float)

    @property
    def markers(self) -> np.ndarray:
        """Corners (n, 4, 2) [m] of the markers, as `find_markers` gives them; y down."""
        y, x = np.mgrid[: self.rows, : self.columns]
        white = (x + y) % 2 == 1
        middle = np.column_stack([x[white], y[white]]) + 0.5
        square = 0.5 * self.marker_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
        return np.asarray(self.square_m * middle[:, None] + square)


def draw_board(board: Board, square_px: int) -> np.ndarray:
    """Return a picture for the printer, uint8, with a white border of half a square.

    Raises
    ------
    CalibrationError
        If the dictionary is not known, or has too few markers; or the picture would be too large.
    """
    pixels = (board.columns + 1) * (board.rows + 1) * square_px**2
    if pixels > MOST_PIXELS:
        raise CalibrationError(
            f"board: {board.columns} x {board.rows} squares of {square_px} px are {pixels:,} "
            f"pixels, allowed: {MOST_PIXELS:,} (is the square's side in metres?)"
        )
    y, x = np.mgrid[: board.rows, : board.columns]
    squares = np.where((x + y) % 2 == 1, 255, 0).astype(np.uint8)
    picture = squares.repeat(square_px, axis=0).repeat(square_px, axis=1)
    side = round(board.marker_m / board.square_m * square_px)
    if side:
        white = np.argwhere((x + y) % 2 == 1)
        for number, (row, column) in enumerate(white.tolist()):
            top = row * square_px + (square_px - side) // 2
            left = column * square_px + (square_px - side) // 2
            marker = draw_marker(board.dictionary, number, side)
            picture[top : top + side, left : left + side] = marker
    return np.pad(picture, square_px // 2, constant_values=255)


def find_corners(grey: np.ndarray, board: Board) -> Corners | None:
    """Find a board's inner corners in an image (H, W) uint8; None if fewer than `LEAST_CORNERS`.

    Of a chessboard all corners must be seen, of a ChArUco board those next to markers that are.
    """
    grey = np.ascontiguousarray(grey)
    if board.marker_m == 0:
        size = (board.columns - 1, board.rows - 1)
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH + cv2.CALIB_CB_NORMALIZE_IMAGE
        seen, corners = cv2.findChessboardCorners(grey, size, flags=flags)
        if not seen:
            return None
        return np.arange(len(board.corners)), _refine(grey, corners, board)
    which, corners = _corners_beside(find_markers(grey, board.dictionary), board)
    inside = np.all((corners > 3) & (corners < np.array(grey.shape[::-1]) - 4), axis=1)
    if np.count_nonzero(inside) < LEAST_CORNERS:
        return None
    return which[inside], _refine(grey, corners[inside], board)


def _corners_beside(found: Mapping[int, np.ndarray], board: Board) -> Corners:
    """Predict the corners next to markers that are found (4, 2) [px], by number."""
    known = board.markers
    numbers = [number for number in found if number < len(known)]
    which, corners_px = [], []
    middle = known[numbers].mean(axis=1)
    for k, corner in enumerate(board.corners if len(numbers) > 1 else ()):
        near = np.argsort(np.linalg.norm(middle - corner, axis=1))[:NEAR]
        # A corner counts if a marker touches its square's corner: beyond that it may be covered.
        if np.linalg.norm(middle[near[0]] - corner) > 0.75 * board.square_m:
            continue
        place = known[[numbers[i] for i in near]].reshape(-1, 2)
        matrix, _ = cv2.findHomography(place, np.concatenate([found[numbers[i]] for i in near]))
        if matrix is not None:
            which.append(k)
            corners_px.append(project(matrix, corner)[0])
    return np.array(which, int), np.reshape(corners_px, (-1, 2))


def _refine(grey: np.ndarray, corner_px: np.ndarray, board: Board) -> np.ndarray:
    """Move corners (n, 2) [px] to where the edges around them meet."""
    points = np.asarray(corner_px, dtype=np.float32).reshape(-1, 2)
    gap = np.linalg.norm(points[:, None] - points, axis=2)
    side = float(np.median(np.sort(gap, axis=1)[:, 1]))
    # No marker may be seen in the window.
    reach = side * min(REFINE_FRACTION, 0.5 * (1 - board.marker_m / board.square_m))
    window = round(float(np.clip(reach, LEAST_WINDOW_PX, MOST_WINDOW_PX)))
    refined = cv2.cornerSubPix(
        grey, points.reshape(-1, 1, 2), (window, window), (-1, -1), REFINE_STEPS
    )
    return np.asarray(refined, dtype=float).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class LensFit:
    """The result.

    Attributes
    ----------
    lens : Lens
        With k1, k2, p1, p2, k3.
    size_px : (int, int)
        Width and height of the pictures.
    error_px : float
        Root mean square distance of corners from where the lens has them.
    errors : tuple of (n, 2)
        By picture: corners seen less computed [px].
    corners : tuple
        By picture: which corners, and where they are seen [px].
    deviation : (9,)
        Standard deviations of fx, fy, cx, cy [px], k1, k2, p1, p2, k3 that the errors entail.
    cover : (float, float)
        Fraction of the image's width and height that the corners span.
    """

    lens: Lens
    size_px: tuple[int, int]
    error_px: float
    errors: tuple[np.ndarray, ...]
    corners: tuple[Corners, ...]
    deviation: np.ndarray
    cover: tuple[float, float]

    @property
    def warning(self) -> str | None:
        """What should be done better, or None."""
        if min(self.cover) < LEAST_COVER:
            return (
                f"the board was seen in {self.cover[0]:.0%} of the width and {self.cover[1]:.0%} "
                f"of the height, better: {LEAST_COVER:.0%} or more (hold it into the corners)"
            )
        return None


def fit_lens(board: Board, seen: Sequence[Corners], size_px: tuple[int, int]) -> LensFit:
    """Find the lens from what was seen of a board in pictures of a width and height [px].

    Raises
    ------
    CalibrationError
        If there are too few pictures, they do not tell the lens, or do not agree.
    """
    if len(seen) < LEAST_PICTURES:
        raise CalibrationError(
            f"board seen in {len(seen)} pictures, allowed: at least {LEAST_PICTURES}, from "
            "different sides (is the number of squares right?)"
        )
    corners = np.column_stack([board.corners, np.zeros(len(board.corners))]).astype(np.float32)
    points = [corners[which] for which, _ in seen]
    places = [np.asarray(place, dtype=np.float32).reshape(-1, 1, 2) for _, place in seen]
    try:
        answer = cv2.calibrateCameraExtended(points, places, size_px, np.eye(3), np.zeros(5))
    except cv2.error as error:
        raise CalibrationError(
            f"no lens fits what was seen ({error.err}), allowed: boards seen from different sides"
        ) from None
    _, matrix, bend, turns, moves, deviation = answer[:6]
    bend = np.ravel(bend)[:5]
    errors = tuple(
        place - cv2.projectPoints(point, turn, move, matrix, bend)[0].reshape(-1, 2)
        for point, (_, place), turn, move in zip(points, seen, turns, moves, strict=True)
    )
    everything = np.concatenate(errors)
    error_px = float(np.sqrt(np.mean(np.sum(everything**2, axis=1))))
    deviation = np.ravel(deviation)[:9]
    if not np.all(np.isfinite(matrix)) or not error_px <= WORST_ERROR_PX:
        raise CalibrationError(
            f"corners are {error_px:.3g} px from where the lens has them, allowed: "
            f"{WORST_ERROR_PX:g} px (is the board flat, are its numbers right?)"
        )
    if deviation[0] > 0.05 * matrix[0, 0]:
        raise CalibrationError(
            f"focal length is {matrix[0, 0]:.0f} +- {deviation[0]:.0f} px, allowed: 5 % (tilt the "
            "board against the camera, by 20 to 40 degrees, to all sides)"
        )
    width, height = np.ptp(np.concatenate([place for _, place in seen]), axis=0) / size_px
    return LensFit(
        Lens(matrix, bend), size_px, error_px, errors,
        tuple(seen), deviation, (float(width), float(height)),
    )  # fmt: skip
