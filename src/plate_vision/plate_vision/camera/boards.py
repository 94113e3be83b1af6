"""Chessboards and ChArUco boards: draw them, find them in pictures, and fit a camera's lens.

`find_board` finds the inner corners of a board with sub-pixel accuracy. `fit_lens` fits the camera
matrix K and the distortion to the corners in at least five pictures. For plumb_bob and
rational_polynomial, `fit_lens` uses OpenCV's calibrateCamera. For an equidistant lens, `fit_lens`
uses the Levenberg-Marquardt method.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.optimize import least_squares

from plate_core.rig import project

from ..errors import CalibrationError
from .lens import Lens
from .markers import draw_marker, find_markers

REFINE_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
"""Stop criterion of cornerSubPix: 50 iterations, or a step of less than 0.001 px."""

REFINE_FRACTION = 0.25
"""Half width of the window in which a corner is refined, relative to a square's side."""

MIN_WINDOW_PX, MAX_WINDOW_PX = 2, 11
"""Bounds of the half width of the window in which a corner is refined [px]."""

MIN_CORNERS = 6
"""Minimum number of corners in a picture. A homography needs at least four corners."""

MIN_MARKERS = 4
"""Minimum number of detected markers for a comparison with the markers of the board."""

WORST_MISFIT = 0.4
"""Maximum root mean square distance between the detected markers and the markers of the board
[marker sides]. The distance is 0.7 or more for a wrong board. For the correct board, the distance
is at most 0.2, even if the lens distorts strongly."""

NEAR = 4
"""Number of markers that are used to predict a corner. The nearest markers are used, because the
distortion of the lens changes little between these markers and the corner."""


MIN_SQUARE_M, MAX_SQUARE_M = 1e-3, 1.0
"""Range of a square's side [m]."""

MAX_PIXELS = 200_000_000
"""Maximum number of pixels of a board for the printer. A sheet of A0 at 300 dpi has 140 million
pixels."""

MIN_PICTURES = 5
"""Minimum number of pictures. Three pictures determine K in principle, but more pictures are needed
because of noise."""

MAX_PICTURES = 40
"""Maximum number of pictures in a fit. More pictures increase the computation time, but hardly
improve the fit."""

START_ANGLES_RAD = (np.pi, 0.75 * np.pi, 0.5 * np.pi, 0.35 * np.pi)
"""Angles of view across the longer side of the image [rad]. These angles are the starting values
for the fits of an equidistant lens."""

WEAKEST = 1e-9
"""Minimum singular value of a fit's Jacobian, relative to the largest one [-]. Smaller singular
values are replaced by this minimum. The standard deviations therefore remain finite if the pictures
do not determine all coefficients, such as k1 to k6 together."""

FIXED = (
    0,
    cv2.CALIB_FIX_K6,
    cv2.CALIB_FIX_K5 | cv2.CALIB_FIX_K6,
    cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K5 | cv2.CALIB_FIX_K6,
)
"""Flags of OpenCV that set coefficients of a rational polynomial to 0. Each entry sets more
coefficients to 0 than the entry before it."""

FOLD_GRID = 33
"""Number of points along each side of the image for the check whether the lens folds the image."""

FIT_STEPS = 200
"""Maximum number of iterations of the equidistant fit. The fit typically needs 10 to 20
iterations."""

WORST_ERROR_PX = 1.0
"""Maximum root mean square error of a fit [px]. Good pictures give an error of 0.1 to 0.3 px."""

MIN_COVER = 0.5
"""Recommended minimum fraction of the image's width and height that the corners of all pictures
span. Outside the corners, the lens model is extrapolated."""

Corners = tuple[np.ndarray, np.ndarray]
"""Detected corners in one picture. The first array contains the indices (n,) of the corners in
`Board.corners`. The second array contains the image points (n, 2) of the corners [px]."""


