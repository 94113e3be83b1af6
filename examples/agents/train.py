"""Train a small network that computes each motion directly, with gradients through friction.

The network acts for some cycles in a model of the plate in which parts are points. The gradient of
the parts' distances from their targets is propagated back through friction and motions to the
network's weights. Therefore the network learns without a solver and without rewards. Run it in this
folder, in a separate environment (pip install ../../src/plate_gym -r requirements.txt):

    python train.py

The program writes weights.npz, and curve.csv with the network's results on plates of plate_gym
during the training. The training takes about 20 minutes on one core:

    updates                     400   800  1200  2000  4000  8000
    done [%]                     42    86   100   100   100   100
    plate time, median [s]     20.7  13.9  10.1   8.4   7.7   7.2

The final plate time is twice as long as with Method B. A decision takes 0.1 ms instead of 30 ms. In
the disturbed worlds, which were not used in training, the task takes at most 5 % longer. With ten
parts (`--task Sort10-v1`), the network sorted no plate after 1,000 updates. Another network, which
averages features of the parts, sorted none of 30 plates with ten parts after 2,353 updates (6
minutes on one core). Longer training was not tried.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from learned import WEIGHTS, Network, features
from numba import njit

import plate_gym  # noqa: F401, registers the environments
from plate_solver import Limits
from plate_solver.sinusoids import sinusoid_basis

WIDTH = 256
"""Number of neurons in each of the two hidden layers."""

PLATES, CYCLES = 512, 8
"""Number of plates in parallel, and number of cycles through which the gradient is propagated."""

RATE = 3e-3
"""Initial learning rate, which decreases linearly to 0."""

STEPS = 64
"""Number of time steps per cycle in the model."""

MAX_CYCLES = 120
"""Maximum number of cycles after which a plate of the model is reset."""

EDGE_M, EDGE_COST = 0.03, 2.0
"""Width of the zone at the edges in which a part has a cost [m], and the cost at the edge itself
[100 mm of distance to go]."""

CLEAR_M = 0.02
"""If the centres of two parts are nearer than this distance, the parts have a cost [m]."""

PLATES_TESTED, SEED = 64, 200_000
"""Number of plates of plate_gym for the evaluation, and their first seed."""

CYCLES_TESTED, ROWS = 400, 20
"""Maximum number of cycles per evaluation, and number of evaluations."""

CURVE = Path(__file__).with_name("curve.csv")


@njit(fastmath=True, cache=True)
def slide(state: Any, pose: Any, twist: Any, limit: float, dt: float, kept: Any) -> None:
    """Simulate the parts for a cycle, with point friction and explicit time steps.

    With the slip s = plate velocity below the part - v, each step is
    v' = v + s min(1, most / norm(s)), then p' = p + dt v'.

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
    kept : (n, 4, M, N)
        Output: positions and slips of the parts at each step.
    """
    x, y, u, v = state
    for i in range(len(pose)):
        for m in range(x.shape[0]):
            for k in range(x.shape[1]):
                spin = twist[i, 2, k]
                slip_x = twist[i, 0, k] - spin * (y[m, k] - pose[i, 1, k]) - u[m, k]
                slip_y = twist[i, 1, k] + spin * (x[m, k] - pose[i, 0, k]) - v[m, k]
                kept[i, 0, m, k], kept[i, 1, m, k] = x[m, k], y[m, k]
                kept[i, 2, m, k], kept[i, 3, m, k] = slip_x, slip_y
                fraction = limit / max(np.sqrt(slip_x * slip_x + slip_y * slip_y), limit)
                u[m, k] += fraction * slip_x
                v[m, k] += fraction * slip_y
                x[m, k] += dt * u[m, k]
                y[m, k] += dt * v[m, k]


@njit(fastmath=True, cache=True)
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
        for m in range(x.shape[0]):
            for k in range(x.shape[1]):
                slip_x, slip_y, spin = kept[i, 2, m, k], kept[i, 3, m, k], twist[i, 2, k]
                own_x, own_y = u[m, k] + dt * x[m, k], v[m, k] + dt * y[m, k]
                square = slip_x * slip_x + slip_y * slip_y
                slides = square > limit * limit
                fraction = limit / np.sqrt(square) if slides else 1.0
                along = (slip_x * own_x + slip_y * own_y) / square if slides else 0.0
                by_x, by_y = (
                    fraction * (own_x - along * slip_x),
                    fraction * (own_y - along * slip_y),
                )
                u[m, k], v[m, k] = own_x - by_x, own_y - by_y
                x[m, k] += spin * by_y
                y[m, k] -= spin * by_x
                by_twist[i, 0, k] += by_x
                by_twist[i, 1, k] += by_y
                off_x, off_y = kept[i, 0, m, k] - pose[i, 0, k], kept[i, 1, m, k] - pose[i, 1, k]
                by_twist[i, 2, k] += off_x * by_y - off_y * by_x
                by_pose[i, 0, k] -= spin * by_y
                by_pose[i, 1, k] += spin * by_x


class Slide(torch.autograd.Function):
    """`slide` as a differentiable function of torch."""

    @staticmethod
    def forward(ctx: Any, state: Any, pose: Any, twist: Any, limit: float, dt: float) -> Any:
        """Return the state after a cycle."""
        after, *motion = (values.detach().numpy() for values in (state, pose, twist))
        after, limit, dt = after.copy(), np.float32(limit), np.float32(dt)
        kept = np.empty((len(pose), *after.shape), np.float32)
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
    """Differentiable model of N plates with parts, and of the cost of sorting to sides or
    corners."""

    def __init__(self, env: Any) -> None:
        plates = env.unwrapped.plates
        rig, self._scale = plates.rig, tensor(plates.motions.scale)
        own = plates.motions.basis
        basis = sinusoid_basis(len(own.span) // 2, own.period, True, STEPS)
        self._pose, self._twist = tensor(basis.pose), tensor(basis.twist)
        self.half, self.period, self._dt = tensor(rig.plate.half), own.period, basis.dt
        self._max_change = rig.friction.mu * rig.friction.gravity * basis.dt
        limits = Limits.of(rig, 1.0)
        levers = tensor(limits.levers)
        signs = tensor(list(itertools.product((1, -1), repeat=2)))
        (right, up), flat = (signs * self.half).T, torch.zeros(4)
        self._corners = torch.stack([flat + 1, flat, -up]), torch.stack([flat, flat + 1, right])
        pose, twist, self._accel = map(tensor, basis.checks)
        self._max_accel = limits.accel
        self._projections = [
            (pose, levers.T, limits.stroke_m),
            (twist, levers.T, limits.speed),
            (self._accel, levers.T, limits.accel),
        ]
        task = plates.scenario.task
        sides = [task.regions[label] for label in plates.scenario.labels]
        self._side = tensor([[side.x, side.y] for side in sides])
        self._goal = task.goal_fraction * self._side.abs() * self.half
        self.parts = len(sides)

    def limited(self, actions: Any) -> Any:
        """Return the coefficients (N, 6, 3) of actions (N, 18), scaled down to the rig's limits."""
        own = actions.reshape(len(actions), -1, 3) * self._scale
        used = [
            (basis @ own @ direction).abs() / limit for basis, direction, limit in self._projections
        ]
        along_x, along_y = (self._accel @ own @ direction for direction in self._corners)
        used.append(torch.hypot(along_x, along_y) / self._max_accel)
        limit = torch.cat(used, dim=1).amax((1, 2))
        return own / limit.clip(min=1)[:, None, None]

    def after(self, place: Any, speed: Any, own: Any) -> tuple[Any, Any]:
        """Return positions and velocities (N, M, 2) of the parts after a cycle with coefficients
        (N, 6, 3)."""
        flat = own.permute(1, 2, 0).reshape(own.shape[1], -1)
        pose, twist = ((basis @ flat).reshape(STEPS, 3, -1) for basis in (self._pose, self._twist))
        state = torch.cat([place.permute(2, 1, 0), speed.permute(2, 1, 0)]).contiguous()
        state = Slide.apply(state, pose, twist, self._max_change, self._dt)
        return state[:2].permute(2, 1, 0), state[2:].permute(2, 1, 0)

    def distances(self, place: Any) -> Any:
        """Return the distances (N, M) of the parts from their targets [m]."""
        gaps = (self._goal - place * self._side).clip(min=0)
        return torch.sqrt((gaps**2).sum(-1) + 1e-12)

    def cost(self, place: Any) -> Any:
        """Return the cost (N,) of positions (N, M, 2): distances to go, plus costs of parts near
        edges and near each other."""
        distance = self.distances(place) / 0.1
        beyond = ((place.abs() - self.half) / EDGE_M + 1).clip(min=0)
        gap = torch.sqrt(((place[:, :, None] - place[:, None]) ** 2).sum(-1) + 1e-12)
        near = ((CLEAR_M - gap) / 0.2).clip(min=0).triu(1).sum((1, 2))
        far = (torch.sqrt(distance**2 + 0.01) - 0.1 + distance**2 / 2).mean(1)
        return far + EDGE_COST * (beyond**2).sum((1, 2)) + near


