"""The plate's tasks, stops and parameters, from Python: `PlateClient`; and the program `plate`.

It talks to the nodes through the same actions, topics and services as any other program.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .ros.client import PlateClient, Task, TaskError

__all__ = ["PlateClient", "Task", "TaskError"]


def __getattr__(name: str) -> Any:
    """Import the client when it is wanted: the program `plate` must not wait for it to stop."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .ros import client

    return getattr(client, name)
