"""Environments of one plate (`PlateEnv`) and of many plates in parallel (`PlateVectorEnv`)."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterable, Sequence, Sized
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate

from plate_core import PlateError
from plate_sim.world import Simulation

from .plates import SEEDS, Plate, Plates
from .spaces import action_space, observation_space

METADATA: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 10}
MANY = METADATA | {"autoreset_mode": AutoresetMode.NEXT_STEP}

NO_WINDOW = "render_mode is 'human', but no window can be opened: {}"

ROUNDING = 1e-6
"""Distance by which a value of an action may exceed its bounds. The tolerance is necessary because
agents compute in float32."""


class PlateEnv(gym.Env):
    """Environment of one plate with a task.

    A step is one cycle of the plate. The observation shows the parts at the start of the running
    cycle, and the action is executed in the next cycle. A real plate has the same delay.

    Parameters
    ----------
    task : str
        Key of `TASKS`, such as `Sort10-v1`.
    world : str
        Key of `WORLDS`.
    action : str
        `motion`, `forces`, `progress` or `cycle`: see `action_space`.
    observation : str
        `parts` or `image`: see `observation_space`.
    render_mode : str, optional
        `rgb_array`, or `human` for a window.

    Raises
    ------
    PlateError
        If one of the names is unknown.
    """

    metadata = METADATA

    def __init__(
        self,
        task: str,
        world: str = "nominal",
        action: str = "motion",
        observation: str = "parts",
        render_mode: str | None = None,
    ) -> None:
        self.plates = Plates(task, world, action, observation)
        self.action_space = action_space(self.plates)
        self.observation_space = observation_space(self.plates)
        self.render_mode = checked_mode(render_mode)
        self._film: Film | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in the world that the seed `seed` defines. The same seed defines the
        same world in `bench/closed_loop.py`. Default: a random seed."""
        seed = None if seed is None else checked_seed(seed)
        super().reset(seed=seed)
        info = self.plates.reset([0], [drawn(self.np_random) if seed is None else seed])
        self._show()
        return self.plates.observed()[0], first(info)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Simulate the running cycle until its end. The action determines the next cycle."""
        check_begun(self.plates.plates)
        actions = checked_actions(self.action_space, [action])
        reward, ended, over, info = self.plates.step([0], actions)
        self._show()
        seen = self.plates.observed()[0]
        return seen, float(reward[0]), bool(ended[0]), bool(over[0]), first(info)

    def render(self) -> np.ndarray | None:
        """Return a picture (height, width, 3) of the parts at their true positions. Return None
        unless the render mode is `rgb_array`."""
        return None if self.render_mode != "rgb_array" else self._picture()

    def close(self) -> None:
        """Close the window."""
        if self._film is not None:
            self._film.close()

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes for a copy of the environment. The window is omitted, and the copy
        opens a separate window when it needs one."""
        return vars(self) | ({"_film": None} if self.render_mode == "human" else {})

    def _show(self) -> None:
        if self.render_mode == "human":
            self._picture()

    def _picture(self) -> np.ndarray:
        check_begun(self.plates.plates)
        self._film = self._film or Film(self.plates, self.render_mode == "human")
        return self._film.picture(0)


