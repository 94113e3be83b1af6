"""What is known of the parts before they are seen."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import OptionError


@dataclass(frozen=True)
class DetectorOptions:
    """What a part looks like.

    Attributes
    ----------
    radius_px : float
        Radius of a part [px], 3 to 200.
    radius_tolerance : float
        Greatest deviation from it, as a share of it, 0.05 to 0.6.
    threshold : float
        Share of the bare plate's brightness below which a pixel belongs to a part, 0.1 to 0.95.
    class_threshold : float
        Share of the bare plate's brightness below which a part is black, above which grey, 0.05 to
        0.95.
    min_plate_grey : float
        Darkest plate that is believed [grey levels], 1 to 255: below that the light is off.
    margin_px : float
        How far outside the region a part's centre may be [px], 0 to 10: for errors of the
        calibration. Only pixels inside the region are looked at, so of a part that is 2 px further
        out too little is seen. A plate that is displaced by more needs another region.
    """

    radius_px: float = 8.0
    radius_tolerance: float = 0.2
    threshold: float = 0.8
    class_threshold: float = 0.4
    min_plate_grey: float = 60.0
    margin_px: float = 1.0

    def __post_init__(self) -> None:
        ranges = {
            "radius_px": (3.0, 200.0),
            "radius_tolerance": (0.05, 0.6),
            "threshold": (0.1, 0.95),
            "class_threshold": (0.05, 0.95),
            "min_plate_grey": (1.0, 255.0),
            "margin_px": (0.0, 10.0),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise OptionError(f"{name} is {value}, allowed: {low:g} to {high:g}")
