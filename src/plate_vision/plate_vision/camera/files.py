"""Files of a camera: lens files (YAML of ROS's camera_calibration_parsers), pictures and videos.

`load_lens` and `save_lens` read and write lens files. `read_pictures` iterates over the pictures of
a folder or a video. Sizes are checked before the pixels are unpacked.
"""

from __future__ import annotations

import codecs
import mimetypes
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml

from plate_core import Rig
from plate_core.files import YAML_BYTES, check_file, draft, read_file
from plate_core.yaml_fields import Fields, parse_yaml

from ..errors import CalibrationError, ImageError, check_size
from .encodings import check_pixel_count, decode_picture, largest_in_file
from .foreign import is_ini, is_opencv, read_ini, read_opencv
from .headers import AS_STORED, orientation_warning, read_header
from .lens import Lens
from .other_tools import MAX_ABS, READABLE, near_key, read_other_tool

PICTURES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
"""File name suffixes of pictures."""

KINDS = "BMP, JPEG, PNG, PGM, PPM, TIFF or WebP"

PICTURE_BYTES, VIDEO_BYTES = 64_000_000, 4_000_000_000
"""Maximum size of a picture file and of a video file [bytes]. The limit for pictures allows 20
megapixels without compression. The limit for videos allows half an hour of full HD."""


NO_FILM = f"cannot be read, allowed: a video that OpenCV can decode, or a picture ({KINDS})"


def load_lens(path: str | Path, expected_px: tuple[int, int] | None = None) -> Lens:
    """Read a camera_info file, and check its image size if an expected width and height are given.

    Files of OpenCV, `.ini` files of ROS 1, messages of the topic camera_info in YAML or JSON, and
    files of Kalibr and COLMAP are also read.

    Raises
    ------
    CalibrationError
        If the file has another format, a key is missing or its value is not allowed.
    """
    fields = _read_camera_fields(Path(path))
    size_px = (fields.integer("image_width", 16, 16384), fields.integer("image_height", 16, 16384))
    if expected_px is not None:
        check_size(f"{fields.where}: image size is", size_px, expected_px, CalibrationError)
    model = fields.text("distortion_model")
    values = _read_matrix(fields.child("distortion_coefficients"), None)
    matrix = _read_matrix(fields.child("camera_matrix"), (3, 3)).reshape(3, 3)
    return Lens(matrix, values, model, fields.where)


def _read_camera_fields(path: Path) -> Fields:
    # editors of Windows begin a file with the byte order mark
    content = read_file(path, YAML_BYTES, CalibrationError).removeprefix(codecs.BOM_UTF8)
    if is_opencv(content):
        return read_opencv(content, path)
    if is_ini(content):
        return read_ini(content, path)
    if fields := read_other_tool(content, path):
        return fields
    fields = parse_yaml(content, path, CalibrationError)
    if "image_width" not in fields.data:
        raise CalibrationError(
            f"{path.name}: image_width is missing{near_key(fields)}, allowed: {READABLE}"
        )
    return fields


def save_lens(path: str | Path, camera: str, size_px: tuple[int, int], lens: Lens) -> None:
    """Write the camera_info file of a camera for images of a width and height. The file has no
    rectification: R = 1 and P = [K 0].

    Raises
    ------
    PlateError
        If the file cannot be written. After an error, an existing file is unchanged.
    """
    data = {
        "image_width": size_px[0],
        "image_height": size_px[1],
        "camera_name": camera,
        "camera_matrix": _matrix_to_yaml(lens.matrix),
        "distortion_model": lens.model,
        "distortion_coefficients": _matrix_to_yaml(lens.distortion[None]),
        "rectification_matrix": _matrix_to_yaml(np.eye(3)),
        "projection_matrix": _matrix_to_yaml(np.column_stack([lens.matrix, np.zeros(3)])),
    }
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None)
    with draft(path, "camera file") as file:
        file.write(text.encode())


def _matrix_to_yaml(matrix: np.ndarray) -> dict[str, object]:
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "data": matrix.ravel().tolist()}


