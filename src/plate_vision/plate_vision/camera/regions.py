"""Region of interest and binning of a camera_info message.

K and the size in camera_info are those of the full image. If the camera sends only a region of the
image, or combines pixels (binning), K and the size of the sent image follow from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import CalibrationError


@dataclass(frozen=True)
class Region:
    """Part of the full image that a camera sends.

    Attributes
    ----------
    full_px : (int, int)
        Width and height of the full image [px].
    offset_px : (int, int)
        First column and row of the region of interest [px].
    roi_px : (int, int)
        Width and height of the region of interest [px]. (0, 0) means the full image.
    binning : (int, int)
        Number of columns and of rows that are combined to one. 0 and 1 mean no binning.

    Raises
    ------
    CalibrationError
        If the region of interest exceeds the full image.
    """

    full_px: tuple[int, int]
    offset_px: tuple[int, int] = (0, 0)
    roi_px: tuple[int, int] = (0, 0)
    binning: tuple[int, int] = (1, 1)

    def __post_init__(self) -> None:
        ends = [start + side for start, side in zip(self.offset_px, self.roi_px, strict=True)]
        if self.roi_px != (0, 0) and any(
            end > full for end, full in zip(ends, self.full_px, strict=True)
        ):
            raise CalibrationError(
                f"roi is {self.roi_px[0]} x {self.roi_px[1]} px at {self.offset_px}, allowed: a "
                f"region inside the full image, whose width x height is {self.full_px[0]} x "
                f"{self.full_px[1]} px; set camera_file to a calibration of the images as they are "
                "sent"
            )

    @property
    def is_full(self) -> bool:
        """Whether the camera sends the full image."""
        whole = self.roi_px in ((0, 0), self.full_px)
        return whole and all(count <= 1 for count in self.binning)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the sent images [px]."""
        sides = self.full_px if self.roi_px == (0, 0) else self.roi_px
        width, height = (
            side // max(count, 1) for side, count in zip(sides, self.binning, strict=True)
        )
        return width, height

    @property
    def reason(self) -> str:
        """End of a message about the size of the images. Empty if the camera sends the full
        image."""
        if self.is_full:
            return ""
        return (
            f" (full image {self.full_px[0]} x {self.full_px[1]} px, roi {self.roi_px[0]} x "
            f"{self.roi_px[1]} px, binning {self.binning[0]} x {self.binning[1]}); set camera_file "
            "to a calibration of the images as they are sent"
        )

    def matrix(self, full: np.ndarray) -> np.ndarray:
        """Return K (3, 3) [px] of the sent images. `full` is K of the full image.

        A column u of the full image is the column (u - offset + 1/2) / binning - 1/2 of the sent
        image, because the centre of the first pixel is 0.
        """
        sent = np.array(full, dtype=float)
        if self.is_full:
            return sent
        for axis in range(2):
            count = max(self.binning[axis], 1)
            offset = self.offset_px[axis] if self.roi_px != (0, 0) else 0
            sent[axis, :2] /= count
            sent[axis, 2] = (sent[axis, 2] - offset + 0.5) / count - 0.5
        return sent
