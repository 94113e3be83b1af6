"""Errors that a user can correct. Each message states the name, the value and the allowed range."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class PlateError(ValueError):
    """Base class of all errors that wrong input can raise."""


class RigError(PlateError):
    """Error: a rig file is missing, is unreadable, or contains a wrong value."""


class ScenarioError(PlateError):
    """Error: a scenario file is missing, is unreadable, or contains a wrong value."""


class CycleError(PlateError):
    """Error: a plate motion is invalid. The motion ends neither in its initial state nor at rest,
    is not finite, or cannot be executed."""


class FrameError(PlateError):
    """Error: a frame of the serial protocol is damaged, or a message does not fit into a frame."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a hint with the most similar known word, such as ` (did you mean mu?)`. The result is
    empty if no word is similar."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""