def tensor(values: Any) -> Any:
    """Return values as a float32 tensor."""
    return torch.tensor(np.asarray(values), dtype=torch.float32)


class Crowd:
    """Simulated plates on which the network acts during training. Finished plates are reset."""

    def __init__(self, model: Model) -> None:
        self._model, parts = model, (PLATES, model.parts, 2)
        self.place, self.speed, self.drift = self._drawn(PLATES), *torch.zeros(2, *parts)
        self.last, self.own = torch.zeros(PLATES, 18), torch.zeros(PLATES, 6, 3)
        self._age = torch.zeros(PLATES)

    def costs(self, network: Any) -> Any:
        """Let the network act for `CYCLES`. Return the mean cost of the positions, in which the
        final position counts twice."""
        model, total = self._model, 0.0
        for _ in range(CYCLES):
            found = network(features(self.place, self.drift, self.last, model.half, torch))
            self.last = found / found.abs().amax(1, keepdim=True).clip(min=1)
            before = self.place
            self.place, self.speed = model.after(before, self.speed, self.own)
            self.drift, self.own = (self.place - before) / model.period, model.limited(self.last)
            total = total + model.cost(self.place)
        place, speed = model.after(self.place, self.speed, self.own)  # play the last action
        return (total + 2 * model.cost(place + model.period / 2 * speed)).mean() / (CYCLES + 2)

    def go_on(self) -> None:
        """Detach all tensors from the gradient. Reset plates that lost a part, are sorted, or have
        run for more than `MAX_CYCLES` cycles."""
        for name, values in list(vars(self).items()):
            if torch.is_tensor(values):
                setattr(self, name, values.detach())
        off = (self.place.abs() > self._model.half).flatten(1).any(1)
        done = (self._model.distances(self.place) < 1e-5).all(1) & (torch.rand(PLATES) < 0.3)
        self._age += CYCLES
        restarted = off | done | (self._age > MAX_CYCLES)
        self.place[restarted] = self._drawn(int(restarted.sum()))
        for values in (self.speed, self.drift, self.last, self.own, self._age):
            values[restarted] = 0

    def _drawn(self, count: int) -> Any:
        inner = self._model.half - CLEAR_M
        return (2 * torch.rand(count, self._model.parts, 2) - 1) * inner


