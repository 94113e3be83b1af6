"""A folder of pictures, one picture, or a video file, as a camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from plate_core import Rig

from .errors import ImageError

PICTURES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
"""Endings of pictures."""


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
    elif path.is_file():
        files = [path] if path.suffix.lower() in PICTURES else []
    else:
        raise ImageError(f"{path}: no such file or folder, allowed: pictures or a video")
    for file in files:
        yield file.name, _read(file)
    if not files:
        yield from _film(path)


def rig_of_picture(rig: Rig, size_px: tuple[int, int]) -> Rig:
    """Return the rig whose camera takes pictures of a size (width, height).

    If that is not the size of the rig's camera, nothing is known of where the picture was taken:
    then it is a view of a plate that fills it, from straight above, as long as the rig's.
    """
    camera = rig.camera
    if size_px == (camera.width_px, camera.height_px):
        return rig
    width, height = size_px
    corners = ((-0.5, height - 0.5), (width - 0.5, height - 0.5), (width - 0.5, -0.5), (-0.5, -0.5))
    plate = replace(rig.plate, width_m=rig.plate.length_m * height / width)
    camera = replace(camera, width_px=width, height_px=height, corners_px=corners, lens=None)
    return replace(rig, plate=plate, camera=camera)


def _read(file: Path) -> np.ndarray:
    try:
        pixels = cv2.imread(str(file), cv2.IMREAD_COLOR)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise ImageError(f"{file}: cannot be read, allowed: a whole picture")
    return np.asarray(pixels)


def _film(path: Path) -> Iterator[tuple[str, np.ndarray]]:
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
