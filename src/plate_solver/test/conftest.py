"""Fixtures of the solver's tests: the rig, random scenes, and checks of kernels."""

import numpy as np
import pytest

from plate_core import Rig, load_rig
from plate_solver import Goal, Limits, _kernels
from plate_solver._kernels import EXCESS_M
from plate_solver.sinusoids import Motions, Problem, SinusoidFamily, descend, sinusoid_basis


@pytest.fixture(scope="session")
def rig() -> Rig:
    return load_rig()


@pytest.fixture(scope="session")
def scene(rig):
    """Function (seed, count) to (rng, positions (M, 2) [m] at least 4 cm apart)."""

    def make(seed: int, count: int) -> tuple[np.random.Generator, np.ndarray]:
        rng = np.random.default_rng(seed)
        chosen = np.empty((0, 2))
        while len(chosen) < count:
            new = rng.uniform(-0.85, 0.85, 2) * rig.plate.half
            if np.all(np.hypot(*(chosen - new).T) >= 0.04):
                chosen = np.vstack([chosen, new])
        return rng, chosen

    return make


@pytest.fixture(scope="session")
def excess_of():
    """Function from (family, limits, theta) to the errors that `descend` adds if limits are
    exceeded: (K,) [m], and their negative derivatives (K, P)."""
    still = np.zeros((1, 2))
    goal = Goal(still, still, still, still, np.ones(1))

    def find(family: SinusoidFamily, limits: Limits, theta: np.ndarray) -> tuple[np.ndarray, ...]:
        problem = Problem.of(goal, Motions.of(family.basis, limits), np.inf)
        found = descend(problem, theta, 0.0, 0)
        return found.error[goal.rows :], found.jacobian[goal.rows :]

    return find


@pytest.fixture(scope="session")
def check_excess_slopes(excess_of):
    """Function (limits, period) that compares the derivatives of `excess_of` with differences, for
    random motions that exceed the limits."""

    def check(limits: Limits, period: float = 0.1) -> None:
        limited = SinusoidFamily(sinusoid_basis(3, period, True, 200), limits)
        rng = np.random.default_rng(0)
        for _ in range(5):
            theta = 1.2 * limited.random(rng)
            _, slopes = excess_of(limited, limits, theta)
            way = rng.normal(size=theta.size)
            step = 1e-7 * np.linalg.norm(theta) / np.linalg.norm(way)
            ahead, behind = (
                excess_of(limited, limits, theta + sign * step * way)[0] for sign in (1, -1)
            )
            assert len(ahead) == len(behind) == len(slopes) > 0
            difference = (behind - ahead) / (2 * step)
            np.testing.assert_allclose(slopes @ way, difference, rtol=1e-5, atol=1e-6 * EXCESS_M)

    return check


@pytest.fixture
def through_twist():
    """Derivatives by pose (2, n, R) and twist (3, n, R) at the middles of steps, as those by twist
    alone: the pose follows from it."""

    def add(on_pose, on_twist, dt):
        later = np.cumsum(on_pose[:, ::-1], axis=1)[:, ::-1] - on_pose / 2
        return on_twist + dt * np.concatenate([later, np.zeros_like(on_twist[:1])])

    return add


def spoilt(array):
    """Arrays that cannot stand for this one: of other sizes, axes and types."""
    for axis in range(array.ndim):
        yield np.repeat(array, 2, axis=axis)
    yield array[None]
    yield array.astype(complex)
    yield None


@pytest.fixture(scope="session")
def check_refusals():
    """Function that gives a kernel wrong arrays, each one alone, also within named tuples.

    `free` are the arguments that may be wrong: (kernel, number or field, axis), or a field of any
    kernel.
    """

    def check(name: str, right: tuple, free: set) -> None:
        kernel = getattr(_kernels, name)
        kernel(*right)

        def refuses(array, key, put):
            for number, wrong in enumerate(spoilt(array)):
                if (name, key, number) not in free and key not in free:
                    with pytest.raises((TypeError, ValueError, RuntimeError)):
                        kernel(*put(wrong))

        for at, argument in enumerate(right):
            before, after = right[:at], right[at + 1 :]
            if isinstance(argument, np.ndarray):
                refuses(argument, at, lambda wrong, b=before, a=after: (*b, wrong, *a))
            elif isinstance(argument, tuple) and hasattr(argument, "_fields"):
                for field, value in argument._asdict().items():
                    if isinstance(value, np.ndarray):
                        refuses(
                            value, field,
                            lambda wrong, b=before, a=after, one=argument, field=field: (
                                *b, one._replace(**{field: wrong}), *a
                            ),
                        )  # fmt: skip

    return check
