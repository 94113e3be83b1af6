"""Lenses as YAML files, as ROS's camera_calibration_parsers and camera drivers use; and pictures or
a video in place of a camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml

from plate_core import Rig
from plate_core.files import check_file, draft, read_file
from plate_core.yaml_fields import Fields, read_yaml

from ..errors import CalibrationError, ImageError, check_size
from .encodings import unpack
from .lens import LENS_MODELS, Lens

FAR = 1e6
"""Greatest number that is believed in such a file."""


PICTURES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
"""Endings of pictures."""

PICTURE_BYTES, VIDEO_BYTES = 64_000_000, 4_000_000_000
"""Most in a file: 20 megapixels without compression; half an hour of full HD."""


def load_lens(path: str | Path, expected_px: tuple[int, int] | None = None) -> Lens:
    """Read a camera_info file, for images of the expected width and height if these are given.

    Raises
    ------
    CalibrationError
        If a key is missing or its value is not allowed.
    """
    fields = read_yaml(path, CalibrationError)
    size_px = (fields.integer("image_width", 16, 16384), fields.integer("image_height", 16, 16384))
    if expected_px is not None:
        check_size(f"{fields.where}: image size is", size_px, expected_px, CalibrationError)
    model = fields.text("distortion_model", sorted(set(LENS_MODELS.values())))
    values = _matrix(fields.child("distortion_coefficients"), None)
    if LENS_MODELS.get(len(values)) != model:
        counts = " or ".join(str(n) for n, name in LENS_MODELS.items() if name == model)
        raise CalibrationError(
            f"{fields.where}: {len(values)} distortion_coefficients, allowed: {counts} for {model}"
        )
    return Lens(_matrix(fields.child("camera_matrix"), (3, 3)).reshape(3, 3), values)


def save_lens(path: str | Path, camera: str, size_px: tuple[int, int], lens: Lens) -> None:
    """Write the camera_info file of a camera, with images of a width and height: no rectification
    (R = 1), P = [K 0].

    Raises
    ------
    PlateError
        If it cannot be written: what was there stays.
    """
    data = {
        "image_width": size_px[0],
        "image_height": size_px[1],
        "camera_name": camera,
        "camera_matrix": _block(lens.matrix),
        "distortion_model": LENS_MODELS[len(lens.distortion)],
        "distortion_coefficients": _block(lens.distortion[None]),
        "rectification_matrix": _block(np.eye(3)),
        "projection_matrix": _block(np.column_stack([lens.matrix, np.zeros(3)])),
    }
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None)
    with draft(path, "camera file") as file:
        file.write(text.encode())


def _block(matrix: np.ndarray) -> dict[str, object]:
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "data": matrix.ravel().tolist()}


def _matrix(fields: Fields, shape: tuple[int, int] | None) -> np.ndarray:
    """Return the numbers of a matrix; of one row if no shape is given."""
    rows, columns = fields.integer("rows", 1, 16), fields.integer("cols", 1, 16)
    if shape is not None and (rows, columns) != shape:
        raise CalibrationError(
            f"{fields.where}: {rows} x {columns}, allowed: {shape[0]} x {shape[1]}"
        )
    return fields.array("data", (rows * columns,), -FAR, FAR)


def read_pictures(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and pixels (H, W, 3) uint8, blue, green, red, of each picture.

    Parameters
    ----------
    path : Path
        A folder, of which pictures are taken by their names; a picture; or a video.

    Raises
    ------
    ImageError
        If there is nothing at the path that can be read.
    """
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURES)
        if not files:
            raise ImageError(f"{path}: no pictures in it, allowed: {', '.join(PICTURES)}")
    elif not path.exists():
        raise ImageError(f"{path}: no such file or folder, allowed: pictures or a video")
    else:
        files = [path] if path.suffix.lower() in PICTURES else []
    for file in files:
        yield file.name, _read(file)
    if not files:
        yield from _film(path)


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write a picture (H, W) or (H, W, 3) uint8 of the kind that its ending says.

    Raises
    ------
    ImageError
        If it cannot be written.
    """
    try:
        done = cv2.imwrite(str(path), picture)
    except cv2.error:  # of no kind that it knows
        done = False
    if not done:
        raise ImageError(
            f"{path}: cannot be written, allowed: {', '.join(PICTURES)}, in a folder that is there"
        )


def rig_of_picture(rig: Rig, size_px: tuple[int, int]) -> tuple[Rig, str]:
    """Return the rig whose camera takes pictures of a size (width, height), and what a user should
    know of that; nothing if it is the rig's own camera.

    If that is not the size of the rig's camera, nothing is known of where the picture was taken:
    then it is a view of a plate that fills it, from straight above, as long as the rig's.
    """
    camera = rig.camera
    if size_px == (camera.width_px, camera.height_px):
        return rig, ""
    width, height = size_px
    corners = ((-0.5, height - 0.5), (width - 0.5, height - 0.5), (width - 0.5, -0.5), (-0.5, -0.5))
    plate = replace(rig.plate, width_m=rig.plate.length_m * height / width)
    text = (
        f"{width} x {height} px, not {camera.width_px} x {camera.height_px} px as the rig's "
        f"camera: taken for a view from above of a plate of {plate.length_m:g} x "
        f"{plate.width_m:.3g} m that fills it; the rig's is {rig.plate.length_m:g} x "
        f"{rig.plate.width_m:g} m. If this is wrong: cut the picture at the plate's edges, and "
        "write length_m of what it shows into the rig file; or, of the camera that took it, "
        "width_px, height_px and corners_px"
    )
    camera = replace(camera, width_px=width, height_px=height, corners_px=corners, lens=None)
    return replace(rig, plate=plate, camera=camera), text


def _read(file: Path) -> np.ndarray:
    pixels = unpack(read_file(file, PICTURE_BYTES, ImageError), cv2.IMREAD_COLOR)
    if pixels is None:
        raise ImageError(f"{file}: cannot be read, allowed: a whole picture")
    return pixels


def _film(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    check_file(path, VIDEO_BYTES, ImageError)
    film = cv2.VideoCapture(str(path))
    try:
        number = 0
        while True:
            there, pixels = film.read()
            if not there:
                break
            yield f"{path.name}: {number}", np.asarray(pixels)
            number += 1
    finally:
        film.release()
    if number == 0:
        raise ImageError(f"{path}: cannot be read, allowed: a video that OpenCV knows")
