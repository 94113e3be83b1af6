"""Train a small network that computes each motion directly, with gradients through friction.

The network acts for some cycles in a model of the plate in which parts are points. The gradient of
the parts' distances from their targets is propagated back through friction and motions to the
network's weights. Therefore the network learns without a solver and without rewards. One network
serves any number of parts. It is trained on plates with ten parts and on plates with four parts.
Run it in this folder, in a separate environment (pip install ../../src/plate_gym -r
requirements.txt):

    python train.py

The program writes weights.npz, and curve.csv with the network's results on plates of plate_gym
during the training. The training takes about 26 minutes on one core. These are results of the 40
seeds from 200,000 on, for at most 40 s of plate time:

    updates                    2500  5000 10000 15000 20000 27000 29500 32000 37000
    ten parts: done [%]           2     5    18    25    15    50    82    90    92
    plate time, median [s]     39.1  23.7  29.2  25.0  18.8  29.4  25.8  26.8  24.4
    to go after 20 s [mm]        65    45    30    30    25    17    17    18    17
    four parts: done [%]         95   100   100   100   100   100   100   100   100
    plate time, median [s]     19.4   9.3   7.5   7.1   7.7   7.1   7.1   6.7   6.8

The second stage starts after 27,000 updates. Its program was the same, but started from the rounded
weights of the first stage. On the seeds 0 to 99, which were not used before, and until the time
limit of 120 s, the network sorted these fractions of the plates:

    world                   nominal friction  latency   misses held_out
    ten parts: done [%]         100       88       98       97       67
    plate time, median [s]     24.7     23.2     23.1     23.9     27.2
    four parts: done [%]        100      100      100      100      100
    plate time, median [s]      6.2      6.2      6.4      6.3      6.7

With ten parts, the network takes four times as long as Method B, and twice as long as Method A.
Random motions sort no plate. With 24 parts, the network sorted none of 20 plates in 240 s, and
reduced the mean distance to go from 190 to 24 mm.

With ten parts, a network with concatenated parts sorted no plate after 1,000 updates, and one with
averaged features none of 30 after 2,353 updates. Powers of the position up to degree 1, 2 and 3
left 79, 51 and 71 mm to go (after 20 s) after the first minute of training.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from learned import WEIGHTS, Network
from numba import njit

import plate_gym  # noqa: F401, registers the environments
from plate_solver import Limits
from plate_solver.sinusoids import sinusoid_basis

WIDTHS = {
    "part_0": (10, 64),
    "part_1": (64, 64),
    "weigh": (64, 32),
    "plate_0": (32 * 6 + 18 + 1, 256),
    "plate_1": (256, 256),
    "action": (256, 18),
}
"""Number of inputs and outputs of each layer."""

PARTS = (10, 10, 10, 10, 4)
"""Numbers of parts on the plates of consecutive updates, over and over."""

PLATES, CYCLES = 128, 4
"""Number of plates in parallel, and number of cycles through which the gradient is propagated."""

WARM_UP = 100
"""Number of updates in which the learning rate of a stage increases from 0."""

STEPS = 64
"""Number of time steps per cycle in the model."""

EDGE_M, EDGE_COST = 0.03, 2.0
"""Width of the zone at the edges in which a part has a cost [m], and the cost at the edge itself
[100 mm of distance to go]."""

CLEAR_M = 0.02
"""If the centres of two parts are nearer than this distance, the parts have a cost [m]."""

PLATES_TESTED, SEED = 40, 200_000
"""Number of plates of plate_gym for the evaluation, and their first seed."""

CYCLES_TESTED, CYCLE_EVALUATED, INTERVAL = 400, 200, 2500
"""Maximum number of cycles per evaluation, cycle at which the distances to go are evaluated, and
number of updates between evaluations."""

CURVE = Path(__file__).with_name("curve.csv")


@dataclass(frozen=True)
class Stage:
    """Stage of the training.

    Attributes
    ----------
    updates : int
        Number of updates of the weights.
    rate, fall : float
        Learning rate, and final fraction of the updates in which it decreases linearly to 0.
    max_cycles : int
        Maximum number of cycles after which a plate of the model is reset.
    beyond_m : float
        Distance of the cost's target lines beyond the goal lines [m].
    round_m : float
        Remaining distance of a part [m] at which its cost changes from nearly quadratic (below) to
        nearly linear (above).
    """

    updates: int
    rate: float
    fall: float
    max_cycles: int
    beyond_m: float
    round_m: float


STAGES = (
    Stage(27_000, rate=3e-3, fall=0.4, max_cycles=120, beyond_m=0.0, round_m=0.01),
    Stage(10_000, rate=2e-3, fall=1.0, max_cycles=300, beyond_m=0.005, round_m=0.003),
)
"""Stages of the training. The second stage trains the final centimetres of each task."""


@njit(fastmath=True, cache=True, error_model="numpy")
def slide_step(
    x: Any, y: Any, u: Any, v: Any, pose: Any, twist: Any, limit: float, dt: float, kept: Any
) -> None:
    """Simulate one part of each plate for a time step of `slide`. The compiler vectorises this loop
    over arrays of one dimension."""
    shift_x, shift_y, speed_x, speed_y, spin = pose[0], pose[1], twist[0], twist[1], twist[2]
    kept_x, kept_y, kept_u, kept_v = kept[0], kept[1], kept[2], kept[3]
    for k in range(x.shape[0]):
        slip_x = speed_x[k] - spin[k] * (y[k] - shift_y[k]) - u[k]
        slip_y = speed_y[k] + spin[k] * (x[k] - shift_x[k]) - v[k]
        kept_x[k], kept_y[k], kept_u[k], kept_v[k] = x[k], y[k], slip_x, slip_y
        fraction = limit / max(np.sqrt(slip_x * slip_x + slip_y * slip_y), limit)
        u[k] += fraction * slip_x
        v[k] += fraction * slip_y
        x[k] += dt * u[k]
        y[k] += dt * v[k]


@njit(fastmath=True, cache=True, error_model="numpy")
def slide(state: Any, pose: Any, twist: Any, limit: float, dt: float, kept: Any) -> None:
    """Simulate the parts for a cycle, with point friction and explicit time steps.

    With the slip s = plate velocity below the part - v, each step is
    v' = v + s min(1, limit / norm(s)), then p' = p + dt v'.

    Parameters
    ----------
    state : (4, M, N)
        Positions x, y [m] and velocities [m/s] of M parts on N plates, changed in place.
    pose, twist : (n, 3, N)
        Motion of the plates at the middle of each step.
    limit : float
        Maximum change of a velocity per step, mu g dt [m/s].
    dt : float
        Time step [s].
    kept : (n, M, 4, N)
        Output: positions and slips of the parts at each step.
    """
    x, y, u, v = state
    for i in range(len(pose)):
        for m in range(len(x)):
            slide_step(x[m], y[m], u[m], v[m], pose[i], twist[i], limit, dt, kept[i, m])


@njit(fastmath=True, cache=True, error_model="numpy")
def slide_step_back(
    x: Any, y: Any, u: Any, v: Any, by_pose: Any, by_twist: Any, pose: Any, twist: Any,
    limit: float, dt: float, kept: Any,
) -> None:  # fmt: skip
    """Propagate derivatives back through `slide_step`."""
    shift_x, shift_y, spin = pose[0], pose[1], twist[2]
    kept_x, kept_y, kept_u, kept_v = kept[0], kept[1], kept[2], kept[3]
    by_shift_x, by_shift_y = by_pose[0], by_pose[1]
    by_speed_x, by_speed_y, by_spin = by_twist[0], by_twist[1], by_twist[2]
    for k in range(x.shape[0]):
        slip_x, slip_y = kept_u[k], kept_v[k]
        own_x, own_y = u[k] + dt * x[k], v[k] + dt * y[k]
        fraction = limit / max(np.sqrt(slip_x * slip_x + slip_y * slip_y), limit)
        unit_x, unit_y = fraction * slip_x / limit, fraction * slip_y / limit
        along = (unit_x * own_x + unit_y * own_y) if fraction < np.float32(1) else np.float32(0)
        by_x, by_y = fraction * (own_x - along * unit_x), fraction * (own_y - along * unit_y)
        u[k], v[k] = own_x - by_x, own_y - by_y
        x[k] += spin[k] * by_y
        y[k] -= spin[k] * by_x
        by_speed_x[k] += by_x
        by_speed_y[k] += by_y
        by_spin[k] += (kept_x[k] - shift_x[k]) * by_y - (kept_y[k] - shift_y[k]) * by_x
        by_shift_x[k] -= spin[k] * by_y
        by_shift_y[k] += spin[k] * by_x


@njit(fastmath=True, cache=True, error_model="numpy")
def slide_back(
    by_state: Any, by_pose: Any, by_twist: Any, pose: Any, twist: Any, limit: float, dt: float,
    kept: Any,
) -> None:  # fmt: skip
    """Propagate derivatives back through `slide`.

    `by_state` contains the derivatives with respect to the state after the cycle. The function
    overwrites `by_state` with the derivatives with respect to the state before the cycle. The
    derivatives with respect to pose and twist are added to `by_pose` and `by_twist`.
    """
    x, y, u, v = by_state
    for i in range(len(pose) - 1, -1, -1):
        for m in range(len(x)):
            slide_step_back(
                x[m], y[m], u[m], v[m], by_pose[i], by_twist[i], pose[i], twist[i], limit, dt,
                kept[i, m],
            )  # fmt: skip


class Slide(torch.autograd.Function):
    """`slide` as a differentiable function of torch."""

    @staticmethod
    def forward(ctx: Any, state: Any, pose: Any, twist: Any, limit: float, dt: float) -> Any:
        """Return the state after a cycle."""
        after, *motion = (values.detach().numpy() for values in (state, pose, twist))
        after, limit, dt = after.copy(), np.float32(limit), np.float32(dt)
        _, parts, plates = after.shape
        kept = np.empty((len(pose), parts, 4, plates), np.float32)
        slide(after, *motion, limit, dt, kept)
        ctx.made = (*motion, limit, dt, kept)
        return torch.from_numpy(after)

    @staticmethod
    def backward(ctx: Any, by_after: Any) -> Any:
        """Return the derivatives with respect to state, pose and twist."""
        own = by_after.numpy().copy(), *(np.zeros_like(values) for values in ctx.made[:2])
        slide_back(*own, *ctx.made)
        return (*map(torch.from_numpy, own), None, None)


class Model:
    """Differentiable model of N plates with parts, and of the cost of sorting to two sides or
    corners.

    The first half of the parts belongs to the scenario's first region, the others to its last.

    Attributes
    ----------
    aim : tuple of tensors
        Arguments `side`, `goal` and `half` of the network.
    """

    def __init__(self, env: Any, parts: int) -> None:
        plates = env.unwrapped.plates
        rig, self._scale = plates.rig, tensor(plates.motions.scale)
        own = plates.motions.basis
        basis = sinusoid_basis(len(own.span) // 2, own.period, True, STEPS)
        self._pose, self._twist = tensor(basis.pose), tensor(basis.twist)
        half, self.period, self._dt = tensor(rig.plate.half), own.period, basis.dt
        self._max_change = rig.friction.mu * rig.friction.gravity * basis.dt
        limits = Limits.of(rig, 1.0)
        levers = tensor(limits.levers)
        signs = tensor(list(itertools.product((1, -1), repeat=2)))
        (right, up), flat = (signs * half).T, torch.zeros(4)
        self._corners = torch.stack([flat + 1, flat, -up]), torch.stack([flat, flat + 1, right])
        pose, twist, self._accel = map(tensor, basis.checks)
        self._max_accel = limits.accel
        self._projections = [
            (pose, levers.T, limits.stroke_m),
            (twist, levers.T, limits.speed),
            (self._accel, levers.T, limits.accel),
        ]
        task = plates.scenario.task
        regions = [task.regions[label] for label in plates.scenario.labels]
        sides = [regions[0]] * (parts // 2) + [regions[-1]] * (parts - parts // 2)
        side = tensor([[region.x, region.y] for region in sides])
        self.aim = side, task.goal_fraction * side.abs() * half, half
        self.half, self.parts = half, parts

    def limited(self, actions: Any) -> Any:
        """Return the coefficients (N, 6, 3) of actions (N, 18), scaled down to the rig's limits."""
        count = len(actions)
        own = actions.reshape(count, -1, 3) * self._scale
        flat = own.transpose(0, 1).reshape(own.shape[1], -1)
        used = [
            ((basis @ flat).reshape(-1, 3) @ direction).abs().reshape(len(basis), count, -1) / limit
            for basis, direction, limit in self._projections
        ]
        accel = (self._accel @ flat).reshape(-1, 3)
        squares = sum((accel @ direction) ** 2 for direction in self._corners) + 1e-12
        used.append(squares.sqrt().reshape(len(self._accel), count, -1) / self._max_accel)
        limit = torch.stack([values.amax((0, 2)) for values in used]).amax(0)
        return own / limit.clip(min=1)[:, None, None]

    def after(self, place: Any, speed: Any, own: Any) -> tuple[Any, Any]:
        """Return positions and velocities (N, M, 2) of the parts after a cycle with coefficients
        (N, 6, 3)."""
        flat = own.permute(1, 2, 0).reshape(own.shape[1], -1)
        pose, twist = ((basis @ flat).reshape(STEPS, 3, -1) for basis in (self._pose, self._twist))
        state = torch.cat([place.permute(2, 1, 0), speed.permute(2, 1, 0)]).contiguous()
        state = Slide.apply(state, pose, twist, self._max_change, self._dt)
        return state[:2].permute(2, 1, 0), state[2:].permute(2, 1, 0)

    def distances(self, place: Any, beyond: float = 0.0) -> Any:
        """Return the distances (N, M) of the parts from their target lines, or from lines that are
        a distance beyond the target lines [m]."""
        side, goal, _ = self.aim
        gaps = (goal + beyond * side.abs() - place * side).clip(min=0)
        return torch.sqrt((gaps**2).sum(-1) + 1e-12)

    def cost(self, place: Any, stage: Stage) -> Any:
        """Return the cost (N,) of positions (N, M, 2): distances to go, plus costs of parts near
        edges and near each other."""
        distance, bend = self.distances(place, stage.beyond_m) / 0.1, stage.round_m / 0.1
        beyond = ((place.abs() - self.half) / EDGE_M + 1).clip(min=0)
        gap = torch.sqrt(((place[:, :, None] - place[:, None]) ** 2).sum(-1) + 1e-12)
        near = ((CLEAR_M - gap) / 0.2).clip(min=0).triu(1).sum((1, 2))
        far = (torch.sqrt(distance**2 + bend**2) - bend + distance**2 / 2).mean(1)
        return far + EDGE_COST * (beyond**2).sum((1, 2)) + near


