"""Drives on a bus: error against latency, jitter and the drives' own loop.

Two parts follow paths at 40 mm/s with uneven friction. The board sends a setpoint every 2 ms. A
setpoint reaches all drives after `latency_ms` plus a random fraction of `jitter_ms`. Setpoints
never overtake each other. Planner and solver do not know this delay. The position loop of a drive
is critically damped. One kind of drive has a feedforward of the speed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from harness import Cache, Result, Table, by_case
from plate_bringup.loop import Direct, Setup, summary, with_settings
from plate_core import PlateCycle, load_rig
from plate_core.motion import quintic_pieces
from plate_sim import PlateMotion
from tasks.runs import UNEVEN, median, summarise

DRIVES = ("interpolated", "held, with its speed", "held")
"""Kinds of drives. `interpolated`: the position target moves along a straight line to the setpoint
in 2 ms, as in CiA 402. `held, with its speed`: the target is the setpoint, with its speed as
feedforward, as in an ODrive. `held`: the target is only the setpoint."""

USUAL = {"latency_ms": 1.0, "jitter_ms": 0.0, "loop_hz": 150.0}
VALUES = {
    "latency_ms": (0.0, 1.0, 2.0, 4.0), "jitter_ms": (0.0, 1.0, 2.0, 3.0, 5.0),
    "loop_hz": (75.0, 150.0, 300.0),
}  # fmt: skip
"""Values of each varied parameter. For comparison, the frames of four axes take 1 ms on a bus with
1 Mbit/s."""

BUS_STEPS, STEP_S = 4, 5e-4

FIRST_SEED, SEEDS = 83000, 3
"""First seed and number of seeds. No parameter was tuned with these seeds."""


class Driven(Direct):
    """Transport to a simulated plate, which is moved by simulated drives on a bus."""

    def __init__(
        self, drive: str, seed: int, latency_ms: float, jitter_ms: float, loop_hz: float
    ) -> None:
        super().__init__()
        self._interpolates, self._fed = drive == DRIVES[0], drive == DRIVES[1]
        self._delay_s, self._rate = 1e-3 * np.array([latency_ms, jitter_ms]), 2 * np.pi * loop_hz
        self._rng, self._steps = np.random.default_rng(seed), 0
        self._sent: list[tuple[float, np.ndarray, np.ndarray]] = []  # setpoints on the bus
        self._from, self._goal, self._speed = np.zeros((3, 3))
        self._into, self._state = BUS_STEPS, np.zeros((3, 3))
        self.squares: list[float] = []
        """Squared distances of the plate from its commanded position [m2]."""

    def play(self, until: float) -> list[PlateCycle | PlateMotion]:
        """Simulate until a given time. The drives follow the setpoints."""
        began = self.now
        [cycle] = super().play(until)
        times = np.linspace(0, cycle.period, 1 + max(1, round(cycle.period / STEP_S)))
        pose, twist, states = cycle.pose(times), cycle.twist(times), [self._state]
        for k, t in enumerate(began + times[:-1]):
            if self._steps % BUS_STEPS == 0:
                due = t + self._delay_s @ [1, self._rng.random()]
                last = self._sent[-1][0] if self._sent else due
                self._sent.append((max(due, last), pose[k], twist[k]))
            while self._sent and self._sent[0][0] < t + STEP_S / 2:
                self._from, self._into = self._target_pose(), 0
                _, self._goal, self._speed = self._sent.pop(0)
            states.append(self._advance_plate(times[1]))
            self._steps += 1
        self.squares += np.sum((np.array(states)[:, 0, :2] - pose[:, :2]) ** 2, axis=1).tolist()
        return [PlateMotion(times, quintic_pieces(times, *np.stack(states, axis=1)))]

    def _target_pose(self) -> np.ndarray:
        fraction = min(self._into / BUS_STEPS, 1) if self._interpolates else 1
        fed = 2 / self._rate * self._speed if self._fed else 0
        return self._from + (self._goal - self._from) * fraction + fed

    def _advance_plate(self, dt: float) -> np.ndarray:
        """Advance the plate by a time step, and return its state (3, 3): pose, twist and
        acceleration."""
        before, self._into = self._target_pose(), self._into + 1
        slope, rate = (self._target_pose() - before) / dt, self._rate
        behind = self._state[0] - before
        push, fade = self._state[1] - slope + rate * behind, np.exp(-rate * dt)
        behind = (behind + push * dt) * fade
        speed = push * fade - rate * behind
        position = self._target_pose() + behind
        self._state = np.stack([position, slope + speed, -rate * (2 * speed + rate * behind)])
        return self._state


def driven_run(drive: str, seed: int, bus: dict[str, float]) -> dict[str, Any]:
    """Run the task with one kind of drives. If `bus` is empty, bridges replace the drives, and the
    plate follows its setpoints exactly. Return its result."""
    line = Driven(drive, seed, **bus) if bus else Direct()
    row = summary(with_settings(Setup("follow_2", seed), UNEVEN), load_rig(), line)
    return row | {"plate_um": 1e6 * float(np.sqrt(np.mean(getattr(line, "squares", 0))))}


def measure(quick: bool) -> Result:
    """Two parts follow rectangles, with each kind of drive. Each run changes at most one value."""
    cases = [("bridges", "", 0.0)] + [
        (drive, changed, value)
        for drive in DRIVES
        for changed, values in VALUES.items()
        for value in values
        if not quick or (drive == DRIVES[0] and value == values[0])
    ]
    seeds, work = range(FIRST_SEED, FIRST_SEED + (1 if quick else SEEDS)), {}
    for drive, changed, value in cases:
        bus = USUAL | {changed: value} if changed else {}
        work[drive, changed, value] = [(drive, seed, bus) for seed in seeds]
    rows = [
        {"drive": drive, "changed": changed, "value": value}
        | summarise(runs)
        | {"plate_um": median([run["plate_um"] for run in runs])}
        for (drive, changed, value), runs in by_case(driven_run, work, Cache.of(__name__)).items()
    ]
    defaults = ", ".join(f"{key} {value:g}" for key, value in USUAL.items())
    return Result([Table.of("drives", rows, usual=defaults)])
