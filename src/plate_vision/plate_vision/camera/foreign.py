"""Camera files of OpenCV and of ROS 1, converted to the keys of a camera_info file.

The module supports files of OpenCV's cv::FileStorage and `.ini` files of ROS 1 (`ost.txt`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2

from plate_core.yaml_fields import Fields, parse_yaml

from ..errors import CalibrationError

OPENCV = b"%YAML:1.0"
"""First bytes of files that cv::FileStorage writes up to OpenCV 4. Version 5 writes standard
YAML."""

OPENCV_XML = b"<opencv_storage>"
"""First element of XML files that cv::FileStorage writes."""

MATRIX = re.compile(rb"!!opencv-[a-z-]+")
"""Tag of a matrix in YAML files of cv::FileStorage. JSON files have `type_id` instead."""

NAMES = {
    "image_width": ("imagewidth", "width"),
    "image_height": ("imageheight", "height"),
    "camera_matrix": ("cameramatrix", "intrinsics", "k", "mtx"),
    "distortion_coefficients": ("distortioncoefficients", "distcoeffs", "dist", "d"),
}
"""Keys of a camera_info file, and their names in OpenCV's programs, without `_`."""

FISHEYE = 4
"""Number of coefficients of a fisheye lens. A plumb_bob lens can have the same number."""

BLOCKS = {"camera matrix": (3, 3), "distortion": (1, None)}
"""Blocks of an `.ini` file that are read, with their shapes."""


def is_ini(content: bytes) -> bool:
    """Whether a file is an `.ini` file of ROS 1's camera_calibration_parsers. Such a file begins
    with `[image]`."""
    lines = (line.strip() for line in content.splitlines())
    first = next((line for line in lines if line and line[:1] not in (b"#", b";")), b"")
    return first == b"[image]"


def is_opencv(content: bytes) -> bool:
    """Whether a file was written by cv::FileStorage."""
    marks = (OPENCV_XML, b"opencv-matrix", b"opencv-nd")
    return content.startswith(OPENCV) or any(mark in content for mark in marks)


def read_opencv(content: bytes, path: Path) -> Fields:
    """Return the camera parameters in a file of cv::FileStorage.

    If `distortion_model` is missing, the model is determined from the number of coefficients and
    from `fisheye_model`, which OpenCV's example program writes.

    Raises
    ------
    CalibrationError
        If the file is malformed, or does not contain K. Also if it contains four coefficients
        without a model: these can be k1, k2, p1, p2 or the k1 to k4 of a fisheye lens.
    """
    if content.lstrip()[:1] == b"<":
        given: Mapping[str, Any] = _read_xml(content, path)
    else:
        content = MATRIX.sub(b"", content.removeprefix(OPENCV))
        given = parse_yaml(content, path, CalibrationError).data
    spelt = {str(key).lower().replace("_", ""): value for key, value in given.items()}
    data: dict[str, Any] = {}
    for key, names in NAMES.items():
        found = [spelt[name] for name in names if name in spelt]
        if found:
            data[key] = _matrix_fields(found[0])
    if "camera_matrix" not in data:
        raise CalibrationError(
            f"{path.name}: camera_matrix is missing; a file of OpenCV requires camera_matrix, "
            "distortion_coefficients, image_width and image_height"
        )
    data["distortion_model"] = spelt.get("distortionmodel") or _opencv_model(spelt, data, path)
    return Fields(data, path.name, CalibrationError)


