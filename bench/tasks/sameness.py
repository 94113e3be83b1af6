"""Bit-identical runs with the same seed: effect of load and of other processors.

Every variation runs in new processes. Each variation is compared with a run without load. In this
run, BLAS and numpy use their code for AVX2 (`ALIKE`). To represent another processor, the libraries
are forced to use the code that they would choose on that processor. The code of the project's
kernels depends only on the actual processor. The measurement has about 1000 runs.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from harness import Cache, Result, Table, by_case
from plate_bringup.loop import ALIKE, Moment, Setup, run

SCENARIOS = ("sort_10", "follow_2", "assemble_8", "align_6")
SEEDS = range(9000, 9020)

PIECES = ("simulator", "camera", "vision", "planner", "solver")
"""Names of the loop's stages, in the order of their execution."""

BUSY = 4
"""Number of extra processes that only use CPU time, in a run under load."""


@dataclass(frozen=True)
class Variation:
    """Variation of the run: its differences from the run without load.

    Attributes
    ----------
    settings : mapping
        Environment variables.
    workers, busy : int
        Number of processes that execute the runs, and number of processes that only use CPU time.
    needs : str
        Required feature of the processor, by its name in /proc/cpuinfo.
    """

    settings: Mapping[str, str] = field(default_factory=dict)
    workers: int = 1
    busy: int = 0
    needs: str = ""

    @property
    def possible(self) -> bool:
        """Whether the variation can run on this processor."""
        flags = Path("/proc/cpuinfo").read_text(encoding="ascii").split()
        return not self.needs or self.needs in flags


VARIATIONS = {
    "once more": Variation(),
    "loaded": Variation(busy=BUSY),
    "four workers": Variation(workers=4),
    "four threads": Variation({"OPENBLAS_NUM_THREADS": "4", "OMP_NUM_THREADS": "4"}),
    "libraries' own choice": Variation(dict.fromkeys(ALIKE, "")),
    "BLAS for SSE3": Variation({"OPENBLAS_CORETYPE": "Prescott"}),
    "BLAS for Skylake with AVX-512": Variation({"OPENBLAS_CORETYPE": "SkylakeX"}, needs="avx512f"),
    "numpy with AVX-512": Variation({"NPY_DISABLE_CPU_FEATURES": ""}),
    "numpy without AVX2": Variation({"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL"}),
    "C library without AVX2 and FMA": Variation(
        {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX512VL"}
    ),
    "OpenCV without AVX": Variation({"OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3,FP16,AVX"}),
    "OpenCV without IPP": Variation({"OPENCV_IPP": "disabled"}),
}


def measure(quick: bool) -> Result:
    """Run all variations. A quick measurement uses only two seeds."""
    cache, seeds = Cache.of(__name__), SEEDS[:2] if quick else SEEDS
    reference = cached_traces("quiet", Variation(), seeds, cache)
    rows: list[dict[str, Any]] = []
    for name, variation in VARIATIONS.items():
        if not variation.possible:
            continue
        found = cached_traces(name, variation, seeds, cache)
        settings = " ".join(f"{key}='{value}'" for key, value in variation.settings.items())
        for scenario in SCENARIOS:
            pairs = list(zip(reference[scenario], found[scenario], strict=True))
            row = {"variation": name, "settings": settings, "scenario": scenario}
            rows.append(row | compare_traces(pairs))
    alike = " ".join(f"{key}='{value}'" for key, value in ALIKE.items())
    return Result([Table.of("sameness", rows, seeds=len(seeds), alike=alike)])


def cached_traces(
    name: str, variation: Variation, seeds: range, cache: Cache
) -> dict[str, list[list[str]]]:
    """Return the traces of every scenario in a variation, by seed. Only runs that are not in the
    cache are executed."""
    work = {(name, scenario): [(scenario, seed) for seed in seeds] for scenario in SCENARIOS}
    with environment_of(variation):
        found = by_case(run_trace, work, cache, variation.workers)
    return {scenario: runs for (_, scenario), runs in found.items()}


def run_trace(scenario: str, seed: int) -> list[str]:
    """Run the loop. Return the digests of each stage's output, one string per cycle."""
    return [" ".join(map(digest, made(moment))) for moment in run(Setup(scenario, seed))]


def made(moment: Moment) -> Iterator[list[np.ndarray]]:
    """Yield the output of each stage in `PIECES`."""
    world, parts, request, cycle = moment.world, moment.parts, moment.request, moment.result.cycle
    forces, start = request.forces, [] if request.start is None else [request.start]
    yield [world.position, world.angle]
    yield [moment.image]
    yield [parts.position, parts.angle]
    yield [forces.force, forces.tolerance, *start]
    yield [cycle.times, cycle.knot_pose, cycle.knot_twist, cycle.knot_accel]


def digest(arrays: list[np.ndarray]) -> str:
    """Return a short digest of arrays."""
    return hashlib.blake2b(b"".join(a.tobytes() for a in arrays), digest_size=4).hexdigest()


def compare_traces(pairs: list[tuple[list[str], list[str]]]) -> dict[str, Any]:
    """Return the number of equal pairs of traces, and the first difference of the unequal pairs."""
    others = [pair for pair in pairs if pair[0] != pair[1]]
    row = {"runs": len(pairs), "same": len(pairs) - len(others), "piece": None, "cycle": None}
    for cycle, (a, b) in enumerate(zip(*others[0], strict=False)) if others else ():
        if a != b:
            unlike = [x != y for x, y in zip(a.split(), b.split(), strict=True)]
            return row | {"piece": PIECES[unlike.index(True)], "cycle": cycle}
    return row


@contextmanager
def environment_of(variation: Variation) -> Iterator[None]:
    """Context in which new processes get the settings and the load of a variation."""
    before = dict(os.environ)
    with ExitStack() as stack:
        stack.callback(os.environ.update, before)
        stack.callback(os.environ.clear)
        os.environ.update({**ALIKE, **variation.settings})
        for _ in range(variation.busy):
            loop = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(loop.kill)
        yield
