"""Benchmark of the plate: Gymnasium environments of one or many plates, without ROS.

`import plate_gym` registers `plate/Sort10-v1` and all other tasks in `TASKS`. `plate_gym.bench`
evaluates agents.
"""

try:
    import gymnasium
except ModuleNotFoundError as problem:
    advice = f"plate_gym requires {problem.name}: pip install gymnasium"
    raise ModuleNotFoundError(advice, name=problem.name) from None

from .env import PlateEnv, PlateVectorEnv
from .tasks import TASKS, WORLDS, World

__all__ = ["TASKS", "WORLDS", "PlateEnv", "PlateVectorEnv", "World"]

for _task in TASKS:
    gymnasium.register(
        f"plate/{_task}",
        entry_point="plate_gym:PlateEnv",
        vector_entry_point="plate_gym:PlateVectorEnv",
        kwargs={"task": _task},
    )
