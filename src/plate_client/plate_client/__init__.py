"""The plate's tasks, stops and parameters, from Python: `PlateClient`; and the program `plate`.

It talks to the nodes through the same actions, topics and services as any other program.
"""

from .client import PlateClient, Task, TaskError

__all__ = ["PlateClient", "Task", "TaskError"]