@dataclass(frozen=True)
class Board:
    """A flat board of alternating black and white squares.

    Attributes
    ----------
    columns, rows : int
        Number of squares along x and y, 3 to 40. A chessboard needs at least 4.
    square_m : float
        Side of a square [m], 0.001 to 1.
    marker_m : float
        Side of the markers in the white squares of a ChArUco board [m]. The markers are numbered
        along the rows. 0: a chessboard.
    dictionary : str
        Dictionary of the markers.
    white_first : bool
        Whether the square at the top left is white. Some other programs print such boards. OpenCV
        before 4.6 also prints such boards if the number of rows is even. If False, the square is
        black.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = "5X5_100"
    white_first: bool = False

    def __post_init__(self) -> None:
        # OpenCV detects only chessboards of at least 4 x 4 squares
        lower = 4 if self.marker_m == 0 else 3
        if not (lower <= self.columns <= 40 and lower <= self.rows <= 40):
            raise CalibrationError(
                f"board: size is {self.columns} x {self.rows} squares, allowed: {lower} x {lower} "
                "to 40 x 40"
            )
        if not MIN_SQUARE_M <= self.square_m <= MAX_SQUARE_M:
            raise CalibrationError(
                f"board: side of a square is {self.square_m:g} m, allowed: {MIN_SQUARE_M:g} to "
                f"{MAX_SQUARE_M:g}"
            )
        if not 0 <= self.marker_m <= 0.9 * self.square_m:
            raise CalibrationError(
                f"board: side of a marker is {self.marker_m:g} m, allowed: 0 to "
                f"{0.9 * self.square_m:g} (0.9 times the side of a square)"
            )

    @property
    def corners(self) -> np.ndarray:
        """Inner corners ((columns - 1) (rows - 1), 2) [m], row by row from the top left. y points
        down."""
        y, x = np.mgrid[1 : self.rows, 1 : self.columns]
        return self.square_m * np.column_stack([x.ravel(), y.ravel()]).astype(float)

    @property
    def white(self) -> np.ndarray:
        """Whether a square is white, (rows, columns) bool."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.asarray((x + y) % 2 == (0 if self.white_first else 1))

    @property
    def markers(self) -> np.ndarray:
        """Corners (n, 4, 2) [m] of the markers, in the order of `find_markers`. y points down."""
        y, x = np.nonzero(self.white)
        middle = np.column_stack([x, y]) + 0.5
        square = 0.5 * self.marker_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
        return np.asarray(self.square_m * middle[:, None] + square)