def evaluated(env: Any, network: Network) -> tuple[float, float, int]:
    """Return the fraction of plates that were sorted, their median time [s], and the number of lost
    parts."""
    half = env.unwrapped.plates.rig.plate.half
    seen, _ = env.reset(seed=SEED)
    last, over = np.zeros((PLATES_TESTED, 18)), np.zeros(PLATES_TESTED, bool)
    lost, times = 0, []
    for _ in range(CYCLES_TESTED):
        last = network(features(seen[:, :, :2], seen[:, :, 2:4], last, half))
        seen, _, ended, late, info = env.step(last)
        fresh = (ended | late) & ~over
        times += info["time_s"][fresh & info["success"]].tolist()
        lost += int(info["dropped"][fresh].sum())
        over |= fresh
        if over.all():
            break
    return len(times) / PLATES_TESTED, float(np.median(times)) if times else np.nan, lost


def layers_of(network: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the weights and biases of each linear layer as numpy arrays."""
    linear = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    return [tuple(p.detach().numpy().copy() for p in (own.weight, own.bias)) for own in linear]


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--task", default="Sort4-v1", help="environment, such as Sort10-v1 (default: Sort4-v1)"
    )
    parser.add_argument(
        "--updates", type=int, default=8000, help="number of updates of the weights (default: 8000)"
    )
    args = parser.parse_args()
    torch.manual_seed(1)
    torch.set_num_threads(1)
    env = gymnasium.make_vec(f"plate/{args.task}", num_envs=PLATES_TESTED)
    model = Model(env)
    crowd, sizes = Crowd(model), (4 * model.parts + 18, WIDTH, WIDTH, 18)
    layers = [torch.nn.Linear(*pair) for pair in itertools.pairwise(sizes)]
    network = torch.nn.Sequential(layers[0], torch.nn.ReLU(), layers[1], torch.nn.ReLU(), layers[2])
    optimiser = torch.optim.Adam(network.parameters(), RATE)
    rows, began = [], time.process_time()
    print("updates  minutes  solved  plate time [s]  lost parts", flush=True)
    for update in range(1, args.updates + 1):
        optimiser.param_groups[0]["lr"] = RATE * (1 - update / args.updates)
        optimiser.zero_grad()
        crowd.costs(network).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        crowd.go_on()
        if update * ROWS // args.updates == len(rows):
            continue
        found = layers_of(network)
        done, took, lost = evaluated(env, Network(found))
        minutes = round((time.process_time() - began) / 60, 2)
        rows.append([update, minutes, done, round(took, 2), lost])
        print("{:7d}  {:7.1f}  {:6.2f}  {:14.1f}  {:10d}".format(*rows[-1]), flush=True)
        arrays = {
            f"{name}_{k}": values.astype(np.float32)
            for k, layer in enumerate(found)
            for name, values in zip(("weight", "bias"), layer, strict=True)
        }
        np.savez_compressed(WEIGHTS, **arrays)
        with CURVE.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["updates", "minutes", "done", "time_s", "lost"])
            writer.writerows(rows)


if __name__ == "__main__":
    main()
