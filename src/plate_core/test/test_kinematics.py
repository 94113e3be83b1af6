"""Motor kinematics: against geometry, against differences in time, and there and back."""

import numpy as np
import pytest

from plate_core import CycleError, load_rig
from plate_core.motion import motor_state, plate_state
from plate_core.motion.kinematics import CONSISTENCY_TOLERANCE
from plate_core.rig import to_home

RIG = load_rig()


def random_motion(seed: int, n: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-1, 1, (n, 3)) * [0.008, 0.008, 0.04],
        rng.uniform(-1, 1, (n, 3)) * [1, 1, 4],
        rng.uniform(-1, 1, (n, 3)) * [80, 80, 300],
    )


def test_travel_is_the_displacement_of_the_attachment_along_the_motor():
    pose, twist, accel = random_motion(0, n=20)
    q, _, _ = motor_state(RIG, pose, twist, accel)
    for i, motor in enumerate(RIG.motors):
        point = np.array([motor.point])
        moved = np.array([to_home(p, point)[0] for p in pose])
        np.testing.assert_allclose(q[:, i], (moved - point) @ motor.direction, atol=1e-15)


def test_speeds_are_the_derivatives_of_the_travel():
    step = 1e-5
    pose, twist, accel = random_motion(1)

    def moved(t: float) -> np.ndarray:
        later = pose + t * twist + 0.5 * t**2 * accel
        return motor_state(RIG, later, twist + t * accel, accel)[0]

    _, qd, qdd = motor_state(RIG, pose, twist, accel)
    np.testing.assert_allclose((moved(step) - moved(-step)) / (2 * step), qd, atol=1e-5)
    second = (moved(step) - 2 * moved(0) + moved(-step)) / step**2
    np.testing.assert_allclose(second, qdd, atol=1e-3 * np.max(np.abs(qdd)))


def test_plate_state_inverts_motor_state():
    motion = random_motion(2)
    back = plate_state(RIG, *motor_state(RIG, *motion))
    for ours, theirs in zip(back, motion, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12 * np.max(np.abs(theirs)))


def test_motor_state_inverts_plate_state():
    motors = motor_state(RIG, *random_motion(3))
    there = motor_state(RIG, *plate_state(RIG, *motors))
    for ours, theirs in zip(there, motors, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12 * np.max(np.abs(theirs)))


def test_pure_turn_moves_motors_along_x_apart():
    pose = np.array([[0, 0, 0.01]])
    q = motor_state(RIG, pose, 0 * pose, 0 * pose)[0][0]
    assert q[0] < 0 < q[1]  # motor_1 is on the +y side


@pytest.mark.parametrize("motor", range(4))
def test_motor_out_of_line_is_refused(motor):
    q, qd, qdd = motor_state(RIG, *random_motion(4, n=10))
    ok = q.copy()
    ok[7, motor] += 0.5 * CONSISTENCY_TOLERANCE
    plate_state(RIG, ok, qd, qdd)
    q[7, motor] += 1e-4
    with pytest.raises(CycleError, match=r"motor_\d at sample 7 .*, allowed: 0.005 mm"):
        plate_state(RIG, q, qd, qdd)


def test_no_samples_give_none():
    empty = np.zeros((0, 4))
    assert [a.shape for a in plate_state(RIG, empty, empty, empty)] == [(0, 3)] * 3
