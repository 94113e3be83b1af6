"""Parameters of the detector node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from plate_core.ros import NodeOptions, parameter
from plate_core.status import INPUT_TIMEOUT_S

from ..detection import DetectorOptions
from ..shapes.part_files import OUT
from ..tracking import TrackerOptions

TRANSPORTS = ("raw", "compressed")
"""Transports of the package image_transport that the node supports."""


def _live_option(kind: type[DetectorOptions] | type[TrackerOptions], name: str, text: str) -> Any:
    """Return the field of a live parameter. Default and range are those of the option with the same
    name of the detection or the tracking."""
    return parameter(getattr(kind, name), text, *kind.RANGES[name], live=True)


@dataclass(frozen=True)
class DetectorParameters(NodeOptions):
    """Parameters of the detector."""

    MOVED: ClassVar[dict[str, str]] = dict.fromkeys(
        ("source", "path", "rate"),
        "use the node camera for pictures and films: "
        "ros2 run plate_vision camera --ros-args -p device:=PATH -p rate:=2.0",
    )

    photographs: bool = parameter(
        False,
        "Whether each image is a separate photograph. If true, the parts of each photograph are "
        "written to the log.",
    )
    camera_file: str = parameter(
        "",
        "File of the lens: YAML in the form of camera_info. If it is empty, the lens of "
        "camera_info or of the rig file is used.",
    )
    image_transport: str = parameter(
        "raw", "Topic of the images: image_raw (raw) or image_raw/compressed", choices=TRANSPORTS
    )
    input_timeout_s: float = parameter(
        INPUT_TIMEOUT_S, "Time without an image after which diagnostics are STALE [s].", 0.1, 3600.0
    )
    bare_plate_file: str = parameter(
        "",
        "Picture of the bare plate, or folder of such pictures, for rigs with part types. If it is "
        "empty, the bare plate is estimated.",
    )
    teach_name: str = parameter("", "Name of the part type that ~/teach learns.", live=True)
    teach_file: str = parameter(str(OUT), "File of part types that ~/teach writes.")
    bits: int = parameter(16, "Number of used bits in 16-bit encodings", 8, 16, live=True)
    threshold: float = _live_option(
        DetectorOptions,
        "threshold",
        "Maximum brightness of a dark part relative to the plate [-]. Other parts need a contrast "
        "of at least 1 minus this value.",
    )
    class_threshold: float = _live_option(
        DetectorOptions,
        "class_threshold",
        "Brightness relative to the bare plate: black parts are below it, grey parts above [-]",
    )
    radius_tolerance: float = _live_option(
        DetectorOptions,
        "radius_tolerance",
        "Maximum deviation of a part's radius, relative to the radius in the rig file [-]",
    )
    min_plate_grey: float = _live_option(
        DetectorOptions, "min_plate_grey", "Minimum brightness of the plate [grey levels]"
    )
    margin_px: float = _live_option(
        DetectorOptions, "margin_px", "Maximum distance of a part's centre outside the plate [px]"
    )
    gate_m: float = _live_option(
        TrackerOptions,
        "gate_m",
        "Maximum distance of a part from its expected position, per image [m]",
    )
    max_missed: int = _live_option(
        TrackerOptions,
        "max_missed",
        "Number of consecutive images without a part after which its id is given up",
    )
    confirm: int = _live_option(
        TrackerOptions,
        "confirm",
        "Number of consecutive images that must show a new part before it gets an id",
    )
    velocity_frames: int = _live_option(
        TrackerOptions, "velocity_frames", "Number of images over which the drift is measured"
    )

    def detector(self) -> DetectorOptions:
        """Return the options of the detection. The radius is not set here, because the rig file
        determines it."""
        names = DetectorOptions.RANGES.keys() - {"radius_px"}
        return DetectorOptions(**{name: getattr(self, name) for name in names})

    def tracker(self) -> TrackerOptions:
        """Return the options of the tracking."""
        return TrackerOptions(**{name: getattr(self, name) for name in TrackerOptions.RANGES})
