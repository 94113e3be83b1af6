"""Settings of all tests. Each process that runs tests has a separate ROS domain.

So the workers of a run, and two runs on a machine, do not receive each other's messages. Tests are
skipped if a tool that they need is missing. With NO_SKIP in the environment, any other skipped test
fails.
"""

import gc
import os
import time

import pytest
from graph.domains import own_domain
from needs import missing
from shared_memory import remove_leftovers

LEFT_OUT = {need: f"{need} is missing: make test-tools" for need in missing()}
SETUP = pytest.StashKey[float]()
REAL_S = 2.0
"""Duration above which a test has most likely started real nodes [s]."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    item.stash[SETUP] = time.monotonic()
    for mark in item.iter_markers("needs"):
        for need in filter(LEFT_OUT.get, mark.args):
            pytest.skip(LEFT_OUT[need])  # optional on a user's computer; CI installs them
    return (yield)


def without_skip(report):
    """Return a report. If NO_SKIP forbids its skip, it is changed to a failure."""
    if report.skipped and "NO_SKIP" in os.environ and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2]
        if reason.removeprefix("Skipped: ") not in LEFT_OUT.values():
            report.outcome, report.longrepr = "failed", f"NO_SKIP is set. {reason}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report():
    return without_skip((yield))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    return without_skip((yield))


@pytest.fixture
def clock(monkeypatch):
    """Clock of the nodes in this process. The test advances it."""
    from stepped_clock import SteppedClock  # only where there is ROS

    return SteppedClock(monkeypatch)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item):
    """Report unclosed resources of a test of real nodes with that test, not with a later one."""
    yield
    if time.monotonic() - item.stash[SETUP] > REAL_S:
        gc.collect()


def pytest_collection_finish():
    """Exclude all modules loaded so far from garbage collection: they are never unloaded."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    from lanes import Lanes  # only with pytest-xdist

    return Lanes(config, log)


def pytest_configure(config):
    if worker := getattr(config, "workerinput", None):
        from lanes import give_way

        give_way(worker)
    domain = own_domain()
    os.environ["ROS_DOMAIN_ID"] = str(domain.__enter__())
    config.add_cleanup(lambda: domain.__exit__(None, None, None))
    config.add_cleanup(remove_leftovers)  # tests kill processes
