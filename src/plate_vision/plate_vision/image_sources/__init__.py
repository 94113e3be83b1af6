"""Image sources of the camera node: V4L2, GenICam, a pipe, a film or a folder of pictures."""

from .source import FORMATS, CameraError, Frame, Settings, Source
from .sources import check_device, is_played, listing, make_source, video_devices
from .watch import Watch

__all__ = [
    "FORMATS",
    "CameraError",
    "Frame",
    "Settings",
    "Source",
    "Watch",
    "check_device",
    "is_played",
    "listing",
    "make_source",
    "video_devices",
]