def _read_xml(content: bytes, path: Path) -> dict[str, Any]:
    """Return the numbers, texts and matrices of an XML file of cv::FileStorage."""
    found: dict[str, Any] = {}
    try:
        flags = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
        # the nodes are valid only as long as the storage exists
        storage = cv2.FileStorage(content.decode("utf-8", "replace"), flags)
        root = storage.root()
        for key in root.keys():  # noqa: SIM118, because a FileNode is no mapping
            node = root.getNode(key)
            if node.isInt() or node.isReal():
                value = node.real()
                found[key] = int(value) if value.is_integer() else value
            elif node.isString():
                found[key] = node.string()
            elif node.isMap() and (matrix := node.mat()) is not None:
                rows, columns = matrix.reshape(len(matrix), -1).shape
                data = matrix.ravel().tolist()
                found[key] = {"rows": rows, "cols": columns, "data": data}
    except (cv2.error, SystemError) as error:
        raise CalibrationError(
            f"{path.name}: broken XML: {str(error).strip().splitlines()[-1][:100]}, allowed: a "
            "file of cv::FileStorage"
        ) from None
    return found


def _refuse_unknown_model(data: Mapping[str, Any], name: str) -> None:
    """Refuse four coefficients without a model, which can be k1, k2, p1, p2, or those of a fisheye
    lens. If all are zero, the model does not matter."""
    if _count(data) == FISHEYE and any(data["distortion_coefficients"]["data"]):
        raise CalibrationError(
            f"{name}: distortion_model is missing, required for {FISHEYE} coefficients: "
            "plumb_bob, or equidistant for those of cv::fisheye (an .ini file cannot contain the "
            "model: save a .yaml file)"
        )


def _count(data: Mapping[str, Any]) -> int:
    """Return the number of distortion coefficients. The result is 0 if there is no list of them."""
    block = data.get("distortion_coefficients")
    values = block.get("data") if isinstance(block, Mapping) else None
    return len(values) if isinstance(values, list) else 0


def _matrix_fields(value: Any) -> Any:
    """Return a matrix in the form of camera_info files. In an nd-matrix of OpenCV, the key `sizes`
    contains the shape."""
    if not isinstance(value, Mapping) or not isinstance(value.get("sizes"), list):
        return value
    rows, columns = [1, 1, *value["sizes"]][-2:]
    return {"rows": rows, "cols": columns, "data": value.get("data")}


def _opencv_model(spelt: Mapping[str, Any], data: Mapping[str, Any], path: Path) -> str:
    """Return the distortion model of an OpenCV file that has no key `distortion_model`."""
    if spelt.get("fisheyemodel"):
        return "equidistant"
    if "fisheyemodel" not in spelt:
        _refuse_unknown_model(data, path.name)
    return _pinhole_model(data)


def _pinhole_model(data: Mapping[str, Any]) -> str:
    """Return the distortion model of a lens that is not a fisheye lens."""
    return "plumb_bob" if _count(data) <= 5 else "rational_polynomial"


def read_ini(content: bytes, path: Path) -> Fields:
    """Return the camera parameters in an `.ini` file of ROS 1. In this file, each block of numbers
    follows a line with its name.

    Raises
    ------
    CalibrationError
        If a line that should contain numbers cannot be read, or if there are four coefficients: a
        `.ini` file does not contain the model.
    """
    blocks: dict[str, list[float]] = {}
    name = ""
    for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), 1):
        text = line.strip()
        if not text or text[0] in "#;[":
            continue
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            name = text
            if text[0].isdigit() or text[0] in "+-.":
                raise CalibrationError(
                    f"{path.name}: line {number} is {text!r}, allowed: numbers, or the name of a "
                    "block of numbers"
                ) from None
            continue
        blocks.setdefault(name, []).extend(values)
    data: dict[str, Any] = {}
    for side in ("width", "height"):
        if len(blocks.get(side, ())) == 1:
            value = blocks[side][0]
            data[f"image_{side}"] = int(value) if value.is_integer() else value
    for name, (rows, columns) in BLOCKS.items():
        if name in blocks:
            values = blocks[name]
            key = "distortion_coefficients" if name == "distortion" else "camera_matrix"
            data[key] = {"rows": rows, "cols": columns or len(values), "data": values}
    _refuse_unknown_model(data, path.name)
    data["distortion_model"] = _pinhole_model(data)
    return Fields(data, path.name, CalibrationError)
