"""For all tests: each process that runs some has a ROS domain of its own.

So neither the workers of one run nor two runs on a machine hear each other.
"""

import gc
import os
import time
from pathlib import Path

import pytest
from graph.domains import own_domain

BEGAN = time.time()
SETUP = pytest.StashKey[float]()
REAL_S = 2.0
"""Tests that take longer [s] most likely had real nodes."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    item.stash[SETUP] = time.monotonic()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item):
    """What a test of real nodes leaves open is reported by that test, not by a later one."""
    yield
    if time.monotonic() - item.stash[SETUP] > REAL_S:
        gc.collect()


def pytest_configure(config):
    domain = own_domain()
    os.environ["ROS_DOMAIN_ID"] = str(domain.__enter__())
    config.add_cleanup(lambda: domain.__exit__(None, None, None))


def pytest_terminal_summary(terminalreporter):
    """Tell what tools/kernels.py has not compiled before."""
    kept = Path(os.environ.get("NUMBA_CACHE_DIR", "nowhere")).rglob("*.nbi")
    new = [path.name.rsplit("-", 1)[0] for path in kept if path.stat().st_mtime > BEGAN]
    if new:
        text = f"{len(new)} kernels were compiled meanwhile: {', '.join(sorted(new))}"
        terminalreporter.write_line(text)
