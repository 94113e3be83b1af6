"""A feeder. The feeder gives parts to a robot one by one, while the planner moves the next parts to
places where the robot can pick them."""

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
