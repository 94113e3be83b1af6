"""A camera's lens from pictures of a board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from .boards import Board
from .calibration import Lens
from .errors import CalibrationError

LEAST_PICTURES = 5
"""Pictures that are needed: three tell K in principle, in noise more are wanted."""

WORST_ERROR_PX = 1.0
"""Root mean square of the errors above which a lens is refused: good pictures leave 0.1 to 0.3."""

LEAST_COVER = 0.5
"""Share of the image's width and height that the corners of all pictures should span: beyond them
the lens is a guess."""

Sight = tuple[np.ndarray, np.ndarray]
"""What `boards.find_corners` found in one picture."""


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
    sights : tuple
        By picture: which corners, and where they are seen [px].
    deviation : (9,)
        Standard deviations of fx, fy, cx, cy [px], k1, k2, p1, p2, k3 that the errors entail.
    cover : (float, float)
        Share of the image's width and height that the corners span.
    """

    lens: Lens
    size_px: tuple[int, int]
    error_px: float
    errors: tuple[np.ndarray, ...]
    sights: tuple[Sight, ...]
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


def fit_lens(board: Board, sights: Sequence[Sight], size_px: tuple[int, int]) -> LensFit:
    """Find the lens from what was seen of a board.

    Parameters
    ----------
    board : Board
    sights : sequence of ((n,) int, (n, 2))
        By picture: which of the board's corners are seen, and where [px].
    size_px : (int, int)
        Width and height of the pictures.

    Raises
    ------
    CalibrationError
        If there are too few pictures, they do not tell the lens, or do not agree.
    """
    if len(sights) < LEAST_PICTURES:
        raise CalibrationError(
            f"board seen in {len(sights)} pictures, allowed: at least {LEAST_PICTURES}, from "
            "different sides (is the number of squares right?)"
        )
    corners = np.column_stack([board.corners, np.zeros(len(board.corners))]).astype(np.float32)
    points = [corners[which] for which, _ in sights]
    seen = [np.asarray(place, dtype=np.float32).reshape(-1, 1, 2) for _, place in sights]
    try:
        answer = cv2.calibrateCameraExtended(points, seen, size_px, np.eye(3), np.zeros(5))
    except cv2.error as error:
        raise CalibrationError(
            f"no lens fits what was seen ({error.err}), allowed: boards seen from different sides"
        ) from None
    _, matrix, bend, turns, moves, deviation = answer[:6]
    bend = np.ravel(bend)[:5]
    errors = tuple(
        place - cv2.projectPoints(point, turn, move, matrix, bend)[0].reshape(-1, 2)
        for point, (_, place), turn, move in zip(points, sights, turns, moves, strict=True)
    )
    everything = np.concatenate(errors)
    error_px = float(np.sqrt(np.mean(np.sum(everything**2, axis=1))))
    spread = np.ravel(deviation)[:9]
    if not np.all(np.isfinite(matrix)) or not error_px <= WORST_ERROR_PX:
        raise CalibrationError(
            f"corners are {error_px:.3g} px from where the lens has them, allowed: "
            f"{WORST_ERROR_PX:g} px (is the board flat, are its numbers right?)"
        )
    if spread[0] > 0.05 * matrix[0, 0]:
        raise CalibrationError(
            f"focal length is {matrix[0, 0]:.0f} +- {spread[0]:.0f} px, allowed: 5 % (tilt the "
            "board against the camera, by 20 to 40 degrees, to all sides)"
        )
    places = np.concatenate([place for _, place in sights])
    width, height = np.ptp(places, axis=0) / size_px
    return LensFit(
        Lens(np.asarray(matrix, dtype=float), bend.astype(float)), size_px, error_px, errors,
        tuple(sights), spread, (float(width), float(height)),
    )  # fmt: skip
