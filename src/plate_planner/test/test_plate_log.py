"""Which cycle ran when, told from stamps and arrivals."""

import numpy as np
import pytest

from plate_core import PlateCycle
from plate_planner.plate_log import PlateLog

SHORT, LONG = PlateCycle.rest(0.1), PlateCycle.rest(0.2)


def names(log):
    return [(round(begin, 6), "short" if cycle is SHORT else "long") for begin, cycle in log.runs]


def test_the_answer_to_an_image_runs_from_the_next_image_on():
    log = PlateLog().advance(0.0)
    assert not log.known
    log = log.hear(SHORT, 0.01).advance(0.1).hear(LONG, 0.11).advance(0.2)
    assert names(log) == [(0.1, "short"), (0.2, "long")]
    assert log.end == pytest.approx(0.4)
    assert log.period == pytest.approx(0.2)


def test_what_comes_too_late_runs_a_cycle_later_and_the_last_is_repeated():
    log = PlateLog().hear(SHORT, 0.0).advance(0.1).hear(LONG, 0.1999).advance(0.2)
    assert names(log) == [(0.1, "short"), (0.2, "short")]
    assert names(log.advance(0.3)) == [(0.1, "short"), (0.2, "short"), (0.3, "long")]


def test_a_missed_image_leaves_no_hole():
    log = PlateLog().hear(SHORT, 0.0).advance(0.1).hear(LONG, 0.1).advance(0.6)
    assert names(log) == [(0.1, "short"), (0.2, "long"), (0.4, "long"), (0.6, "long")]


def test_stamps_that_jitter_are_where_cycles_begin():
    log = PlateLog().hear(SHORT, 0.0).advance(0.1)
    for t in (0.203, 0.299, 0.401):
        log = log.advance(t)
    assert [run[0] for run in log.runs] == [0.1, 0.203, 0.299, 0.401]


def test_time_that_begins_anew():
    log = PlateLog().hear(SHORT, 5.0).advance(5.1).hear(LONG, 5.1).advance(0.0)
    assert not log.known
    assert log.heard is None


def test_pieces_cover_the_time_asked_for():
    log = PlateLog().hear(SHORT, 0.0).advance(0.1).hear(LONG, 0.1).advance(0.2)
    pieces = list(log.between(0.05, 0.35))
    assert [cycle is SHORT for cycle, _, _ in pieces] == [True, False]
    assert np.array([p[1:] for p in pieces]) == pytest.approx(np.array([[0, 0.1], [0, 0.15]]))
    assert not list(log.between(0.0, 0.1))
    # A run that was cut short by an early image is used as far as it went.
    cut = PlateLog(((0.0, SHORT), (0.09, LONG)))
    assert [p[2] - p[1] for p in cut.between(0.0, 0.29)] == pytest.approx([0.09, 0.2])


def test_it_forgets_what_is_long_past():
    log = PlateLog().hear(SHORT, 0.0)
    for k in range(1, 100):
        log = log.advance(0.1 * k)
    assert 15 <= len(log.runs) <= 17