class PlateVectorEnv(VectorEnv):
    """Environment of N plates with the same task. The results are identical to those of N
    environments `PlateEnv`.

    If the episode of a plate has ended, the next step begins a new episode on this plate and
    ignores its action.

    Parameters
    ----------
    num_envs : int
        Number N of plates.
    threads : int, optional
        Maximum number of parallel threads. Default: the number of available cores.
    task, world, action, observation, render_mode
        The same as in `PlateEnv`, but the render mode `human` is not allowed.
    """

    metadata = MANY

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        world: str = "nominal",
        action: str = "motion",
        observation: str = "parts",
        render_mode: str | None = None,
        threads: int | None = None,
    ) -> None:
        threads = len(os.sched_getaffinity(0)) if threads is None else threads
        for name, value in (("num_envs", num_envs), ("threads", threads)):
            if not isinstance(value, int | np.integer) or value < 1:
                raise PlateError(f"{name} is {value!r}, allowed: a whole number, 1 or more")
        self.num_envs = num_envs
        self.plates = Plates(task, world, action, observation, num_envs, min(threads, num_envs))
        self.single_action_space = action_space(self.plates)
        self.single_observation_space = observation_space(self.plates)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.render_mode = checked_mode(render_mode)
        self._rngs = [seeding.np_random()[0] for _ in range(num_envs)]
        self._ended = np.zeros(num_envs, bool)
        self._film: Film | None = None

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode on each plate. The plates have the seeds `seed`, `seed` + 1, ..., or the
        seeds of a list. If the mask `options["reset_mask"]` (N,) is given, episodes begin only on
        the plates for which the mask is True."""
        count = self.num_envs
        mask = np.asarray((options or {}).get("reset_mask", np.ones(count, bool)))
        if mask.shape != (count,) or mask.dtype != bool or not mask.any():
            raise PlateError(
                f"reset_mask is {mask.tolist()}, allowed: {count} booleans, at least one True"
            )
        seeds: list[int | None] = [None] * count
        if isinstance(seed, Sequence | np.ndarray) and getattr(seed, "ndim", True):
            seeds = [
                None if plate_seed is None else checked_seed(plate_seed) for plate_seed in seed
            ]
        elif seed is not None:
            seeds = [checked_seed(seed) + k for k in range(count)]
        if len(seeds) != count:
            raise PlateError(f"seed has {len(seeds)} numbers, allowed: {count} (one per plate)")
        rows, worlds = np.flatnonzero(mask).tolist(), []
        for k in rows:
            plate_seed = seeds[k]
            if plate_seed is not None:
                self._rngs[k] = seeding.np_random(plate_seed)[0]
            worlds.append(drawn(self._rngs[k]) if plate_seed is None else plate_seed)
        check_begun([self.plates.plates[k] for k in np.flatnonzero(~mask)])
        self._ended[mask] = False
        info = self._for_all_plates(self.plates.reset(rows, worlds), mask)
        return self.plates.observed(), info

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Simulate the running cycle of each plate until its end. The actions determine the next
        cycles."""
        check_begun(self.plates.plates)
        count = len(actions) if np.iterable(actions) and isinstance(actions, Sized) else 0
        if count != self.num_envs:
            text = count or repr(actions)
            raise PlateError(f"actions are {text}, allowed: {self.num_envs} (one per plate)")
        if not isinstance(actions, np.ndarray):
            actions = iterate(self.action_space, actions)
        plate_actions = checked_actions(self.single_action_space, actions)
        restarted, rows = (np.flatnonzero(m).tolist() for m in (self._ended, ~self._ended))
        info: dict[str, Any] = {}
        reward = np.zeros(self.num_envs)
        ended, over = np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool)
        if len(restarted):
            worlds = [drawn(self._rngs[k]) for k in restarted]
            info = self._for_all_plates(self.plates.reset(restarted, worlds), self._ended)
        if len(rows):
            step = self.plates.step(rows, [plate_actions[row] for row in rows])
            reward[rows], ended[rows], over[rows] = step.reward, step.ended, step.over
            info = self._for_all_plates(step.info, ~self._ended, info)
        self._ended = ended | over
        return self.plates.observed(), reward, ended, over, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture (height, width, 3) for each plate. None if there is no render mode."""
        if self.render_mode is None:
            return None
        check_begun(self.plates.plates)
        self._film = self._film or Film(self.plates, False)
        return tuple(self._film.picture(row) for row in range(self.num_envs))

    def _for_all_plates(
        self, info: dict[str, np.ndarray], rows: np.ndarray, others: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        """Expand `info`, whose arrays contain values only for the plates `rows`, to all N plates.
        The result contains arrays (N, ...), and a mask `_NAME` (N,) for each array NAME. The mask
        is True for the plates that have a value. The result also contains the values of
        `others`."""
        result = dict(others or {})
        for name, values in info.items():
            is_given = result.setdefault(f"_{name}", np.zeros(self.num_envs, bool))
            zeros = np.zeros((self.num_envs, *values.shape[1:]), values.dtype)
            zeros = result.setdefault(name, zeros)
            zeros[rows], is_given[rows] = values, True
        return result


def check_begun(plates: Sequence[Plate]) -> None:
    """Raise an error unless all plates were reset."""
    if any(plate is None for plate in plates):
        raise gym.error.ResetNeeded("there is no episode yet: call reset first")


def checked_actions(space: gym.Space, actions: Iterable[Any]) -> list[Any]:
    """Clip actions to the bounds of their space, and return them. Raise an error if a value exceeds
    a bound by more than `ROUNDING`."""
    if not isinstance(space, gym.spaces.Box):
        cycles = list(actions)
        for action in cycles:
            if not space.contains(action):
                kind = type(action).__name__
                raise PlateError(f"action is of type {kind}, allowed: plate_core.PlateCycle")
        return cycles
    low, high = space.low, space.high
    if isinstance(actions, np.ndarray) and fits(actions, actions.shape[:1] + space.shape):
        close = np.clip(actions, low, high)
        if np.max(np.abs(close - actions)) <= ROUNDING:
            return list(close)
    result = []
    for action in actions:
        try:
            given = np.asarray(action)
        except ValueError:  # NumPy raises a ValueError if the rows have different lengths
            given = np.array(None)
        if fits(given, space.shape):
            close = np.clip(given, low, high)
            if np.max(np.abs(close - given)) <= ROUNDING:
                result.append(close)
                continue
        text = f"{given.dtype} of shape {given.shape}" if given.ndim else type(action).__name__
        if given.ndim and given.size and np.can_cast(given.dtype, float):
            text += f", from {np.min(given):g} to {np.max(given):g}"
        rows = f"{space.shape}, rows from {low[0].tolist()} to {high[0].tolist()}"
        raise PlateError(f"action is {text}, allowed: {rows if low.ndim > 1 else space}")
    return result


def fits(given: np.ndarray, shape: tuple[int, ...]) -> bool:
    """Whether an array contains numbers and has the shape `shape`."""
    return given.shape == shape and np.can_cast(given.dtype, float)


def checked_mode(mode: str | None) -> str | None:
    """Check a render mode and return it. None means no pictures."""
    if mode not in (None, *METADATA["render_modes"]):
        raise PlateError(f"render_mode is {mode!r}, allowed: None, rgb_array, human")
    return mode


def checked_seed(seed: Any) -> int:
    """Convert a seed to a Python integer. Raise an error unless the seed is a whole number of at
    least 0."""
    try:
        number = operator.index(seed)
    except TypeError:
        number = -1
    if number < 0 or isinstance(seed, bool):
        raise PlateError(f"seed is {seed!r}, allowed: a whole number, 0 or more")
    return number


def drawn(rng: np.random.Generator) -> int:
    """Return a random seed for a world."""
    return int(rng.integers(SEEDS))


def first(info: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return the first element of each array in `info`. If an environment has only one plate, this
    element contains the value of this plate."""
    return {name: values[0] for name, values in info.items()}