def tensor(values: Any) -> Any:
    """Return values as a float32 tensor."""
    return torch.tensor(np.asarray(values), dtype=torch.float32)


class Crowd:
    """Simulated plates on which the network acts during training. Finished plates are reset."""

    def __init__(self, model: Model, stage: Stage) -> None:
        self._model, self._stage, parts = model, stage, (PLATES, model.parts, 2)
        self.place, self.speed, self.drift = self._drawn(PLATES), *torch.zeros(2, *parts)
        self.last, self.own = torch.zeros(PLATES, 18), torch.zeros(PLATES, 6, 3)
        self._age = torch.randint(stage.max_cycles, (PLATES,))

    def costs(self, network: Network) -> Any:
        """Let the network act for `CYCLES`. Return the mean cost of the positions, in which the
        final position counts twice."""
        model, stage, total = self._model, self._stage, 0.0
        for _ in range(CYCLES):
            self.last = network(self.place, self.drift, self.last, *model.aim)
            before = self.place
            self.place, self.speed = model.after(before, self.speed, self.own)
            self.drift, self.own = (self.place - before) / model.period, model.limited(self.last)
            total = total + model.cost(self.place, stage)
        place, speed = model.after(self.place, self.speed, self.own)  # play the last action
        total = total + 2 * model.cost(place + model.period / 2 * speed, stage)
        return total.mean() / (CYCLES + 2)

    def go_on(self) -> None:
        """Detach all tensors from the gradient. Reset plates that lost a part, are sorted, or have
        run for too many cycles."""
        for name, values in list(vars(self).items()):
            if torch.is_tensor(values):
                setattr(self, name, values.detach())
        off = (self.place.abs() > self._model.half).flatten(1).any(1)
        done = (self._model.distances(self.place) < 1e-5).all(1) & (torch.rand(PLATES) < 0.3)
        self._age += CYCLES
        restarted = off | done | (self._age > self._stage.max_cycles)
        self.place[restarted] = self._drawn(int(restarted.sum()))
        for values in (self.speed, self.drift, self.last, self.own, self._age):
            values[restarted] = 0

    def _drawn(self, count: int) -> Any:
        inner = self._model.half - CLEAR_M
        return (2 * torch.rand(count, self._model.parts, 2) - 1) * inner