def _read_matrix(fields: Fields, shape: tuple[int, int] | None) -> np.ndarray:
    """Return the values of a matrix as a flat array. If `shape` is None, the file determines the
    shape."""
    rows, columns = fields.integer("rows", 1, 16), fields.integer("cols", 1, 16)
    if shape is not None and (rows, columns) != shape:
        raise CalibrationError(
            f"{fields.where}: size is {rows} x {columns}, allowed: {shape[0]} x {shape[1]}"
        )
    return fields.array("data", (rows * columns,), -MAX_ABS, MAX_ABS)


def read_pictures(path: Path, warn: Callable[[str], None] | None = None) -> Pictures:
    """Return an iterator over pictures. The iterator yields the name of each picture and its pixels
    (H, W, 3) uint8, blue, green, red.

    Pictures are never rotated. An orientation in EXIF, PNG, TIFF, WebP or a video is ignored. A
    warning names the first picture that has an orientation. Other picture files and videos in a
    folder are skipped with a warning.

    Parameters
    ----------
    path : Path
        A folder, a picture or a video. The pictures of a folder are sorted by name. Numbers in
        names are compared as numbers, so that 2.png comes before 10.png.
    warn : callable, optional
        Called with the text of a warning. Default: print it to stderr.

    Raises
    ------
    ImageError
        If the path cannot be read, or a picture has too many pixels. The iterator can also raise
        this error.
    """
    warn = warn or _print_warning
    if path.is_dir():
        names = sorted(path.iterdir(), key=_name_with_numbers)
        files = [file for file in names if file.suffix.lower() in PICTURES]
        if not files:
            raise ImageError(f"{path}: contains no pictures, allowed: {', '.join(PICTURES)}")
        skipped = [file.name for file in names if _is_unsupported_media(file)]
        if skipped:
            more = f" and {len(skipped) - 1} more" if len(skipped) > 1 else ""
            warn(f"{path}: skipped {skipped[0]}{more}, allowed: {', '.join(PICTURES)}")
    elif not path.exists():
        raise ImageError(f"{path}: no such file or folder, allowed: pictures or a video")
    else:
        files = [path] if path.suffix.lower() in PICTURES else []
    return Pictures(path, files, warn)


def _is_unsupported_media(path: Path) -> bool:
    """Return whether a file is a video or a picture whose suffix is not in `PICTURES`."""
    suffix, kind = path.suffix.lower(), mimetypes.guess_type(path.name)[0] or ""
    is_visual = kind.startswith(("image/", "video/")) or suffix in (".heic", ".heif")
    return is_visual and suffix not in PICTURES


def _name_with_numbers(path: Path) -> tuple[list[tuple[str, int]], str]:
    """Return a key that sorts files by name, but numbers in their names by value."""
    pieces = re.findall(r"[0-9]+|[^0-9]", path.name)
    return [
        ("0", int(piece)) if piece[0].isdecimal() else (piece, 0) for piece in pieces
    ], path.name


