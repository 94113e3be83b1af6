"""Camera calibrations as YAML files, as ROS's camera_calibration_parsers and camera drivers use."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from plate_core.yaml_fields import Fields, read_yaml

from .calibration import Lens
from .errors import CalibrationError

MODELS = {4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial"}
"""Names of distortion models, by their number of parameters."""

FAR = 1e6
"""Greatest number that is believed in such a file."""


@dataclass(frozen=True, eq=False)
class CameraFile:
    """What such a file says.

    Attributes
    ----------
    name : str
        Of the camera.
    size_px : (int, int)
        Width and height of its images.
    lens : Lens
    """

    name: str
    size_px: tuple[int, int]
    lens: Lens


def load_camera(path: str | Path, expected_px: tuple[int, int] | None = None) -> CameraFile:
    """Read a camera_info file, for images of the expected width and height if these are given.

    Raises
    ------
    CalibrationError
        If a key is missing or its value is not allowed.
    """
    fields = read_yaml(path, CalibrationError)
    size_px = (fields.integer("image_width", 16, 16384), fields.integer("image_height", 16, 16384))
    if expected_px is not None and size_px != expected_px:
        raise CalibrationError(
            f"{fields.where}: image size is {size_px[0]} x {size_px[1]} px, allowed: "
            f"{expected_px[0]} x {expected_px[1]} px"
        )
    model = fields.text("distortion_model", sorted(set(MODELS.values())))
    values = _matrix(fields.child("distortion_coefficients"), None)
    if MODELS.get(len(values)) != model:
        counts = " or ".join(str(n) for n, name in MODELS.items() if name == model)
        raise CalibrationError(
            f"{fields.where}: {len(values)} distortion_coefficients, allowed: {counts} for {model}"
        )
    matrix = _matrix(fields.child("camera_matrix"), (3, 3)).reshape(3, 3)
    name = fields.text("camera_name") if fields.has("camera_name") else "camera"
    return CameraFile(name, size_px, Lens(matrix, values))


def save_camera(path: str | Path, camera: CameraFile) -> None:
    """Write a camera_info file: no rectification (R = 1), P = [K 0]."""
    matrix = np.asarray(camera.lens.matrix, dtype=float)
    bend = np.ravel(camera.lens.distortion).astype(float)
    data = {
        "image_width": camera.size_px[0],
        "image_height": camera.size_px[1],
        "camera_name": camera.name,
        "camera_matrix": _block(matrix),
        "distortion_model": MODELS[len(bend)],
        "distortion_coefficients": _block(bend[None]),
        "rectification_matrix": _block(np.eye(3)),
        "projection_matrix": _block(np.column_stack([matrix, np.zeros(3)])),
    }
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None)
    Path(path).write_text(text, encoding="utf-8")


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
