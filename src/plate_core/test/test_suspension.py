"""The suspension of a rig file: its values, and how a wrong one is refused."""

from math import inf, pi

import numpy as np
import pytest
import yaml

from plate_core import RigError, config_path, load_rig
from plate_core.rig import Suspension, mass_matrix, modal_matrices

SHARES = {"mass": 0, "damping": 0, "stiffness": 1}
MODES = {"frequency_hz": [35, 30, 40], "damping_ratio": [0.03, 0.02, 0.05], "feedforward": SHARES}
MATRICES = {
    "stiffness": [[9e4, 1e3, 0], [1e3, 8e4, 0], [0, 0, 3e3]],
    "damping": [[30, 0, 0], [0, 30, 0], [0, 0, 1]],
    "feedforward": SHARES,
}


@pytest.fixture(name="load")
def _load(tmp_path):
    def load(suspension):
        data = yaml.safe_load(config_path("rig.yaml").read_text(encoding="utf-8"))
        data["suspension"] = suspension
        path = tmp_path / "rig.yaml"
        path.write_text(yaml.safe_dump(data))
        return load_rig(path).suspension

    return load


def test_the_default_rig_is_rigid():
    assert load_rig().suspension is None


def test_the_example_in_the_rig_file_is_right(tmp_path):
    text = config_path("rig.yaml").read_text(encoding="utf-8")
    start = text.index("# suspension:")
    example = "\n".join(line.removeprefix("# ") for line in text[start:].splitlines())
    path = tmp_path / "rig.yaml"
    path.write_text(text[:start] + example)
    suspension = load_rig(path).suspension
    assert suspension.stiffness[0][0] == pytest.approx(2.0 * (2 * pi * 35) ** 2)
    assert suspension.motor_bandwidth_hz < inf


def test_modes_become_matrices(load):
    found = load(MODES)
    inertia = 2.0 * (0.6**2 + 0.3**2) / 12
    np.testing.assert_allclose(found.mass, np.diag([2.0, 2.0, inertia]))
    eigen = np.linalg.eigvals(np.linalg.solve(found.mass, found.stiffness))
    np.testing.assert_allclose(np.sqrt(eigen) / (2 * pi), [35, 30, 40])
    critical = 2 * np.sqrt(np.diag(found.stiffness) * np.diag(found.mass))
    np.testing.assert_allclose(np.diag(found.damping) / critical, [0.03, 0.02, 0.05])
    assert found.motor_gain == (1, 1, 1, 1)
    assert found.motor_bandwidth_hz == inf
    assert found.servo == (0, 0)


def test_matrices_are_taken_as_they_are(load):
    found = load(
        MATRICES
        | {"motor_gain": [1.15, 0.85, 1, 1], "motor_bandwidth_hz": 200}
        | {"servo": {"stiffness_npm": 1e4, "damping_nspm": 50}}
    )
    np.testing.assert_array_equal(found.stiffness, MATRICES["stiffness"])
    np.testing.assert_array_equal(found.damping, MATRICES["damping"])
    assert found.motor_gain == (1.15, 0.85, 1, 1)
    assert found.motor_bandwidth_hz == 200
    assert found.servo == (1e4, 50)
    assert found.feedforward == (0, 0, 1)


def test_kinetic_energy_of_a_lopsided_plate():
    """1/2 q' M q' is that of the centre of mass plus that of turning about it."""
    mass = np.array(mass_matrix(2.0, 0.05, (0.03, -0.02)))
    x, y, spin = twist = np.array([0.3, -0.5, 4.0])
    centre = np.array([x - spin * -0.02, y + spin * 0.03])
    energy = 0.5 * 2.0 * centre @ centre + 0.5 * 0.05 * spin**2
    assert 0.5 * twist @ mass @ twist == pytest.approx(energy)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frequency_hz": [35, 35]}, "frequency_hz is .*, allowed: 3 numbers from 0 to 1000"),
        ({"damping_ratio": [3, 0, 0]}, "damping_ratio is .*, allowed: 3 numbers from 0 to 2"),
        ({"feedforward": {"mass": 1, "damping": 0}}, "feedforward: stiffness is missing"),
        ({"feedforward": {**SHARES, "jerk": 1}}, "feedforward: unknown key jerk"),
        ({"motor_gain": [1, 1, 1]}, r"motor_gain is .*, allowed: 4 numbers from 0\.1 to 3"),
        ({"motor_bandwidth_hz": 0}, "motor_bandwidth_hz is 0, allowed: a number from 1 to"),
        ({"servo": {"stiffness_npm": -1}}, "servo: stiffness_npm is -1, allowed"),
        ({"inertia_kgm2": 0}, "inertia_kgm2 is 0, allowed"),
        ({"inertia": 1}, "suspension: unknown key inertia"),
        ({"stiffness": MATRICES["stiffness"]}, "suspension: damping is missing"),
        (MATRICES, "suspension: unknown key (damping_ratio|frequency_hz)"),
    ],
)
def test_wrong_values_are_refused(load, changes, message):
    with pytest.raises(RigError, match=message):
        load(MODES | changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stiffness": [[1, 2, 0], [0, 1, 0], [0, 0, 1]]}, "stiffness is .*a symmetric matrix"),
        ({"stiffness": np.diag([1, -1, 1])}, "stiffness has the eigenvalue -1, allowed:"),
        ({"damping": np.full((3, 3), np.nan)}, "damping is .*, allowed: 3 x 3 finite numbers"),
        ({"mass": np.diag([2, 2, 0])}, "mass has the eigenvalue 0, allowed: .* positive"),
        ({"motor_gain": (1, 1, -1, 1)}, "motor_gain is .*, allowed: 4 numbers, 0 or more"),
        ({"servo": (inf, 1)}, "servo is .*, allowed: 2 numbers"),
        ({"motor_bandwidth_hz": -2.0}, "motor_bandwidth_hz is -2.0, allowed: above 0"),
    ],
)
def test_a_suspension_that_cannot_be_is_refused(changes, message):
    mass = mass_matrix(2.0, 0.075)
    damping, stiffness = modal_matrices(mass, [35] * 3, [0.03] * 3)
    facts = {"mass": mass, "damping": damping, "stiffness": stiffness, "feedforward": (0, 0, 1)}
    hash(Suspension(**facts))  # it is one, before it is spoilt
    with pytest.raises(RigError, match=message):
        Suspension(**(facts | changes))
