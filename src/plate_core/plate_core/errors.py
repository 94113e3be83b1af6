"""Errors that a user can act on. Each message names the thing, its value and what is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class PlateError(ValueError):
    """Base of every error that wrong input can raise."""


class RigError(PlateError):
    """A rig file is missing, unreadable, or holds a wrong value."""


class ScenarioError(PlateError):
    """A scenario file is missing, unreadable, or holds a wrong value."""


class CycleError(PlateError):
    """A plate motion does not close, is not finite, or is otherwise no motion of this plate."""


class FrameError(PlateError):
    """Bytes of the serial protocol are damaged, or a message does not fit into them."""


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a hint with the nearest known word, ` (did you mean mu?)`; empty if none is near."""
    near = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""