class Pictures:
    """Iterator over the pictures of a folder or the frames of a video.

    Attributes
    ----------
    is_film : bool
    count : int
        Number of pictures or frames. For a video, the file declares this number, which may be wrong
        or 0.
    place : int
        Number of pictures that were read or skipped.
    rate : float
        Frames per second that a video's file declares, which may be wrong or 0. For pictures, the
        rate is 0.
    """

    def __init__(self, path: Path, files: Sequence[Path], warn: Callable[[str], None]) -> None:
        self._path, self._files, self._warn = path, files, warn
        self.place = 0
        self._warned = False
        self._film: cv2.VideoCapture | None = None if files else _open_film(path)
        self.is_film, self.count, self.rate = self._film is not None, len(files), 0.0
        if self._film is not None:
            self.count = max(0, int(self._film.get(cv2.CAP_PROP_FRAME_COUNT)))
            self.rate = float(self._film.get(cv2.CAP_PROP_FPS))
            deg = int(self._film.get(cv2.CAP_PROP_ORIENTATION_META))
            if deg in (90, 180, 270):  # -1 means unknown
                self._warn_once(
                    f"{path.name}: rotation of {deg} degrees is ignored. Players rotate the film; "
                    f"{AS_STORED}"
                )

    def __iter__(self) -> Pictures:
        return self

    def __next__(self) -> tuple[str, np.ndarray]:
        number = self.place
        if self._film is None:
            if number >= len(self._files):
                raise StopIteration
            file = self._files[number]
            self.place += 1
            return file.name, self._read_picture(file)
        is_read, pixels = self._film.read()
        if not is_read:
            self._end_film()
        self.place += 1
        return f"{self._path.name}: {number}", np.asarray(pixels)

    def skip(self, count: int) -> None:
        """Skip some pictures. Skipping pictures is faster than reading them."""
        for _ in range(count):
            if not (self.place < len(self._files) if self._film is None else self._film.grab()):
                return
            self.place += 1

    def _end_film(self) -> None:
        if self.place == 0:
            raise ImageError(f"{self._path}: {NO_FILM}")
        raise StopIteration

    def _read_picture(self, file: Path) -> np.ndarray:
        content = read_file(file, PICTURE_BYTES, ImageError)
        header = read_header(content)
        if header is not None:
            check_pixel_count(header.width, header.height, f"{file}:")
            if text := orientation_warning(header):
                self._warn_once(f"{file.name}: {text}")
        pixels = decode_picture(content, cv2.IMREAD_COLOR, header)
        if pixels is None:
            raise ImageError(f"{file}: cannot be read, allowed: a complete picture ({KINDS})")
        largest = None if self._warned else largest_in_file(content)
        if largest and largest.bit_length() < 16:
            self._warn_once(
                f"{file.name}: only {largest.bit_length()} of its 16 bits are used, so it is "
                "read as a dark picture; multiply its numbers so that they use 16 bits"
            )
        return pixels

    def _warn_once(self, text: str) -> None:
        if not self._warned:
            self._warned = True
            more = " (this applies to all pictures)" if len(self._files) > 1 else ""
            self._warn(text + more)


def _print_warning(text: str) -> None:
    print(f"warning: {text}", file=sys.stderr)


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write a picture (H, W) or (H, W, 3) uint8 in the format of the file name's suffix.

    Raises
    ------
    ImageError
        If the file cannot be written.
    """
    try:
        done = cv2.imwrite(str(path), picture)
    except cv2.error:  # OpenCV raises this for an unknown suffix
        done = False
    if not done:
        raise ImageError(
            f"{path}: cannot be written, allowed: {', '.join(PICTURES)}, in an existing folder"
        )


def rig_of_picture(rig: Rig, size_px: tuple[int, int]) -> tuple[Rig, str]:
    """Return the rig adapted to pictures of a size (width, height), and a message for the user.

    If the pictures have the size of the rig's camera images, the rig is unchanged and the message
    is empty. For another size, the camera's pose is unknown. The function then assumes a view from
    straight above and a plate that fills the picture and has the length of the rig's plate.
    """
    camera = rig.camera
    if size_px == (camera.width_px, camera.height_px):
        return rig, ""
    width, height = size_px
    corners = ((-0.5, height - 0.5), (width - 0.5, height - 0.5), (width - 0.5, -0.5), (-0.5, -0.5))
    plate = replace(rig.plate, width_m=rig.plate.length_m * height / width)
    text = (
        f"size is {width} x {height} px, but the rig's camera has {camera.width_px} x "
        f"{camera.height_px} px. The picture is used as a view from straight above, filled by a "
        f"plate of {plate.length_m:g} x {plate.width_m:.3g} m; the rig's plate has "
        f"{rig.plate.length_m:g} x {rig.plate.width_m:g} m. If this is wrong, crop the picture at "
        "the plate's edges, and set the plate's length_m in the rig file; or set width_px, "
        "height_px and corners_px of the picture's camera in the rig file"
    )
    camera = replace(camera, width_px=width, height_px=height, corners_px=corners, lens=None)
    return replace(rig, plate=plate, camera=camera), text


def _open_film(path: Path) -> cv2.VideoCapture:
    check_file(path, VIDEO_BYTES, ImageError)
    film = cv2.VideoCapture(str(path))
    if not film.isOpened():
        raise ImageError(f"{path}: {NO_FILM}")
    film.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    size = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    width, height = (int(film.get(side)) for side in size)
    check_pixel_count(width, height, f"{path}:")
    return film
