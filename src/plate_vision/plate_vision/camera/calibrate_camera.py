"""The program `calibrate`: fit a camera's lens to pictures, and draw boards and markers.

The program does not need ROS. Example:

ros2 run plate_vision calibrate lens PICTURES --board 9x7 --square 0.03 --marker 0.022
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from plate_core import PlateError, load_rig, piped
from plate_core.rig import LENS_MODELS

from ..drawing import draw_errors
from ..errors import CalibrationError, check_size
from ..plate.home import fiducials_of, find_home
from .boards import (
    MIN_PICTURES,
    Board,
    Corners,
    LensFit,
    choose_pictures,
    draw_board,
    find_board,
    fit_lens,
)
from .files import Pictures, load_lens, read_pictures, save_lens, write_picture
from .lens import lens_keys, rig_lens
from .markers import draw_marker

PRINT_DPI = 300
"""Resolution of printed boards and markers [dots per inch]."""

INCH_M = 0.0254

FRAMES_SEARCHED, PICTURES_SEARCHED = 60, 240
"""Number of frames of a film, and number of pictures of a folder, that the program searches at
first without gaps. After that, the program searches only every second picture. After the same
number of searches, the program continues with every fourth picture, and so on. In total, about 250
of 1000 frames or 440 of 10,000 frames are searched."""

FRAMES_PER_LINE = 50
"""Number of searched frames between two progress lines, if the output is not a terminal."""

BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE = ("k1", "k2", "k3", "k4")
"""Names of the distortion coefficients of an equidistant lens."""


@piped()
def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line. If there is an error, print it in one line and exit with code 2."""
    args = _make_parser().parse_args(arguments)
    try:
        args.run(args)
    except BrokenPipeError:
        raise
    except (PlateError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="calibrate", description=(__doc__ or "").partition("\n")[0]
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    lens = commands.add_parser("lens", help="calibrate the lens with pictures of a board")
    lens.add_argument("pictures", type=Path, help="folder of pictures, or a video file")
    _add_board_options(lens)
    lens.add_argument(
        "--model", choices=tuple(LENS_MODELS), default="plumb_bob",
        help="distortion model: plumb_bob for normal lenses, rational_polynomial for wide lenses, "
        "equidistant for fisheyes (default: plumb_bob)",
    )  # fmt: skip
    lens.add_argument("--name", default="camera", help="name of the camera (default: camera)")
    lens.add_argument(
        "--out",
        type=Path,
        default=Path("camera.yaml"),
        help="camera_info file to write (default: camera.yaml)",
    )
    lens.add_argument(
        "--errors",
        type=Path,
        default=Path("errors.png"),
        help="picture of the errors to write (default: errors.png)",
    )
    lens.set_defaults(run=_calibrate_lens)
    board = commands.add_parser("board", help="draw a board to print")
    _add_board_options(board)
    board.add_argument("--out", type=Path, default=Path("board.png"))
    board.set_defaults(run=_write_board)
    markers = commands.add_parser("markers", help="draw the markers of the plate to print")
    markers.add_argument("--rig-file", default="", help="rig file with fiducials")
    markers.add_argument(
        "--out", type=Path, default=Path("."), help="folder for the pictures of the markers"
    )
    markers.set_defaults(run=_write_markers)
    home = commands.add_parser("home", help="find the plate's corners in pictures with markers")
    home.add_argument("pictures", type=Path, help="folder of pictures of the plate at rest")
    home.add_argument("--rig-file", default="", help="rig file with fiducials")
    home.add_argument(
        "--camera",
        type=Path,
        help="camera_info file of the lens (default: the lens in the rig file)",
    )
    home.set_defaults(run=_calibrate_home)
    return parser


def _add_board_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--board",
        type=_parse_board_size,
        required=True,
        metavar="9x7",
        help="numbers of squares along x and y",
    )
    add("--square", type=float, required=True, metavar="M", help="side of a square [m]")
    add(
        "--marker",
        type=float,
        default=0.0,
        metavar="M",
        help="side of a ChArUco marker [m]; 0 for a chessboard (default: 0)",
    )
    add("--dictionary", default="5X5_100", help="set of markers (default: 5X5_100)")


def _parse_board_size(text: str) -> tuple[int, int]:
    columns, _, rows = text.partition("x")
    try:
        return int(columns), int(rows)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"board is {text!r}, allowed: the numbers of squares along x and y, such as 9x7"
        ) from None


def _make_board(args: argparse.Namespace) -> Board:
    columns, rows = args.board
    return Board(columns, rows, args.square, args.marker, args.dictionary)


def _calibrate_lens(args: argparse.Namespace) -> None:
    board = _make_board(args)
    pictures = read_pictures(args.pictures)
    board, seen, size_px = _find_boards(pictures, board)
    if board.white_first:
        print("the board's first square is white, as in OpenCV versions before 4.6")
    chosen = choose_pictures(seen, board)
    if len(chosen) < len(seen):
        print(f"the lens is fitted to the {len(chosen)} pictures that differ most")
    fit = fit_lens(board, [seen[k] for k in chosen], size_px, args.model)
    print(_fit_summary(fit))
    save_lens(args.out, args.name, size_px, fit.lens)
    write_picture(args.errors, draw_errors(fit))
    print(f"written: {args.out} (camera_info file), {args.errors} (errors of the corners)")


