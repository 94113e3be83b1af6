"""One task after the other in the real graph, and the statistics."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from cases.soak import fit_slope, summarise, summary_text
from graph.series import STAGES, Series, Task, run_series, stages_ms
from light_graph import LightOptions

TRIES = 10
NODES = ("simulator", "detector", "planner", "solver", "driver")


def task(number, counts=(100, 0, 0), growth=0.0, ended="done"):
    """A task that ended after a number of half minutes; memory grows by an amount per hour."""
    at = 30.0 * (number + 1)
    stamps = at + 0.2 * np.arange(50)
    hops = stamps[:, None] + 1e-3 * np.array([0, 1, 4, 9, 29, 34 + number % 2])
    memory = dict.fromkeys(NODES, 100.0 + growth * at / 3600)
    return Task(at, ended, ended == "done", counts, 100, 0, memory, hops)


def test_a_slope_has_the_interval_that_its_name_promises():
    rng = np.random.default_rng(5)
    at = np.linspace(0, 3600, 60)
    inside = 0
    for _ in range(400):
        found, wide = fit_slope(at, 3.0 * at / 3600 + rng.normal(size=60))
        inside += abs(found - 3.0) < wide
    assert 0.91 < inside / 400 < 0.98
    assert np.isnan(fit_slope(at[:2], at[:2])[0])


def test_growth_and_missed_cycles_are_reported():
    series = Series([task(k, growth=12.0) for k in range(20)], dict.fromkeys(NODES, 0.05))
    result = summarise(series)
    assert result["memory"][3]["mb_per_hour"] == pytest.approx(12.0)
    assert result["missed_share"] == 0
    assert result["latency_ms"] == pytest.approx(34.5, abs=0.51)
    assert abs(result["latency_ms_per_hour"]) < result["latency_interval"]
    series.tasks.append(task(20, counts=(100, 3, 1), ended="stuck"))
    result = summarise(series)
    assert result["missed_share"] == pytest.approx(4 / 2100)
    assert (result["done"], result["ended"]) == (20, ["stuck"])
    assert "20 of 21 tasks done" in summary_text(result)


def test_stages_add_up_to_the_whole():
    stages = stages_ms(task(0).hops)
    assert sum(np.median(stages[name]) for name in STAGES) == pytest.approx(34)
    assert stages["image to setpoints"] == pytest.approx(np.full(50, 33.0))


def broken_off(series):
    """Tasks that were broken off. On a busy computer, the planner ends others, because no cycle
    arrives in time."""
    return [one for one in series.tasks if one.ended == "running"]


def test_two_tasks_in_the_same_graph(tmp_path):
    options = LightOptions(scenario="sort_4", autostart=False)

    def enough(series):
        return len(broken_off(series)) == 2 or len(series.tasks) == TRIES

    *_, series = run_series(options, tmp_path, enough, max_s=1.5)
    assert len(broken_off(series)) == 2, [one.ended for one in series.tasks]
    first, second = broken_off(series)
    for one in (first, second):
        assert one.tables > 0
        assert one.faults == 0
        assert set(one.memory_mb) == set(NODES)
        assert len(one.hops) > 1
        assert np.all(np.diff(one.hops[:, 1:], axis=1) > 0), "published in the order of the chain"
    # The graph was not started again: its stamps go on.
    assert second.hops[0, 0] > first.hops[-1, 0]
    assert set(series.cpu) == set(NODES)
