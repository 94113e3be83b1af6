"""One episode of an agent: in this process, or in a separate process with limits."""

from __future__ import annotations

import hashlib
import importlib
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from plate_core import PlateError, did_you_mean

from . import isolation
from .agent import KNOWN, Agent, Brief
from .agents import AGENTS
from .env import PlateEnv, drawn
from .isolation import Limits
from .plates import clocks
from .result import ROW, check_row, shortened

__all__ = ["agent_class", "episode", "isolated"]

AGENT = 2
"""Number from which, together with the seed of a world, the seed of the agent is derived."""


def agent_class(name: str) -> type[Agent]:
    """Return the agent class for a name: a key of `AGENTS`, or `MODULE:CLASS`. The module is
    imported like any Python module.

    Raises
    ------
    PlateError
        If there is no agent with that name.
    """
    if name in AGENTS:
        return AGENTS[name]
    module, colon, label = name.partition(":")
    if not colon:
        raise PlateError(
            f"agent is {name!r}{did_you_mean(name, AGENTS)}, allowed: {', '.join(AGENTS)}, or "
            "MODULE:CLASS"
        )
    try:
        found: type[Agent] = getattr(importlib.import_module(module), label)
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        absent = isinstance(problem, ModuleNotFoundError) and problem.name == module
        where = f"; no {module}.py in this folder ({Path.cwd()}) or on the path" if absent else ""
        raise PlateError(f"agent {name} cannot be loaded: {one_line(problem)}{where}") from problem
    kinds = (getattr(found, key, None) for key in ("action", "observation"))
    if (
        not isinstance(found, type)
        or not all(isinstance(kind, str) for kind in kinds)
        or not callable(getattr(found, "act", None))
    ):
        raise PlateError(
            f"agent {name} is {found!r}, allowed: a class with the attributes action and "
            "observation and the method act"
        )
    return found


def episode(
    agent: str, world: str, task: str, seed: int, begin: Callable[[], object] = lambda: None
) -> dict[str, Any]:
    """Run one episode in this process, in the world that the seed defines. The function `begin` is
    called before each decision of the agent.

    Returns
    -------
    dict
        Row with the following keys. `seed`, `success`, `time_s` (simulated duration), `steps`,
        `return`, `there` and `dropped` describe the episode. `error_mm` and `turn_error_deg` are
        the largest errors of a part at the end. `limit_share` is the maximum fraction of a limit
        that was used. `places` is a digest of all positions. `start_ms` is the processor time to
        create the agent. `decision_ms` and `decision_ms_p99` are the median and the 99th percentile
        of the processor time of a decision. `wall_ms` and `wall_ms_p99` are the same quantities for
        the elapsed time. If an action needs this project's solver, the times of a decision include
        the solver.

    Raises
    ------
    PlateError
        If the agent fails. The message contains agent, task, seed and step.
    """
    kind = agent_class(agent)
    spent, total, used = [], 0.0, 0.0
    places = hashlib.blake2b(digest_size=8)
    ended = over = False
    try:
        env = PlateEnv(task, world, kind.action, kind.observation)
        seen, info = env.reset(seed=seed)
        plate, brief = env.plates.plates[0], Brief.of(env)
        began = clocks()
        mind = kind(brief, seed_of_agent(seed))
        start = clocks() - began
        while not (ended or over):
            known = {name: info[name] for name in KNOWN if name in info}
            begin()
            before, began = plate.solving_s.copy(), clocks()
            action = mind.act(seen, known)
            passed = clocks() - began
            seen, reward, ended, over, info = env.step(action)
            spent.append(passed + plate.solving_s - before)
            total, used = total + reward, max(used, float(info["limit_share"]))
            places.update(plate.simulation.state.position.tobytes())
    except KeyboardInterrupt as problem:
        # Ctrl-C or the agent has caused the KeyboardInterrupt. A process of `isolation` ignores
        # Ctrl-C. Therefore, in such a process, the agent has raised the exception.
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
            raise
        raise PlateError(f"{named(agent, task, seed, len(spent))}: KeyboardInterrupt") from problem
    except BaseException as problem:
        where = named(agent, task, seed, len(spent))
        raise PlateError(f"{where}: {one_line(problem)}") from problem
    cpu_ms, wall = 1e3 * np.array(spent).T
    return {
        "seed": seed,
        "success": bool(info["success"]),
        "time_s": round(float(info["time_s"]), 6),
        "steps": len(spent),
        "return": total,
        "there": int(info["there"]),
        "dropped": int(info["dropped"]),
        "error_mm": 1e3 * float(np.max(info["error_m"])),
        "turn_error_deg": float(np.degrees(np.max(info["turn_error"]))),
        "limit_share": used,
        "places": places.hexdigest(),
        "start_ms": 1e3 * float(start[0]),
        "decision_ms": float(np.median(cpu_ms)),
        "decision_ms_p99": float(np.percentile(cpu_ms, 99)),
        "wall_ms": float(np.median(wall)),
        "wall_ms_p99": float(np.percentile(wall, 99)),
    }


def seed_of_agent(seed: int) -> int:
    """Return the seed of an agent's random numbers. This seed differs from the seed of the world,
    because an agent that knows the world's seed could compute where the parts are."""
    return drawn(np.random.default_rng((seed, AGENT)))


def isolated(agent: str, world: str, task: str, seed: int, limits: Limits) -> dict[str, Any]:
    """Run one episode in a separate process.

    Returns
    -------
    dict
        Row with the keys of `episode`. If the agent exceeds a limit, the row contains zeros, and
        its additional key `failure` names the limit.

    Raises
    ------
    PlateError
        If the agent fails for another reason than a limit. The message contains agent, task and
        seed.
    """
    request = {"agent": agent, "world": world, "task": task, "seed": seed}
    reply = isolation.play(request, limits)
    where = f"agent {agent}, {task}, seed {seed}"
    if "row" in reply:
        row: dict[str, Any] = reply["row"]
        check_row(where, row, ROW)
        if row["seed"] != seed:
            raise PlateError(f"{where}: seed of the row is {row['seed']}, allowed: {seed}")
        return row
    if "failure" in reply:
        failed = {"seed": seed, "steps": reply["steps"], "failure": shortened(reply["failure"])}
        return {key: kind() for key, kind in ROW.items()} | failed
    error = shortened(reply["error"])
    raise PlateError(error if error.startswith(f"agent {agent}") else f"{where}: {error}")


def named(agent: str, task: str, seed: int, step: int) -> str:
    """Return a text for error messages that names the agent, the task, the seed and the step."""
    return f"agent {agent}, {task}, seed {seed}, step {step}"


def one_line(problem: BaseException) -> str:
    """Convert an exception to one line of text."""
    try:
        text = str(problem)
    except BaseException as other:
        text = f"(its text cannot be read: {type(other).__name__})"
    return shortened(f"{type(problem).__name__}: {text}" if text else type(problem).__name__)
