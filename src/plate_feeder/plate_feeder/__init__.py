"""A feeder. The feeder dispenses parts to a robot one by one, while the planner gets the next parts
ready."""

from .codes import Code
from .feeder import Feeder
from .hand_eye import HandEye, HandEyeError, fit_hand_eye, load_hand_eye
from .interface import FeedStatus, Output, Quantity, ReadyPart, Reply, Reserved, State

__all__ = [
    "Code",
    "FeedStatus",
    "Feeder",
    "HandEye",
    "HandEyeError",
    "Output",
    "Quantity",
    "ReadyPart",
    "Reply",
    "Reserved",
    "State",
    "fit_hand_eye",
    "load_hand_eye",
]
