"""Motions that are played again: bench/tasks/horizon.py."""

from __future__ import annotations

import numpy as np

from plate_core import load_rig
from plate_solver import Limits
from plate_solver.sinusoids import ROUGH, LimitedSinusoids, limited_sinusoids
from tasks.horizon import repeated


def test_each_play_begins_in_the_state_in_which_the_last_one_has_ended():
    limits = Limits.of(load_rig())
    family = limited_sinusoids(8, 0.1, limits, 1.0, ROUGH, True, np.eye(3) * 1e-3)
    again = LimitedSinusoids(repeated(family.basis, 3), limits, 1.0, family.plate)
    own, begin, plays = 0.3 * family.random(np.random.default_rng(1)), family.plate, []
    for _ in range(3):
        plays.append(LimitedSinusoids(family.basis, limits, 1.0, begin))
        begin = plays[-1].cycle(own).state(-1)
    whole, times = again.cycle(own), np.linspace(0, 0.1, 50)[1:-1]
    for k, play in enumerate(plays):
        wanted = play.cycle(own).twist(times)
        np.testing.assert_allclose(whole.twist(0.1 * k + times), wanted, atol=1e-9)
    pose, twist = (np.vstack([play.samples(own)[k] for play in plays]) for k in (0, 1))
    np.testing.assert_allclose(again.samples(own)[0], pose, atol=1e-12)
    np.testing.assert_allclose(again.samples(own)[1], twist, atol=1e-9)
    np.testing.assert_allclose(whole.state(-1), begin, atol=1e-9)
