"""Every scenario over many seeds in a world with dirt, and what spoils it: the table of successes.

Some 2,000 runs: two hours on two cores. Every run is kept in `out/bench/tasks.jsonl` as soon as it
has ended: a measurement that was cut short goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from harness import Result, Table
from loop import Setup, with_settings
from spread import processes
from store import Store

from plate_core import Rig, load_rig
from plate_core.rig import Suspension, mass_matrix, modal_matrices

FIRST_SEED = 20_000
"""No parameter was ever chosen by runs with this seed or a later one."""

DIRT = {"friction_spread": "0.1", "friction_patches": "0.1"}
"""Friction differs by 10 % between parts and over the plate."""

LATE, LOST = {"latency": "0.05"}, {"missed_parts": "0.05", "false_parts": "0.01"}

MOTOR_GAIN = (1.1, 0.9, 1.1, 0.9)
"""Motors that give 10 % more or less force than asked."""

WORKERS = 2


@dataclass(frozen=True)
class World:
    """What is not as the planner and the solver think.

    Attributes
    ----------
    settings : mapping of str to str
        Of `bench/closed_loop.py`.
    weak_motors : bool
        The motors' forces are off by `MOTOR_GAIN`.
    """

    settings: Mapping[str, str] = field(default_factory=dict)
    weak_motors: bool = False


WORLDS = {
    "clean": World(),
    "dirt": World(DIRT),
    "dirt, friction 30 % less": World(DIRT | {"mu_scale": "0.7"}),
    "dirt, friction 30 % more": World(DIRT | {"mu_scale": "1.3"}),
    "dirt, motors off by 10 %": World(DIRT, weak_motors=True),
    "dirt, images 50 ms late": World(DIRT | LATE),
    "dirt, 5 % missed, 1 % false": World(DIRT | LOST),
    "all of these": World(DIRT | LATE | LOST | {"mu_scale": "0.7"}, weak_motors=True),
}

CASES = (
    ("sort_10", "sinusoids", "dirt", 300),
    ("follow_2", "sinusoids", "dirt", 100),
    ("follow_5", "sinusoids", "dirt", 100),
    ("assemble_8", "sinusoids", "dirt", 100),
    ("sort_16", "sinusoids", "dirt", 100),
    ("follow_3", "sinusoids", "dirt", 20),
    ("spin_1", "sinusoids", "dirt", 20),
    ("follow_2", "sinusoids", "clean", 20),
    *((name, "sinusoids", world, 50)
      for world in list(WORLDS)[2:] for name in ("sort_10", "follow_2")),
    ("sort_10", "rotations", "dirt", 300),
    ("follow_2", "rotations", "dirt", 20),
    ("sort_4", "sinusoids", "dirt", 20),
    ("coin_circle", "sinusoids", "dirt", 20),
    ("spin_1", "rotations", "dirt", 20),
)  # fmt: skip
"""Scenario, method, world, seeds."""


def measure(quick: bool) -> Result:
    """Run all cases."""
    rig = load_rig()
    cases = [("follow_2", "sinusoids", "dirt", 2)] if quick else list(CASES)
    rows = []
    with processes(WORKERS) as pool:
        store = Store("tasks", pool)
        for name, method, world, count in cases:
            played = weak(rig) if WORLDS[world].weak_motors else rig
            runs = store.runs(played, _setups(name, method, world, count))
            rows.append({"scenario": name, "method": method, "world": world} | _row(runs))
            if not quick:
                print("\n  " + _sentence(rows[-1]), end="", flush=True)
    columns = {
        "scenario": "scenario", "method": "method", "world": "world", "succeeded": "succeeded",
        "dropped": "dropped", "time_s": "time, median [s]", "longest_s": "longest [s]",
        "rms_mm": "RMS error, median [mm]", "worst_rms_mm": "of the worst run [mm]",
        "max_mm": "largest error [mm]", "turn_deg": "largest angle left [deg]",
        "step_ms": "step, median [ms]", "step_p99_ms": "step, 99 % [ms]",
    }  # fmt: skip
    note = (
        f"Seeds from {FIRST_SEED} on, Gamma = {rig.gamma:.1f}. Dirt: friction uneven by 10 % "
        "between parts and over the plate. Time is simulated. Errors of assembling are those at "
        "the end. A step goes from the image to the motors' table: time of all cores together; "
        "99 % of the steps of one run, median over runs."
    )
    return Result(
        [Table("tasks", "Tasks over many seeds", columns, rows, note)],
        [_sentence(row) for row in rows],
    )


def _setups(scenario: str, method: str, world: str, count: int) -> dict[str, Setup]:
    """Return the runs of one case by name."""
    settings = WORLDS[world].settings
    return {
        f"{scenario} {method} {world} {seed}": with_settings(
            Setup(scenario, seed, method), settings
        )
        for seed in range(FIRST_SEED, FIRST_SEED + count)
    }


def weak(rig: Rig) -> Rig:
    """Return the rig with motors that do not give the force that is asked of them.

    The plate hangs softly (5 Hz, well damped), and its drive knows it by heart but for the motors.
    """
    plate = rig.plate
    inertia = plate.mass_kg * (plate.length_m**2 + plate.width_m**2) / 12
    mass = mass_matrix(plate.mass_kg, inertia)
    damping, stiffness = modal_matrices(mass, np.full(3, 5.0), np.full(3, 0.5))
    hung = Suspension(mass, damping, stiffness, (1.0, 1.0, 1.0), motor_gain=MOTOR_GAIN)
    return replace(rig, suspension=hung)


def _row(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum up the runs of one case."""
    good = [run for run in runs if run["success"]]
    times = [run["time_s"] for run in good] or [float("nan")]
    rms = [1e3 * run["rms_error_m"] for run in runs if run["rms_error_m"] is not None]
    most = [1e3 * run["max_error_m"] for run in runs if run["max_error_m"] is not None]
    turns = [run["turn_error_deg"] for run in runs if run["turn_error_deg"] is not None]
    return {
        "succeeded": f"{len(good)} of {len(runs)}",
        "dropped": sum(run["dropped"] for run in runs),
        "time_s": float(np.median(times)),
        "longest_s": max(times),
        "rms_mm": float(np.median(rms)) if rms else None,
        "worst_rms_mm": max(rms) if rms else None,
        "max_mm": max(most) if most else None,
        "turn_deg": max(turns) if turns else None,
        "step_ms": float(np.median([run["step_ms_median"] for run in runs])),
        "step_p99_ms": float(np.median([run["step_ms_p99"] for run in runs])),
    }


def _sentence(row: dict[str, Any]) -> str:
    text = f"{row['scenario']}, {row['method']}, {row['world']}: {row['succeeded']}"
    text += f", median {row['time_s']:.1f} s, longest {row['longest_s']:.1f}"
    if row["dropped"]:
        text += f", {row['dropped']} parts dropped"
    if row["rms_mm"] is not None:
        text += f", RMS {row['rms_mm']:.2f} mm, worst {row['worst_rms_mm']:.2f}"
    return text
