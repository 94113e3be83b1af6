"""Camera files of Kalibr and COLMAP, and camera_info messages, converted to the keys of a camera
file. The module also recognises formats that cannot be read, and its errors name them.

A format is read only if the meaning of each number is certain: the lens model, the order of the
coefficients, and the origin of the pixel coordinates. Here, the origin is the centre of the first
pixel.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from plate_core import PlateError, did_you_mean
from plate_core.yaml_fields import Fields, parse_yaml

from ..errors import CalibrationError
from .regions import Region

READABLE = (
    "a camera file of ROS (YAML, or .ini of ROS 1), of OpenCV, of Kalibr (camchain.yaml) or of "
    "COLMAP (cameras.txt), or a camera_info message (YAML or JSON)"
)
"""Formats that `load_lens` reads, for messages."""

BY_HAND = (
    "write K, D, distortion_model and the image size into a camera file of ROS, or calibrate with: "
    "ros2 run plate_vision calibrate lens PICTURES"
)
"""Remedy if a format cannot be read."""

MATLAB = (
    "in MATLAB, [K, D] = cameraIntrinsicsToOpenCV(cameraParams) gives K and D (plumb_bob); "
    + BY_HAND
)

KALIBR_MODELS = {"radtan": "plumb_bob", "equidistant": "equidistant", "none": "plumb_bob"}
"""Distortion models of Kalibr, and their names in ROS. The formulas and the order of the values are
equal."""

COLMAP_LINE = re.compile(r"\d+\s+([A-Z][A-Z_]+)\s+(\d+)\s+(\d+)((?:\s+[-+.\deE]+)+)")
"""Line of a camera in cameras.txt: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]."""

COLMAP_MODELS = {
    "SIMPLE_PINHOLE": ("f cx cy", "plumb_bob", 0),
    "PINHOLE": ("fx fy cx cy", "plumb_bob", 0),
    "SIMPLE_RADIAL": ("f cx cy", "plumb_bob", 1),
    "RADIAL": ("f cx cy", "plumb_bob", 2),
    "OPENCV": ("fx fy cx cy", "plumb_bob", 4),
    "OPENCV_FISHEYE": ("fx fy cx cy", "equidistant", 4),
    "FULL_OPENCV": ("fx fy cx cy", "rational_polynomial", 8),
}
"""Camera models of COLMAP: first parameters, distortion model, and number of coefficients. The
missing coefficients of plumb_bob are zero."""

COLMAP_ORIGIN_PX = 0.5
"""COLMAP's coordinate of the centre of the first pixel [px]."""

PLUMB_BOB = 4
"""Minimum number of coefficients of plumb_bob."""

MAX_ABS = 1e6
"""Maximum magnitude of a number in a lens file."""

MESSAGE = {"width", "height", "distortion_model", "d", "k"}
"""Fields of a camera_info message, in lower case. In ROS 1, D and K are in upper case."""

MARKS = (
    (b"MATLAB ", f"format is a .mat file of MATLAB, allowed: {READABLE}; {MATLAB}"),
    (b"\x89HDF", f"format is HDF5, as in .mat files of MATLAB, allowed: {READABLE}; {MATLAB}"),
    (b"PK\x03\x04", f"format is a ZIP archive, as .npz of numpy, allowed: {READABLE}; {BY_HAND}"),
    (b"\x93NUMPY", f"format is .npy of numpy, allowed: {READABLE}; {BY_HAND}"),
    (b"\x80\x04", f"format is a pickle of Python, allowed: {READABLE}; {BY_HAND}"),
)
"""First bytes of files that cannot be read, and the messages."""


def read_other_tool(content: bytes, path: Path) -> Fields | None:
    """Return the camera parameters in a file of another program, as keys of a camera file. Return
    None if the file may be a camera file of ROS.

    Raises
    ------
    CalibrationError
        If the format is recognised, but the file cannot be read.
    """
    for mark, problem in MARKS:
        if content.startswith(mark):
            raise CalibrationError(f"{path.name}: {problem}")
    text = content.decode("utf-8", "replace").lstrip("\ufeff \t\r\n")
    if text.startswith("<"):
        name = found[1] if (found := re.search(r"<([A-Za-z_][\w.-]*)", text)) else "unknown"
        raise CalibrationError(
            f"{path.name}: format is XML with the element {name[:50]}, allowed: {READABLE}; "
            f"{BY_HAND}"
        )
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and line[0] != "#"]
    if lines and COLMAP_LINE.fullmatch(lines[0]):
        return _read_colmap(lines, path)
    data = _mapping_of(content, text, path)
    if data is None:
        return None
    if kalibr := _kalibr_cameras(data):
        return _read_kalibr(kalibr, path)
    if _is_message(data):
        return _read_message(data, path)
    _refuse_known(data, path)
    return None


def near_key(fields: Fields) -> str:
    """Return a hint to a key of the file that resembles `image_width`, or an empty text."""
    near = next((str(key) for key in fields.data if did_you_mean(str(key), ["image_width"])), "")
    return f" (the file has {near[:50]})" if near else ""


def _mapping_of(content: bytes, text: str, path: Path) -> Mapping[str, Any] | None:
    """Return the mapping that a YAML or JSON file contains. `ros2 topic echo` writes `---` after
    each message; only the first message is read. Return None if there is no mapping."""
    first = re.split(r"^---\s*$", text.removeprefix("---"), maxsplit=1, flags=re.MULTILINE)[0]
    try:
        return parse_yaml(first.encode(), path, CalibrationError).data
    except PlateError:
        return None


