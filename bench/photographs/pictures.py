"""The photographs and the true parts in them, from `photographs.yaml`. Angles are in degrees,
counter-clockwise in the picture. In image coordinates x points to the right and y down, and the
centre of the first pixel is (0, 0).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

LIST = Path(__file__).with_name("photographs.yaml")

ROOT = Path(__file__).resolve().parents[2]

FOLDER = ROOT / "out/photographs"
"""Folder of downloaded files and of figures."""

HALVES = ("tuning", "held_out")
"""Names of the two halves of the photographs. The first half is for tuning. The second half is used
only once, at the end."""

TRUTH = np.dtype(
    [
        ("x_px", "f8"),
        ("y_px", "f8"),
        ("radius_px", "f8"),
        ("angle_deg", "f8"),
        ("symmetry", "i4"),
        ("label", "U32"),
        ("touching", "?"),
    ]
)
"""Data of a marked part: centre of its area with filled holes, radius of the disc with the same
area [px], angle (NaN if undefined), and order of its rotational symmetry. Then follow its class,
and whether the part touches another part. The order of symmetry is 0 for a disc, and for a part
that is seen too much from the side."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph and the true parts in it.

    Attributes
    ----------
    name : str
    half : str
        One of `HALVES`.
    source : mapping
        Keys `github`, `commit` and `path`; or `package`, `version` and `path` in the folder of
        packages.
    licence, by : str
    sha256 : str
        Digest of the file.
    crop_px : (4,) of int, optional
        x, y, width, height of the part of the file that is used.
    shrink : int
        Factor by which the used part of the file is reduced in size.
    parts : (n,) TRUTH
    ignore : (m, 3)
        x, y, radius [px] of cut or doubtful parts. Detections of these parts are ignored, and so
        are missed ones.
    plate : (k, 2), optional
        Corners of a polygon [px]. Detections outside this polygon are not counted.
    """

    name: str
    half: str
    source: Mapping[str, str]
    licence: str
    by: str
    sha256: str
    crop_px: tuple[int, int, int, int] | None
    shrink: int
    parts: np.ndarray
    ignore: np.ndarray
    plate: np.ndarray | None

    @property
    def file(self) -> Path:
        """Path of the downloaded file."""
        return FOLDER / "files" / (self.name + Path(self.source["path"]).suffix.lower())

    def image(self) -> np.ndarray:
        """Return the used part of the picture (H, W, 3), uint8: blue, green, red."""
        image = cv2.imread(str(self.file), cv2.IMREAD_COLOR)
        if image is None:
            raise FileNotFoundError(
                f"{self.file} is not a readable picture; run `fetch` to download it"
            )
        if self.crop_px is not None:
            x, y, width, height = self.crop_px
            image = image[y : y + height, x : x + width]
        if self.shrink > 1:
            size = (image.shape[1] // self.shrink, image.shape[0] // self.shrink)
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(image)


def load_photographs() -> list[Photograph]:
    """Read the list of photographs."""
    data = yaml.safe_load(LIST.read_text(encoding="utf-8"))
    return [_read_entry(name, entry) for name, entry in data.items()]


def _read_entry(name: str, entry: dict[str, Any]) -> Photograph:
    rows = [
        (*row[:3], row[3] if len(row) > 3 else np.nan, kind["symmetry"], label, touching)
        for label, kind in entry["parts"].items()
        for key, touching in (("apart", False), ("touching", True))
        for row in kind.get(key, ())
    ]
    crop, plate = entry.get("crop_px"), entry.get("plate")
    facts = {key: entry[key] for key in ("half", "source", "licence", "by", "sha256")}
    return Photograph(
        name, **facts,
        crop_px=None if crop is None else (crop[0], crop[1], crop[2], crop[3]),
        shrink=entry.get("shrink", 1),
        parts=np.array(rows, TRUTH),
        ignore=np.array(entry.get("ignore", []), float).reshape(-1, 3),
        plate=None if plate is None else np.array(plate, float),
    )  # fmt: skip
