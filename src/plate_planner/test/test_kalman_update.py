"""The Kalman update of parts with one uncertain stamp, against the plain one of all at once."""

import numpy as np
import pytest

from plate_planner.estimation.filter import (
    CAMERA_M,
    FIRST_SEEN,
    FRICTION_RANGE,
    PUSHED_SIGMA,
    kalman_update,
)

JITTER = 4e-4
PUSH_M = 5e-3


def parts(rng, hypotheses=2, count=3):
    """Return means, covariances, and places that the camera may well see."""
    mean = rng.normal(0, [0.1, 0.1, 0.1, 0.1, 0.1], (hypotheses, count, 5))
    root = rng.normal(0, 1, (hypotheses, count, 5, 5)) * FIRST_SEEN[:, None]
    covariance = root @ root.swapaxes(-1, -2) / 5
    mean[1:] = mean[0]
    late = JITTER * rng.normal()
    noise = CAMERA_M * rng.normal(size=(count, 2))
    return mean, covariance, mean[0, :, :2] + late * mean[0, :, 2:4] + noise


def all_at_once(mean, covariance, seen):
    """Return mean, covariance and log likelihood of one hypothesis: K parts and the stamp's
    deviate are one state (5 K + 1,), and all places one measurement (2 K,)."""
    count = len(mean)
    state, spread = np.zeros(5 * count + 1), np.zeros((5 * count + 1,) * 2)
    shows = np.zeros((2 * count, 5 * count + 1))
    for k in range(count):
        block = slice(5 * k, 5 * k + 5)
        state[block], spread[block, block] = mean[k], covariance[k]
        shows[2 * k : 2 * k + 2, 5 * k : 5 * k + 2] = np.eye(2)
        shows[2 * k : 2 * k + 2, -1] = mean[k, 2:4]
    spread[-1, -1] = JITTER**2
    innovation = seen.ravel() - shows @ state
    expected = shows @ spread @ shows.T + CAMERA_M**2 * np.eye(2 * count)
    gain = spread @ shows.T @ np.linalg.inv(expected)
    after, rest = state + gain @ innovation, spread - gain @ shows @ spread
    likelihood = -0.5 * (
        innovation @ np.linalg.solve(expected, innovation) + np.linalg.slogdet(expected)[1]
    )
    blocks = np.array([rest[5 * k : 5 * k + 5, 5 * k : 5 * k + 5] for k in range(count)])
    return after[:-1].reshape(count, 5), blocks, likelihood


@pytest.mark.parametrize("seed", range(4))
def test_the_update_equals_one_joint_update_of_all_parts_and_the_stamp(seed):
    mean, covariance, seen = parts(np.random.default_rng(seed))
    after, rest, innovations = kalman_update(mean, covariance, seen, JITTER)
    for a in range(len(mean)):
        exact, blocks, likelihood = all_at_once(mean[a], covariance[a], seen)
        np.testing.assert_allclose(after[a], exact, rtol=1e-7, atol=1e-12)
        np.testing.assert_allclose(rest[a], blocks, rtol=1e-6, atol=1e-14)
        assert innovations.log_likelihood[a] == pytest.approx(likelihood, rel=1e-9)


def test_a_part_that_was_pushed_is_as_if_seen_for_the_first_time_but_for_its_friction():
    mean, covariance, seen = parts(np.random.default_rng(7))
    seen[1] += PUSH_M
    after, rest, _ = kalman_update(mean, covariance, seen, JITTER)
    others_after, others_rest, _ = kalman_update(
        mean[:, [0, 2]], covariance[:, [0, 2]], seen[[0, 2]], JITTER
    )
    for a in range(len(mean)):
        np.testing.assert_array_equal(after[a, 1, :2], seen[1])
        np.testing.assert_array_equal(after[a, 1, 2:], mean[a, 1, 2:])
        variance = FIRST_SEEN**2
        variance[4] = covariance[a, 1, 4, 4]
        np.testing.assert_array_equal(rest[a, 1], np.diag(variance))
    np.testing.assert_allclose(after[:, [0, 2]], others_after, rtol=1e-9)
    np.testing.assert_allclose(rest[:, [0, 2]], others_rest, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("fraction", [0.9, 1.1])
def test_a_part_is_pushed_beyond_six_standard_deviations(fraction):
    mean, covariance = np.zeros((1, 1, 5)), np.diag(FIRST_SEEN**2)[None, None]
    sigma = np.hypot(FIRST_SEEN[0], CAMERA_M)
    seen = np.array([[0.0, fraction * PUSHED_SIGMA * sigma]])
    after, rest, innovations = kalman_update(mean, covariance, seen, JITTER)
    gain = FIRST_SEEN[0] ** 2 / sigma**2
    if fraction < 1:
        assert after[0, 0, 1] == pytest.approx(gain * seen[0, 1])
        assert rest[0, 0, 1, 1] == pytest.approx((1 - gain) * FIRST_SEEN[0] ** 2)
    else:
        assert after[0, 0, 1] == seen[0, 1]
        assert rest[0, 0, 1, 1] == FIRST_SEEN[0] ** 2
    assert innovations.square[0] == pytest.approx(min(fraction, 1) ** 2 * PUSHED_SIGMA**2 / 2)


@pytest.mark.parametrize("of_type", [-0.5, 0.0, 0.5])
def test_friction_stays_within_its_range_about_that_of_the_type(of_type):
    mean, covariance, seen = parts(np.random.default_rng(1), 1, 2)
    mean[0, :, 4] = [-9, 9]
    after, _, _ = kalman_update(mean, covariance, seen, JITTER, np.full(2, of_type))
    assert after[0, :, 4] == pytest.approx([of_type - FRICTION_RANGE, of_type + FRICTION_RANGE])
