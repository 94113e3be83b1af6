"""One seed, one result: a run does not depend on load, threads or processors."""

import ctypes
import json
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from short_task import short_task

import plate_native
from tasks.sameness import compare_traces, run_trace

ROOT = Path(__file__).resolve().parents[1]

WIDTHS = {"x86-64": "", "x86-64-v3": "avx2", "x86-64-v4": "avx512vl"}
"""Processors for which kernels are compiled, and the features that they require."""

PRODUCT = """
#include "plate/products.hpp"
extern "C" void product_of(const double* a, const double* b, double* result) {
    plate::product(a, 7, b, 21, 1001, 7, 21, result, 21);
}
"""

ELSEWHERE = """
import json, sys
from tasks.sameness import run_trace
if __name__ == "__main__":
    print(json.dumps([run_trace(sys.argv[1], seed) for seed in (4, 3)]))
"""


def processors():
    """The entries of WIDTHS that run here. On other machines kernels are compiled for one processor
    only."""
    if platform.machine() != "x86_64":
        return ["native"]
    flags = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    return [name for name, flag in WIDTHS.items() if flag in flags]


@pytest.mark.parametrize("processor", processors())
def test_a_kernel_sums_in_order_and_rounds_each_product(tmp_path, processor):
    code, library = tmp_path / "product.cpp", tmp_path / "product.so"
    code.write_text(PRODUCT, encoding="utf-8")
    options = [*plate_native.OPTIONS, f"-I{Path(plate_native.__file__).parent / 'include'}"]
    # Without that name a function is compiled for the processor named in -march only.
    words = ["-shared", "-fvisibility=default", f"-march={processor}", "-U__gnu_linux__"]
    compiler = os.environ.get("CXX", "c++").split()
    subprocess.run([*compiler, *options, *words, str(code), "-o", str(library)], check=True)
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(1001, 7)), rng.normal(size=(1001, 21))
    result, truth = np.empty((7, 21)), np.zeros((7, 21))
    ctypes.CDLL(str(library)).product_of(*(ctypes.c_void_p(x.ctypes.data) for x in (a, b, result)))
    for row, other in zip(a, b, strict=True):
        truth += row[:, None] * other
    np.testing.assert_array_equal(result, truth)


def test_no_kernel_is_free_to_round_otherwise():
    free = re.compile(r"reduction ?\(|optimize ?\(|GCC optimize|FP_CONTRACT|\bfma ?\(")
    files = (ROOT / "src").rglob("*.[ch]pp")
    assert not [str(file) for file in files if free.search(file.read_text(encoding="utf-8"))]


def test_a_seed_gives_the_same_run_in_another_process_order_and_number_of_threads(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(yaml.safe_dump(short_task(0.005, 20)), encoding="utf-8")
    here = [run_trace(str(path), seed) for seed in (3, 4)]
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "2")
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
    assert compare_traces([(same, same), (same, other)]) == {
        "runs": 2, "same": 1, "piece": "vision", "cycle": 1,
    }  # fmt: skip
