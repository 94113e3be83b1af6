"""One seed, one answer: what a run must not depend on, and that it does not."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import yaml
from short_task import short_task

from plate_core.kernels import SAME_ROUNDING, kernel
from tasks.sameness import compared, trace

ROOT = Path(__file__).resolve().parents[1]

FREE = {
    "plate_solver/maps/mean_force.py", "plate_solver/maps/near_zero_slip.py",
    "plate_solver/maps/sinusoid_force.py", "plate_solver/sinusoids/average.py",
}  # fmt: skip
"""Kernels of the averaged map, which the loop does not call: they may round as they like."""

ELSEWHERE = """
import json, sys
from tasks.sameness import trace
if __name__ == "__main__":
    print(json.dumps([trace(sys.argv[1], seed) for seed in (4, 3)]))
"""


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _scalar_product(a, b):
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


def test_a_kernel_sums_in_order_and_rounds_each_product():
    for a, b in np.random.default_rng(0).normal(size=(20, 2, 1001)):
        assert _scalar_product(a, b) == sum((x * y for x, y in zip(a, b, strict=True)), 0.0)


def test_no_kernel_of_the_loop_is_free_to_round_otherwise():
    free = re.compile(r"fastmath=(?!SAME_ROUNDING|\{\"nsz\"\}|False)")
    files = (ROOT / "src").glob("plate_*/plate_*/**/*.py")
    assert {"/".join(file.parts[-3:]) for file in files if free.search(file.read_text())} == FREE


def test_a_seed_gives_the_same_run_in_another_process_order_and_number_of_threads(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(yaml.safe_dump(short_task(0.005, 20)), encoding="utf-8")
    here = [trace(str(path), seed) for seed in (3, 4)]
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "2")
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, str(path)],
        env={**os.environ, **threads, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True, text=True, timeout=100, check=True,
    )  # fmt: skip
    there = json.loads(done.stdout)[::-1]
    assert there == here
    assert here[0] != here[1]


def test_the_piece_that_differs_first_is_named():
    same = ["a b c d e", "f g h i j"]
    other = ["a b c d e", "f g x i y", "more"]
    assert compared([(same, same), (same, other)]) == {
        "runs": 2, "same": 1, "piece": "vision", "cycle": 1,
    }  # fmt: skip
