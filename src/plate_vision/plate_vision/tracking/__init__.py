"""Names for the parts that stay with them from image to image, and their drift: a track for each
part, the most likely assignment of what an image shows, and the tracker that keeps them.
"""

from .track import Prediction, Sighting, Track
from .tracker import Tracker, TrackerOptions, found_text, update

__all__ = ["Prediction", "Sighting", "Track", "Tracker", "TrackerOptions", "found_text", "update"]