def _find_boards(pictures: Pictures, board: Board) -> tuple[Board, list[Corners], tuple[int, int]]:
    """Search for the board in pictures of one size. In a long film or a large folder, an increasing
    number of pictures is skipped (`FRAMES_SEARCHED`). Return the board as it is printed, its
    corners in each picture that shows it, and the size of the pictures [px]."""
    searched = FRAMES_SEARCHED if pictures.is_film else PICTURES_SEARCHED
    progress = Progress(pictures)
    seen: list[Corners] = []
    size_px = (0, 0)
    unlike: CalibrationError | None = None
    for name, picture in pictures:
        found_px = (picture.shape[1], picture.shape[0])
        if size_px not in ((0, 0), found_px):
            why = " as in the previous picture"
            check_size(f"{name}: size is", found_px, size_px, CalibrationError, why)
        size_px = found_px
        corners = None
        try:
            grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            board, corners = find_board(grey, board, fast=pictures.is_film)
        except CalibrationError as error:
            unlike = error
        if corners is not None:
            seen.append(corners)
        progress.searched(name, 0 if corners is None else len(corners[0]), len(board.corners))
        pictures.skip(2 ** (progress.count // searched) - 1)
    progress.end()
    if unlike is not None and len(seen) < MIN_PICTURES:
        raise unlike
    return board, seen, size_px


class Progress:
    """Prints the progress of the search and the totals at the end. For a folder, one line per
    picture is printed. For a film, one line is updated on a terminal. If the output is not a
    terminal, a line is printed every `FRAMES_PER_LINE` frames."""

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self._changes = pictures.is_film and sys.stderr.isatty()
        self.count = self._detected = 0

    def searched(self, name: str, corners: int, of: int) -> None:
        """Count a picture with the number of corners that were found in it, and print the
        progress."""
        self.count += 1
        self._detected += corners > 0
        if not self._pictures.is_film:
            print(f"{name}: {corners} of {of} corners", flush=True)
        elif self._changes:
            print(f"\r{self._progress_text()}", end="", file=sys.stderr, flush=True)
        elif self.count % FRAMES_PER_LINE == 0:
            print(self._progress_text(), flush=True)

    def end(self) -> None:
        """Print the totals."""
        if self._changes:
            print(file=sys.stderr)
        elif self._pictures.is_film or self.count < self._pictures.count:
            print(self._progress_text())

    def _progress_text(self) -> str:
        read, count = self._pictures.place, self._pictures.count
        of = f" of {count}" if count >= read else ""
        kind = "frames" if self._pictures.is_film else "pictures"
        return f"{read}{of} {kind} read, {self.count} searched, board detected in {self._detected}"


def _fit_summary(fit: LensFit) -> str:
    matrix, deviation, lens = fit.lens.matrix, fit.deviation, fit.lens
    values = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *lens.distortion]
    coefficient_names = FISHEYE if lens.model == "equidistant" else BROWN
    names = ["fx", "fy", "cx", "cy", *coefficient_names[: len(lens.distortion)]]
    lines = [f"{n} = {v:.5g} +- {s:.2g}" for n, v, s in zip(names, values, deviation, strict=True)]
    lines.append(f"error of the corners {fit.error_px:.3f} px rms in {len(fit.errors)} pictures")
    if fit.warning:
        lines.append(f"warning: {fit.warning}")
    lines.append("for the rig file, section camera:")
    lines += [f"  {key}: {value}" for key, value in lens_keys(lens).items()]
    return "\n".join(lines)


def _write_board(args: argparse.Namespace) -> None:
    board = _make_board(args)
    square_px = round(board.square_m / INCH_M * PRINT_DPI)
    write_picture(args.out, draw_board(board, square_px))
    side_mm = f"{1e3 * board.square_m:g} mm"
    print(f"written: {args.out}; print it at {PRINT_DPI} dpi to get squares of {side_mm}")


def _write_markers(args: argparse.Namespace) -> None:
    fiducials = fiducials_of(load_rig(args.rig_file))
    args.out.mkdir(parents=True, exist_ok=True)
    side_px = round(fiducials.side_m / INCH_M * PRINT_DPI)
    for number in fiducials.numbers:
        picture = np.pad(
            draw_marker(fiducials.dictionary, number, side_px), side_px // 4, constant_values=255
        )
        path = args.out / f"marker_{number}.png"
        write_picture(path, picture)
        side_mm = f"{1e3 * fiducials.side_m:g} mm"
        print(f"written: {path}; print it at {PRINT_DPI} dpi to get a side of {side_mm}")


def _calibrate_home(args: argparse.Namespace) -> None:
    rig = load_rig(args.rig_file)
    fiducials = fiducials_of(rig)
    size_px = (rig.camera.width_px, rig.camera.height_px)
    lens = rig_lens(rig) if args.camera is None else load_lens(args.camera, size_px)
    corners = []
    for name, picture in read_pictures(args.pictures):
        why = ", width_px and height_px of the rig file"
        check_size(f"{name}:", picture.shape[1::-1], size_px, CalibrationError, why)
        calibration, error = find_home(picture, fiducials, lens)
        corners.append(calibration.to_image(rig.plate.corners))
        print(f"{name}: error of the markers' corners {1e3 * error:.3f} mm rms")
    mean = np.mean(corners, axis=0)
    print("for the rig file, section camera:")
    print(f"  corners_px: [{', '.join(f'[{x:.2f}, {y:.2f}]' for x, y in mean)}]")


if __name__ == "__main__":
    main()
