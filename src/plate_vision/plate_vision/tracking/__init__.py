"""Tracking: each part keeps its id from image to image, and its drift is measured.

A `Track` is the track of one part. The module `assignment` determines the most likely assignment of
the detections in an image to tracks. `update` applies this assignment to the `Tracker`.
"""

from .track import Detection, Prediction, Track
from .tracker import Tracker, TrackerOptions, found_text, update

__all__ = ["Detection", "Prediction", "Track", "Tracker", "TrackerOptions", "found_text", "update"]
