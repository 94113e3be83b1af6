"""Interface of agents. The interface defines the information that an agent receives, and the
methods that it must have."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from gymnasium import Space

from plate_core import Rig
from plate_core.tasks import Scenario

from .env import PlateEnv, check_begun
from .motions import Motions

__all__ = ["KNOWN", "Agent", "Brief"]

KNOWN = (
    "time_s", "running", "bare_images", "limit_share", "scaled", "path_s", "pace", "ids", "rests",
    "order",
)  # fmt: skip
"""Keys of the dictionary `info` that an agent receives. A real plate provides the same information,
except for the reference positions on paths."""


@dataclass(frozen=True)
class Brief:
    """Information about the environment for an agent. The objects are copies, so the agent may
    change them.

    Attributes
    ----------
    action_space, observation_space : Space
    rig : Rig
    scenario : Scenario
    ids : tuple of str
        Ids of the parts, in the order of the rows.
    friction_limit : (M,)
        Maximum friction force mu m g on each part according to the rig file [N].
    motions : Motions
        Object that converts values of the action `motion` to motions.
    """

    action_space: Space
    observation_space: Space
    rig: Rig
    scenario: Scenario
    ids: tuple[str, ...]
    friction_limit: np.ndarray
    motions: Motions

    @classmethod
    def of(cls, env: PlateEnv) -> Brief:
        """Return the `Brief` of an environment that was reset before."""
        plates = env.plates
        check_begun(plates.plates)
        return deepcopy(
            cls(
                env.action_space, env.observation_space, plates.rig, plates.scenario,
                plates.plates[0].ids, plates.friction_limit, plates.motions,
            )
        )  # fmt: skip


class Agent(Protocol):
    """Interface of agents for `evaluate`. For each episode, `evaluate` creates an agent from a
    `Brief` and a random seed. The agent receives only the keys `KNOWN` of the dictionary `info`.

    Attributes
    ----------
    action, observation : str
        Kind of action and kind of observation that the agent needs.
    """

    action: str
    observation: str

    def __init__(self, brief: Brief, seed: int) -> None: ...

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> Any:
        """Return the agent's action for the present observation."""