def evaluated(env: Any, model: Model, network: Network) -> tuple[float, float, float, int]:
    """Return the fraction of plates that were sorted, their median time [s], the mean distance of a
    part to go at the cycle `CYCLE_EVALUATED` [mm], and the number of lost parts."""
    seen, _ = env.reset(seed=SEED)
    side, goal, half = (values.numpy() for values in model.aim)
    last, over = np.zeros((PLATES_TESTED, 18), np.float32), np.zeros(PLATES_TESTED, bool)
    lost, times, left = 0, [], np.zeros(PLATES_TESTED)
    for k in range(CYCLES_TESTED):
        place, drift = (seen[..., own].astype(np.float32) for own in (slice(2), slice(2, 4)))
        if k <= CYCLE_EVALUATED:
            distance = np.linalg.norm((goal - place * side).clip(min=0), axis=2).mean(axis=1)
            left[~over] = distance[~over]
        last = network(place, drift, last, side, goal, half)
        seen, _, ended, late, info = env.step(last.astype(float))
        fresh = (ended | late) & ~over
        times += info["time_s"][fresh & info["success"]].tolist()
        left[fresh & info["success"] & (k <= CYCLE_EVALUATED)] = 0
        lost += int(info["dropped"][fresh].sum())
        over |= fresh
        if over.all():
            break
    took = float(np.median(times)) if times else np.nan
    return len(times) / PLATES_TESTED, took, 1e3 * float(left.mean()), lost


