"""The plate as a benchmark: environments of Gymnasium, one plate or many at once, without ROS.

`import plate_gym` registers `plate/Sort10-v1` and the others of `TASKS`; `plate_gym.bench` judges
agents.
"""

import gymnasium

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
