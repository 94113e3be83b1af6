"""Tasks, stops and parameters of the plate from Python (`PlateClient`), and the program `plate`.

The class and the program use the same actions, topics and services as any other program.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .ros.client import PlateClient, Task, TaskError

__all__ = ["PlateClient", "Task", "TaskError"]


def __getattr__(name: str) -> Any:
    """Import the client on first use, because the program `plate` must be able to stop the plate
    without this delay."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .ros import client

    return getattr(client, name)