def _read_colmap(lines: Sequence[str], path: Path) -> Fields:
    found = COLMAP_LINE.fullmatch(lines[0])
    if len(lines) > 1 or found is None:
        raise CalibrationError(
            f"{path.name}: contains {len(lines)} cameras of COLMAP, allowed: a file with one camera"
        )
    name, width, height = found[1], int(found[2]), int(found[3])
    if name not in COLMAP_MODELS:
        raise CalibrationError(
            f"{path.name}: camera model of COLMAP is {name}, allowed: {', '.join(COLMAP_MODELS)}"
        )
    names, model, count = COLMAP_MODELS[name]
    first = names.split()
    values = [float(word) for word in found[4].split()]
    if len(values) != len(first) + count:
        raise CalibrationError(
            f"{path.name}: {name} has {len(values)} parameters, allowed: {len(first) + count}"
        )
    given = dict(zip(first, values, strict=False))
    fx, fy = given.get("fx", given.get("f")), given.get("fy", given.get("f"))
    matrix = [
        *(fx, 0.0, given["cx"] - COLMAP_ORIGIN_PX),
        *(0.0, fy, given["cy"] - COLMAP_ORIGIN_PX),
        *(0.0, 0.0, 1.0),
    ]
    distortion = values[len(first) :]
    distortion += [0.0] * (PLUMB_BOB - len(distortion))
    return _camera_file(path, (width, height), matrix, distortion, model)


def _kalibr_cameras(data: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the cameras of a Kalibr file. A file of a single camera may have no level `cam0`."""
    if "camera_model" in data and "intrinsics" in data:
        return {"cam0": data}
    return {
        key: value
        for key, value in data.items()
        if isinstance(value, Mapping) and "camera_model" in value and "intrinsics" in value
    }


def _read_kalibr(cameras: Mapping[str, Mapping[str, Any]], path: Path) -> Fields:
    if len(cameras) > 1:
        raise CalibrationError(
            f"{path.name}: contains the cameras {', '.join(cameras)} of Kalibr, allowed: a file "
            "with one camera; copy the block of your camera into a file"
        )
    ((name, data),) = cameras.items()
    fields = Fields(data, f"{path.name}: {name}", CalibrationError)
    fields.text("camera_model", ["pinhole"])
    model = KALIBR_MODELS[fields.text("distortion_model", list(KALIBR_MODELS))]
    fx, fy, cx, cy = fields.array("intrinsics", (4,), -MAX_ABS, MAX_ABS).tolist()
    values = fields.array("distortion_coeffs", (None,), -MAX_ABS, MAX_ABS).tolist()
    width, height = fields.array("resolution", (2,), 1, MAX_ABS).tolist()
    matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    return _camera_file(path, (int(width), int(height)), matrix, values, model)


def _is_message(data: Mapping[str, Any]) -> bool:
    return {str(key).lower() for key in data} >= MESSAGE


def _read_message(data: Mapping[str, Any], path: Path) -> Fields:
    """Return the lens of a camera_info message, as `ros2 topic echo camera_info` prints it."""
    spelt = {str(key).lower(): value for key, value in data.items()}
    fields = Fields(spelt, path.name, CalibrationError)
    full = fields.integer("width", 1, 65536), fields.integer("height", 1, 65536)
    binning = tuple(fields.integer(f"binning_{axis}", 0, 64, 0) for axis in "xy")
    matrix = fields.array("k", (9,), -MAX_ABS, MAX_ABS).reshape(3, 3)
    if not matrix[0, 0]:
        raise CalibrationError(
            f"{path.name}: K is zero, because the camera of this message is not calibrated, "
            "allowed: a calibrated camera"
        )
    offset, size = (0, 0), (0, 0)
    if fields.has("roi"):
        roi = fields.child("roi")
        offset = roi.integer("x_offset", 0, 65536, 0), roi.integer("y_offset", 0, 65536, 0)
        size = roi.integer("width", 0, 65536, 0), roi.integer("height", 0, 65536, 0)
    try:
        region = Region(full, offset, size, (binning[0], binning[1]))
    except CalibrationError as error:
        raise CalibrationError(f"{path.name}: {error}") from None
    values = fields.array("d", (None,), -MAX_ABS, MAX_ABS).tolist()
    sent = region.matrix(matrix).ravel().tolist()
    return _camera_file(path, region.size_px, sent, values, fields.text("distortion_model"))


def _refuse_known(data: Mapping[str, Any], path: Path) -> None:
    """Raise an error if the file has keys of a known format that cannot be read."""
    keys = {str(key) for key in data}
    if {"RadialDistortion", "TangentialDistortion"} & keys or "cameraParams" in keys:
        raise CalibrationError(
            f"{path.name}: format is cameraParameters of MATLAB, allowed: {READABLE}; {MATLAB}"
        )
    if {"ppx", "ppy"} <= keys:
        raise CalibrationError(
            f"{path.name}: format is intrinsics of librealsense, whose distortion can be inverse, "
            f"allowed: {READABLE}; the node realsense2_camera publishes camera_info, or {BY_HAND}"
        )


def _camera_file(
    path: Path,
    size_px: tuple[int, int],
    matrix: Sequence[float | None],
    distortion: Sequence[float],
    model: str,
) -> Fields:
    """Return these camera parameters under the keys of a camera file."""
    data = {
        "image_width": size_px[0],
        "image_height": size_px[1],
        "camera_matrix": {"rows": 3, "cols": 3, "data": list(matrix)},
        "distortion_model": model,
        # a matrix needs at least one column; the value 0 means no distortion
        "distortion_coefficients": {
            "rows": 1,
            "cols": max(1, len(distortion)),
            "data": list(distortion) or [0.0],
        },
    }
    return Fields(data, path.name, CalibrationError)