def draw_board(board: Board, square_px: int) -> np.ndarray:
    """Return a picture of the board for the printer, uint8, with a border of half a square.

    Raises
    ------
    CalibrationError
        If the dictionary is unknown or has too few markers, or the picture would be too large.
    """
    pixels = (board.columns + 1) * (board.rows + 1) * square_px**2
    if pixels > MAX_PIXELS:
        raise CalibrationError(
            f"board: picture of {board.columns} x {board.rows} squares of {square_px} px has "
            f"{pixels:,} pixels, allowed: at most {MAX_PIXELS:,} (give the square's side in metres)"
        )
    squares = np.where(board.white, 255, 0).astype(np.uint8)
    picture = squares.repeat(square_px, axis=0).repeat(square_px, axis=1)
    side = round(board.marker_m / board.square_m * square_px)
    if side:
        for number, (row, column) in enumerate(np.argwhere(board.white).tolist()):
            top = row * square_px + (square_px - side) // 2
            left = column * square_px + (square_px - side) // 2
            marker = draw_marker(board.dictionary, number, side)
            picture[top : top + side, left : left + side] = marker
    return np.pad(picture, square_px // 2, constant_values=255)


def find_board(grey: np.ndarray, board: Board, fast: bool = False) -> tuple[Board, Corners | None]:
    """Find a board's inner corners in an image (H, W) uint8.

    Return the board as it is printed, and the detected corners. The returned board differs from the
    given board if the markers show that its first square has the other colour. The corners are None
    if fewer than `MIN_CORNERS` corners are found.

    All corners of a chessboard must be visible. On a ChArUco board, only the corners next to
    visible markers are found.

    If `fast` is true, a picture without a chessboard takes 0.1 s instead of 2 s, but a few
    chessboards are not found.

    Raises
    ------
    CalibrationError
        If markers are visible, but not at the places of the markers on this board.
    """
    grey = np.ascontiguousarray(grey)
    if board.marker_m == 0:
        size = (board.columns - 1, board.rows - 1)
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH + cv2.CALIB_CB_NORMALIZE_IMAGE
        flags += cv2.CALIB_CB_FAST_CHECK if fast else 0
        seen, corners = cv2.findChessboardCorners(grey, size, flags=flags)
        if not seen:
            return board, None
        return board, (np.arange(len(board.corners)), _refine_corners(grey, corners, board))
    found = find_markers(grey, board.dictionary)
    board = _match_square_colour(found, board)
    corner_ids, corners = _predict_corners(found, board)
    inside = np.all((corners > 3) & (corners < np.array(grey.shape[::-1]) - 4), axis=1)
    if np.count_nonzero(inside) < MIN_CORNERS:
        return board, None
    return board, (corner_ids[inside], _refine_corners(grey, corners[inside], board))


def _match_square_colour(found: Mapping[int, np.ndarray], board: Board) -> Board:
    """Return the board with the colour of the first square that fits the detected markers. `found`
    contains the corners (4, 2) [px] of each marker by its number."""
    if len(found) < MIN_MARKERS:
        return board
    other = replace(board, white_first=not board.white_first)
    own_misfit, other_misfit = _marker_misfit(found, board), _marker_misfit(found, other)
    best, misfit = (other, other_misfit) if other_misfit < 0.5 * own_misfit else (board, own_misfit)
    if misfit > WORST_MISFIT:
        turned = replace(board, columns=board.rows, rows=board.columns)
        swapped = min(
            _marker_misfit(found, replace(turned, white_first=first)) for first in (False, True)
        )
        hint = f" (they fit {board.rows}x{board.columns})" if swapped < WORST_MISFIT else ""
        raise CalibrationError(
            f"{len(found)} detected markers do not fit a board of {board.columns}x{board.rows} "
            f"squares{hint}, allowed: the numbers of squares along x and y of a board whose "
            "markers are numbered along the rows"
        )
    return best


def _marker_misfit(found: Mapping[int, np.ndarray], board: Board) -> float:
    """Return the root mean square distance between the detected markers and the board's markers
    mapped by the best homography, relative to a marker's side."""
    known = board.markers
    numbers = [number for number in found if number < len(known)]
    # refuse the board if more than half of the detected markers do not belong to it
    if 2 * len(numbers) < len(found):
        return np.inf
    place, seen = known[numbers].reshape(-1, 2), np.concatenate([found[k] for k in numbers])
    matrix, _ = cv2.findHomography(place, seen)
    if matrix is None:
        return np.inf
    gap = np.linalg.norm(project(matrix, place) - seen, axis=1)
    sides = np.linalg.norm(np.diff(seen.reshape(-1, 4, 2), axis=1), axis=2)
    return float(np.sqrt(np.mean(gap**2)) / np.median(sides))


def _predict_corners(found: Mapping[int, np.ndarray], board: Board) -> Corners:
    """Predict the board's corners next to the detected markers. `found` contains the corners (4, 2)
    [px] of each marker by its number."""
    known = board.markers
    numbers = [number for number in found if number < len(known)]
    corner_ids, corners_px = [], []
    middle = known[numbers].mean(axis=1)
    for k, corner in enumerate(board.corners if len(numbers) > 1 else ()):
        near = np.argsort(np.linalg.norm(middle - corner, axis=1))[:NEAR]
        # Use a corner only if the nearest visible marker touches it. If the nearest visible marker
        # does not touch the corner, something may cover the corner.
        if np.linalg.norm(middle[near[0]] - corner) > 0.75 * board.square_m:
            continue
        place = known[[numbers[i] for i in near]].reshape(-1, 2)
        matrix, _ = cv2.findHomography(place, np.concatenate([found[numbers[i]] for i in near]))
        if matrix is not None:
            corner_ids.append(k)
            corners_px.append(project(matrix, corner)[0])
    return np.array(corner_ids, int), np.reshape(corners_px, (-1, 2))


def _refine_corners(grey: np.ndarray, corner_px: np.ndarray, board: Board) -> np.ndarray:
    """Refine corners (n, 2) [px] to the intersection of the edges around them."""
    points = np.asarray(corner_px, dtype=np.float32).reshape(-1, 2)
    gap = np.linalg.norm(points[:, None] - points, axis=2)
    side = float(np.median(np.sort(gap, axis=1)[:, 1]))
    # The window around a corner must not contain a marker.
    reach = side * min(REFINE_FRACTION, 0.5 * (1 - board.marker_m / board.square_m))
    window = round(float(np.clip(reach, MIN_WINDOW_PX, MAX_WINDOW_PX)))
    refined = cv2.cornerSubPix(
        grey, points.reshape(-1, 1, 2), (window, window), (-1, -1), REFINE_STEPS
    )
    return np.asarray(refined, dtype=float).reshape(-1, 2)


def choose_pictures(
    seen: Sequence[Corners], board: Board, max_count: int = MAX_PICTURES
) -> list[int]:
    """Choose pictures with different positions of the board, and return their indices.

    The first chosen picture is the one with the largest number of corners. Each further picture
    maximises the distance to the pictures that are already chosen (farthest-point sampling). The
    distance is measured at the image points of the board's four outer corners. The chosen boards
    therefore have different places in the image, distances and tilts.
    """
    if len(seen) <= max_count:
        return list(range(len(seen)))
    outer = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * [board.columns, board.rows]
    places = []
    for corner_ids, corners_px in seen:
        matrix, _ = cv2.findHomography(board.corners[corner_ids], np.asarray(corners_px))
        places.append(
            np.full(8, np.nan)
            if matrix is None
            else project(matrix, board.square_m * outer).ravel()
        )
    place = np.array(places)
    usable = np.all(np.isfinite(place), axis=1)
    chosen = [max(np.flatnonzero(usable).tolist(), key=lambda k: len(seen[k][0]))]
    gap = np.where(usable, np.linalg.norm(place - place[chosen[0]], axis=1), -np.inf)
    while len(chosen) < min(max_count, int(np.count_nonzero(usable))):
        chosen.append(int(np.argmax(gap)))
        gap = np.fmin(gap, np.linalg.norm(place - place[chosen[-1]], axis=1))
    return sorted(chosen)


@dataclass(frozen=True, eq=False)
class LensFit:
    """Result of `fit_lens`.

    Attributes
    ----------
    lens : Lens
    size_px : (int, int)
        Width and height of the pictures.
    error_px : float
        Root mean square distance between the detected corners and those computed with the lens
        [px].
    errors : tuple of (n, 2)
        Detected minus computed corners of each picture [px].
    corners : tuple
        `Corners` of each picture.
    deviation : (n,)
        Standard deviations of fx, fy, cx, cy [px] and of the distortion, estimated from the errors.
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
        """Advice on better pictures. None if no advice is needed."""
        if min(self.cover) < MIN_COVER:
            return (
                f"the board covered {self.cover[0]:.0%} of the image's width and "
                f"{self.cover[1]:.0%} of its height, advised: {MIN_COVER:.0%} or more of both "
                "(hold the board in the corners of the image)"
            )
        # Images of a fisheye lens are never undistorted, so this check does not apply to them.
        model = self.lens.model
        if model != "equidistant" and not _maps_without_folding(self.lens, self.size_px):
            return (
                "the fitted lens folds the image near its edges; keep the plate away from them, or "
                "take pictures with the board in the image's corners"
            )
        return None


def fit_lens(
    board: Board, seen: Sequence[Corners], size_px: tuple[int, int], model: str = "plumb_bob"
) -> LensFit:
    """Fit the lens to the corners of a board in pictures with the width and height `size_px` [px].

    `model` is a key of `plate_core.rig.LENS_MODELS`: a plumb_bob with k1, k2, p1, p2, k3, a
    rational_polynomial that also has k4, k5, k6, or an equidistant lens.

    Raises
    ------
    CalibrationError
        If there are too few pictures, if they do not determine the lens, or if they disagree.
    """
    if len(seen) < MIN_PICTURES:
        raise CalibrationError(
            f"the board was detected in {len(seen)} pictures, allowed: at least {MIN_PICTURES}, "
            "from different sides (check the numbers of squares: each is one more than the number "
            "of inner corners, which tools of ROS and OpenCV count)"
        )
    corners = np.column_stack([board.corners, np.zeros(len(board.corners))])
    points = [corners[corner_ids] for corner_ids, _ in seen]
    places = [np.asarray(place, dtype=float) for _, place in seen]
    fit = _fit_equidistant if model == "equidistant" else _fit_brown_model
    matrix, bend, errors, deviation = fit(points, places, size_px, model)
    everything = np.concatenate(errors)
    error_px = float(np.sqrt(np.mean(np.sum(everything**2, axis=1))))
    if not np.all(np.isfinite(matrix)) or not error_px <= WORST_ERROR_PX:
        raise CalibrationError(
            f"corners are {error_px:.3g} px (rms) from their predicted places, allowed: up to "
            f"{WORST_ERROR_PX:g} px (check that the board is flat, and check the numbers of "
            "squares)"
        )
    if not deviation[0] <= 0.05 * matrix[0, 0]:
        raise CalibrationError(
            f"focal length is {matrix[0, 0]:.0f} +- {deviation[0]:.0f} px, allowed: a standard "
            "deviation of up to 5 % (tilt the board by 20 to 40 degrees to all sides)"
        )
    width, height = np.ptp(np.concatenate(places), axis=0) / size_px
    return LensFit(
        Lens(matrix, bend, model), size_px, error_px, tuple(errors),
        tuple(seen), deviation, (float(width), float(height)),
    )  # fmt: skip


Fit = tuple[np.ndarray, np.ndarray, list[np.ndarray], np.ndarray]
"""Result of a fit, as a tuple of four items:

- the camera matrix K (3, 3) [px],
- the distortion coefficients D (m,),
- the detected minus the computed corners (n, 2) [px] of each picture,
- the standard deviations (4 + m,) of fx, fy, cx, cy [px] and D.
"""


def _fit_brown_model(
    points: Sequence[np.ndarray], places: Sequence[np.ndarray], size_px: tuple[int, int], model: str
) -> Fit:
    """Fit a plumb_bob or rational_polynomial to points (n, 3) [m] at image points (n, 2) [px].

    If a rational polynomial folds the image, the pictures do not determine all coefficients. If the
    image folds, k6 is set to 0, then also k5, then also k3, until the image does not fold. If the
    image still folds, all coefficients are kept.
    """
    if model == "plumb_bob":
        return _fit_opencv(points, places, size_px, 5, 0)
    fits = []
    for fixed in FIXED:
        fits.append(_fit_opencv(points, places, size_px, 8, cv2.CALIB_RATIONAL_MODEL | fixed))
        matrix, bend = fits[-1][:2]
        if _maps_without_folding(Lens(matrix, bend, model), size_px):
            return fits[-1]
    return fits[0]


def _maps_without_folding(lens: Lens, size_px: tuple[int, int]) -> bool:
    """Whether a lens maps the whole image without folding it."""
    across, down = (np.linspace(0, side - 1, FOLD_GRID) for side in size_px)
    grid = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    return bool(np.all(np.isfinite(lens.straighten(grid))))


def _fit_opencv(
    points: Sequence[np.ndarray],
    places: Sequence[np.ndarray],
    size_px: tuple[int, int],
    count: int,
    flags: int,
) -> Fit:
    """Fit a lens with `count` distortion coefficients by OpenCV's calibrateCamera. `flags` are the
    flags of calibrateCamera."""
    try:
        _, matrix, bend, rotations, moves = cv2.calibrateCamera(
            [point.astype(np.float32) for point in points],
            [place.astype(np.float32).reshape(-1, 1, 2) for place in places],
            size_px, np.eye(3), np.zeros(count), flags=flags,
        )  # fmt: skip
    except cv2.error as error:
        raise CalibrationError(
            f"no lens fits the corners ({error.err}); take pictures of the board from different "
            "sides"
        ) from None
    bend = np.ravel(bend)[:count]
    errors = []
    slopes = np.zeros((2 * sum(map(len, points)), 4 + count + 6 * len(points)))
    row = 0
    for k, (point, place) in enumerate(zip(points, places, strict=True)):
        seen, slope = cv2.projectPoints(point, rotations[k], moves[k], matrix, bend)
        errors.append(place - seen.reshape(-1, 2))
        rows = slice(row, row := row + 2 * len(point))
        slopes[rows, : 4 + count] = slope[:, 6 : 10 + count]
        slopes[rows, 4 + count + 6 * k : 10 + count + 6 * k] = slope[:, :6]
    free = np.ones(slopes.shape[1], bool)
    free[4 : 4 + count] = bend != 0  # distortion coefficients that are 0 were not fitted
    deviation = np.zeros(len(free))
    deviation[free] = _parameter_deviations(slopes[:, free], np.concatenate(errors))
    return matrix, bend, errors, deviation[: 4 + count]


def _parameter_deviations(slopes: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return the standard deviations (m,) of the parameters of a least-squares fit. The standard
    deviations are computed from the derivative (n, m) and the residuals of the fit. After a failed
    fit, the standard deviations are infinite.

    With the derivative J = U S V', the deviations are s sqrt(diag(V S^-2 V')), where s^2 is the sum
    of squared residuals divided by the degrees of freedom.
    """
    if not np.all(np.isfinite(slopes)):
        return np.full(slopes.shape[1], np.inf)
    size = np.linalg.norm(slopes, axis=0)
    _, strength, axes = np.linalg.svd(slopes / size, full_matrices=False)
    strength = np.maximum(strength, WEAKEST * strength[0])
    variance = float(np.sum(errors**2)) / max(1, slopes.shape[0] - slopes.shape[1])
    return np.asarray(np.sqrt(variance * np.sum((axes / strength[:, None]) ** 2, axis=0)) / size)


def _fit_equidistant(
    points: Sequence[np.ndarray], places: Sequence[np.ndarray], size_px: tuple[int, int], model: str
) -> Fit:
    """Fit an equidistant lens by the Levenberg-Marquardt method with OpenCV's derivatives.

    The fit starts from the best of several ideal lenses with different angles of view.
    """
    starts = []
    for angle in START_ANGLES_RAD:
        focal = max(size_px) / angle
        middle = [(side - 1) / 2 for side in size_px]
        matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
        lens = Lens(matrix, np.zeros(4), model)
        poses = [
            _estimate_pose(point, lens, place) for point, place in zip(points, places, strict=True)
        ]
        start = np.concatenate([[focal, focal, *middle], np.zeros(4), *poses])
        if np.all(np.isfinite(start)):
            residual = _equidistant_errors(start, points, places)[0]
            starts.append((float(residual @ residual), start))
    if not starts:
        raise CalibrationError(
            "no equidistant lens fits the corners; take pictures of the board from different sides"
        )
    first = min(starts, key=lambda one: one[0])[1]
    found = least_squares(
        lambda x: _equidistant_errors(x, points, places)[0],
        first,
        lambda x: _equidistant_errors(x, points, places)[1],
        x_scale="jac", max_nfev=FIT_STEPS,
    )  # fmt: skip
    fx, fy, cx, cy, *bend = found.x[:8]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    ends = np.cumsum([len(point) for point in points])[:-1]
    errors = np.split(-found.fun.reshape(-1, 2), ends)
    return matrix, np.array(bend), errors, _parameter_deviations(found.jac, found.fun)[:8]


def _estimate_pose(point: np.ndarray, lens: Lens, place: np.ndarray) -> np.ndarray:
    """Return the rotation vector and translation (6,) of a board for a given lens. The result is
    NaN if there is no solution."""
    straight = lens.straighten(place)
    if not np.all(np.isfinite(straight)):
        return np.full(6, np.nan)
    found, rotation, move = cv2.solvePnP(point, straight, lens.matrix, np.zeros(4))
    return np.concatenate([rotation.ravel(), move.ravel()]) if found else np.full(6, np.nan)


def _equidistant_errors(
    values: np.ndarray, points: Sequence[np.ndarray], places: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals, which are the computed minus the detected corners (2 n,) [px], and
    their Jacobian (2 n, m).

    `values` (m,) are fx, fy, cx, cy, k1 to k4, and six numbers for the pose of each picture."""
    fx, fy, cx, cy = values[:4]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    residuals = []
    slopes = np.zeros((2 * sum(map(len, points)), len(values)))
    row = 0
    for k, (point, place) in enumerate(zip(points, places, strict=True)):
        columns = slice(8 + 6 * k, 14 + 6 * k)
        rotation, move = values[columns].reshape(2, 3)
        seen, slope = cv2.fisheye.projectPoints(point[:, None], rotation, move, matrix, values[4:8])
        residuals.append(seen.reshape(-1, 2) - place)
        rows = slice(row, row := row + 2 * len(point))
        slopes[rows, :8] = slope[:, :8]
        slopes[rows, columns] = slope[:, 8:14]
    return np.concatenate(residuals).ravel(), slopes
