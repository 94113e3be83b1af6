"""Compile what numba compiles, by real work, so that nobody waits for it later.

python tools/kernels.py

Compiled code is kept in NUMBA_CACHE_DIR; nothing is done while it is that of the present sources.
Every job is a process, as many at a time as there are cores.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
LOOP = [sys.executable, str(ROOT / "bench/closed_loop.py"), "--seeds", "0", "--scenario"]


def simulate_parts() -> None:
    """Simulate parts by the event-exact method, on plates that shift, shake along a line, turn."""
    from plate_core import PlateCycle, load_rig
    from plate_sim import simulate

    rig, t = load_rig(), np.arange(64) / 64 * 0.1
    wave = 2e-3 * np.column_stack([np.sin(20 * np.pi * t), np.sin(40 * np.pi * t), 0 * t])
    place, still = np.array([[0.0, 0.0], [0.021, 0.0]]), np.zeros((2, 2))
    for pose in (wave, wave * [1, 0, 0], wave + np.outer(wave[:, 0], [0, 0, 5])):
        cycle = PlateCycle.from_samples(0.1, pose)
        simulate(cycle, place, still, rig.friction.mu, cycles=2)
        simulate(cycle, place, still, rig.friction.mu, cycles=2, samples=8)


def solve_requests() -> None:
    """Solve requests for forces by both methods, for parts at rest, moving and to be turned."""
    from plate_core import load_rig
    from plate_solver import RotationSolver, SinusoidSolver, manipulability

    rig, rng = load_rig(), np.random.default_rng(0)
    for solver in (SinusoidSolver(rig), RotationSolver(rig)):
        for count in (1, 2, 4):
            place = rng.uniform(-0.8, 0.8, (count, 2)) * rig.plate.half
            force = 0.03 * rng.normal(size=(count, 2))
            solver.solve(place, force)
            solver.solve(place, force, velocity=0.01 * rng.normal(size=(count, 2)))
            solver.solve(place, force, curl=0.01 * rng.normal(size=count))
    manipulability(rig, place)


def see_parts() -> None:
    """Find parts in a picture, two of which touch; and teach them as parts of any outline."""
    from plate_core import load_rig
    from plate_sim.camera import Camera
    from plate_vision import Tracker, make_vision, observe
    from plate_vision.shapes import (
        Example,
        learn_plate,
        learn_type,
        make_catalogue,
        model_background,
    )

    rig, rng = load_rig(), np.random.default_rng(0)
    place = rig.parts.radius_m * np.array([[-0.95, 0.0], [0.95, 0.0], [5.0, 0.0]])
    image = Camera(rig).render(place, np.zeros(3), rng)
    vision = make_vision(rig)
    observe(vision, Tracker(), image, 0.0)
    apart = Camera(rig).render(place * [2.0, 1.0], np.zeros(3), rng)
    empty = Camera(rig).render(place[:0], np.zeros(0), rng)
    pictures, bare = [Example(apart)], learn_plate(empty[None])
    model_background(apart)
    part = learn_type("disc", pictures, vision.calibration, bare, vision.region).part
    vision = replace(vision, catalogue=make_catalogue({part.name: part}))
    observe(vision, Tracker(), image, 0.0)


def measure_forces() -> None:
    """Measure the mean forces of motions in every way that there is, and what is out of reach."""
    from plate_core import PlateCycle, load_rig
    from plate_solver import average_force
    from plate_solver.analysis import is_out_of_reach
    from plate_solver.maps import (
        force_rules,
        intervals,
        sinusoid_forces,
        step_forces,
        triangular_forces,
    )

    rig, rng = load_rig(), np.random.default_rng(0)
    place, still = rng.uniform(-0.1, 0.1, (3, 2)), np.zeros((3, 2))
    wave = 1e-3 * np.sin(2 * np.pi * np.arange(64) / 64)[:, None] * rng.normal(size=3)
    cycle, t = PlateCycle.from_samples(0.1, wave), np.arange(64) * 0.1 / 64
    average_force(cycle, place)
    step_forces(place, still, cycle.twist(t), np.ones(len(t)))
    motions = rng.normal(size=(3, 4, 3))
    sinusoid_forces(motions, place, still, force_rules(2))
    triangular_forces(motions, place, *intervals(2))
    close = np.array([[0.05, 0.03], [0.056, 0.03]])
    is_out_of_reach(close, np.array([[0.15, 0.1], [-0.15, 0.1]]), 2, float(rig.plate.half[0]))
    sys.path.append(str(ROOT / "bench"))
    from stages import force_map

    force_map.measure(quick=True)  # its peer is compiled too


JOBS = {
    "solver": [sys.executable, __file__, solve_requests.__name__],
    "simulator": [sys.executable, __file__, simulate_parts.__name__],
    "vision": [sys.executable, __file__, see_parts.__name__],
    "forces": [sys.executable, __file__, measure_forces.__name__],
    "tasks": [*LOOP, "follow_2"],
    "turning": [*LOOP, "spin_1", "--set", "method=rotations"],
    "many parts": [*LOOP, "assemble_8"],
    "rotations": [*LOOP, "sort_6", "--set", "method=rotations"],
    "weak motors": [*LOOP, "follow_2_desk"],
}
"""What is done, in this order."""


OWN = (solve_requests, simulate_parts, see_parts, measure_forces)
ALONE = {job.__name__: job for job in OWN}
"""Jobs that this file does itself."""


def state() -> str:
    """Return a digest of all that compiled code depends on."""
    digest = hashlib.sha256(sys.version.encode())
    for path in [Path(__file__), *sorted(ROOT.glob("src/plate_*/plate_*/**/*.py"))]:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("job", nargs="?", choices=ALONE, help="only this one, in this process")
    job = parser.parse_args().job
    if job:
        ALONE[job]()
        return 0
    done = Path(os.environ["NUMBA_CACHE_DIR"]) / "compiled"
    now = state()
    if done.exists() and done.read_text(encoding="ascii") == now:
        return 0
    began = time.monotonic()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = {pool.submit(run, words): name for name, words in JOBS.items()}
        for number, job in enumerate(as_completed(jobs), 1):
            if job.result():
                print(f"compiling: {jobs[job]} failed:\n{job.result()}", file=sys.stderr)
                return 1
            passed = time.monotonic() - began
            print(f"compiling: {number} of {len(JOBS)} ({jobs[job]}) {passed:.0f} s", flush=True)
    done.write_text(now, encoding="ascii")
    return 0


def run(words: list[str]) -> str:
    """Run a job; returns what it says if it fails."""
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.stderr[-2000:] if done.returncode else ""


if __name__ == "__main__":
    sys.exit(main())