def drawn_layers() -> dict[str, Any]:
    """Return random weights and biases of all layers."""
    layers = {name: torch.nn.Linear(*sizes) for name, sizes in WIDTHS.items()}
    return {f"{name}_{own}": p for name, it in layers.items() for own, p in it.named_parameters()}


def counted(stages: list[Stage]) -> Iterator[tuple[int, Stage, int]]:
    """Yield the number of each update, its stage, and its number within the stage. Both numbers
    start at 1."""
    update = 0
    for stage in stages:
        for own_update in range(1, stage.updates + 1):
            update += 1
            yield update, stage, own_update


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    total = sum(stage.updates for stage in STAGES)
    parser.add_argument(
        "--task", nargs="+", default=["Sort10-v1", "Sort4-v1"],
        help="tasks of the evaluation; the training uses the regions of the first one "
        "(default: Sort10-v1 Sort4-v1)",
    )  # fmt: skip
    parser.add_argument(
        "--updates", type=int, default=total, help=f"number of updates (default: {total})"
    )
    args = parser.parse_args()
    torch.manual_seed(1)
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    envs = [gymnasium.make_vec(f"plate/{task}", num_envs=PLATES_TESTED) for task in args.task]
    own = [Model(env, len(env.unwrapped.plates.scenario.labels)) for env in envs]
    arrays, rows, began = drawn_layers(), [], time.process_time()
    network = Network(arrays, torch)
    scale = args.updates / total
    stages = [replace(stage, updates=round(scale * stage.updates)) for stage in STAGES]
    ends = np.cumsum([stage.updates for stage in stages])
    print("updates  minutes  task       solved  plate time [s]  to go [mm]  lost parts", flush=True)
    for update, stage, own_update in counted(stages):
        if own_update == 1:
            optimiser = torch.optim.Adam(arrays.values(), stage.rate)
            crowds = {n: Crowd(Model(envs[0], n), stage) for n in sorted(set(PARTS))}
        rest = (stage.updates - own_update) / stage.updates / stage.fall
        optimiser.param_groups[0]["lr"] = stage.rate * min(1, own_update / WARM_UP, rest)
        optimiser.zero_grad()
        crowd = crowds[PARTS[own_update % len(PARTS)]]
        crowd.costs(network).backward()
        torch.nn.utils.clip_grad_norm_(arrays.values(), 1.0)
        optimiser.step()
        crowd.go_on()
        if own_update % INTERVAL and update not in ends:
            continue
        kept = {name: p.detach().numpy().astype(np.float16) for name, p in arrays.items()}
        now = Network({name: values.astype(np.float32) for name, values in kept.items()})
        minutes = round((time.process_time() - began) / 60, 2)
        for task, env, model in zip(args.task, envs, own, strict=True):
            done, took, left, lost = evaluated(env, model, now)
            rows.append([update, minutes, task, done, round(took, 2), round(left, 1), lost])
            line = "{:7d}  {:7.1f}  {:9s}  {:6.2f}  {:14.1f}  {:10.1f}  {:10d}"
            print(line.format(*rows[-1]), flush=True)
        np.savez_compressed(WEIGHTS, **kept)
        with CURVE.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["updates", "minutes", "task", "done", "time_s", "to_go_mm", "lost"])
            writer.writerows(rows)


if __name__ == "__main__":
    main()