class Film:
    """Takes pictures of plates with a separate simulated camera without noise. If requested, a
    window shows the pictures."""

    def __init__(self, plates: Plates, window: bool) -> None:
        self._plates = plates
        self._scene = Simulation(plates.rig, plates.scenario)
        self._window = Window() if window else None

    def picture(self, row: int) -> np.ndarray:
        """Return a picture (height, width, 3) of one plate with the parts at their true positions.
        If there is a window, the window shows the picture."""
        self._scene.show(self._plates.plates[row].simulation.state)
        image = self._scene.capture()
        assert image is not None
        colours = image[..., ::-1] if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
        colours = np.ascontiguousarray(colours)
        if self._window is not None:
            self._window.show(colours)
        return colours

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()


class Window:
    """Window that shows pictures. If no window can be opened, a warning is printed instead."""

    def __init__(self) -> None:
        self._root: Any = None
        try:
            # tkinter is imported here, because some Python installations do not contain it
            import tkinter
        except ImportError as problem:
            return gym.logger.warn(NO_WINDOW.format(problem))
        try:
            self._root = tkinter.Tk()
        except tkinter.TclError as problem:
            return gym.logger.warn(NO_WINDOW.format(problem))
        self._root.title("plate")
        self._root.protocol("WM_DELETE_WINDOW", self.close)
        self._label = tkinter.Label(self._root)
        self._label.pack()
        self._picture = tkinter.PhotoImage

    def show(self, image: np.ndarray) -> None:
        """Show a picture (height, width, 3)."""
        if self._root is None:
            return
        height, width = image.shape[:2]
        self._shown = self._picture(data=b"P6 %d %d 255 " % (width, height) + image.tobytes())
        self._label.configure(image=self._shown)
        self._root.update()

    def close(self) -> None:
        """Close the window."""
        if self._root is not None:
            self._root.destroy()
            self._root = None
