"""Errors that a user can act on. Each message names the thing, its value and what is allowed."""


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
