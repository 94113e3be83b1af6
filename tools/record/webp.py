"""Animations for pages, in the lossy WebP format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image


def save_film(
    frames: Sequence[Image.Image], durations: list[int], path: Path, width: int, quality: int
) -> None:
    """Write frames with their durations [ms] as an animation. The frames are scaled to a width
    [px]."""
    size = width, round(frames[0].height * width / frames[0].width)
    small = [frame.convert("RGB").resize(size, Image.Resampling.LANCZOS) for frame in frames]
    small[0].save(
        path, save_all=True, append_images=small[1:], duration=durations, loop=0, quality=quality,
        method=4, minimize_size=True,
    )  # fmt: skip
