"""Footprints: exact moments, measured error of the friction sum, and wrong shapes."""

from itertools import pairwise

import numpy as np
import pytest
from footprints import friction_gap, on_feet
from scipy.integrate import quad

from plate_core import PlateError
from plate_sim.friction import bar, disc, polygon, union

L_SHAPE = [
    [[0, 0], [0.03, 0], [0.03, 0.01], [0, 0.01]],
    [[0, 0.01], [0.01, 0.01], [0.01, 0.03], [0, 0.03]],
]
TRIANGLE = [[0, 0], [0.02, 0], [0, 0.02]]


def feet(radius, count=3):
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("points", [6, 48, 200])
@pytest.mark.parametrize(
    ("shape", "gyration2"),
    [
        (lambda n: bar(0.04, 0.005, points=n), (0.04**2 + 0.005**2) / 12),
        (lambda n: polygon(TRIANGLE, points=n), 2 * 0.02**2 / 18),
        # Two rectangles by the theorem of Steiner, about the centroid (11, 11) mm
        (lambda n: union(L_SHAPE, points=n), 1.44667e-4),
    ],
)
def test_moments_are_exact(shape, gyration2, points):
    part = shape(points)
    assert part.gyration2 == pytest.approx(gyration2, rel=1e-5)
    assert part.weights.sum() == pytest.approx(1)
    assert part.weights @ part.points == pytest.approx(0, abs=1e-12)
    assert part.weights @ (part.points**2).sum(1) == pytest.approx(gyration2, rel=1e-5)


@pytest.mark.parametrize("turn", [1.0, -3.0])
def test_torque_of_a_disc_that_turns_in_place(turn):
    force = disc(0.01).friction([0, 0, turn])[0]
    assert force == pytest.approx([0, 0, np.sign(turn) * 2 / 3 * 0.01], rel=1e-14)


@pytest.mark.parametrize("ratio", [1e-6, 0.02, 0.4, 0.97, 1.0, 1.03, 3, 60, 1e6])
def test_friction_of_a_disc_agrees_with_scipy_quadrature(ratio):
    # Centre slips at `ratio` times the rim; in rings r, the mean over the angle by quad.
    def ring(r, kind):
        def fraction(p):
            u, v = ratio - r * np.sin(p), r * np.cos(p)
            size = np.hypot(u, v)
            return (u if kind == "force" else r * np.cos(p) * v - r * np.sin(p) * u) / size

        return quad(fraction, -np.pi / 2, np.pi / 2, epsabs=1e-11)[0] * 2 * r / np.pi

    edges = sorted({0.0, min(ratio, 1.0), 1.0})
    force = disc(0.01).friction([0.6 * ratio, 0.8 * ratio, 1 / 0.01])[0]
    for kind, ours in (("force", force[:2] @ [0.6, 0.8]), ("torque", force[2] / 0.01)):
        truth = sum(
            quad(ring, a, b, (kind,), epsabs=1e-9, limit=200)[0] for a, b in pairwise(edges)
        )
        assert ours == pytest.approx(truth, rel=1e-7, abs=1e-9)
    assert force[:2] @ [-0.8, 0.6] == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(
    "shape",
    [
        lambda n: bar(0.01, 0.01, points=n),
        lambda n: bar(0.04, 0.005, points=n),
        lambda n: union(L_SHAPE, points=n),
        lambda n: polygon(TRIANGLE, points=n),
    ],
)
def test_greatest_error_of_friction_falls_as_one_by_the_number_of_points(shape):
    fine = shape(800)
    gap = {n: friction_gap(shape(n), fine, 200) for n in (12, 48, 192)}
    assert gap[12] < 0.13
    assert gap[48] < 0.035
    assert gap[192] < 0.011


@pytest.mark.parametrize(
    "part",
    [disc(0.01), bar(0.03, 0.006), on_feet(disc(0.01), feet(0.008))],
    ids=["disc", "bar", "feet"],
)
def test_friction_lies_on_a_convex_limit_surface_whose_normal_is_the_slip(part):
    """Goyal, Ruina and Papadopoulos 1991: of all loads that friction can give, that of a slip takes
    most power from it."""
    rng = np.random.default_rng(0)
    slips = rng.normal(size=(60, 3)) * [1, 1, 1 / 0.01]
    loads = np.array([part.friction(slip)[0] for slip in slips])
    power = slips @ loads.T  # of slip i under the load of slip j
    assert np.all(power <= np.diag(power)[:, None] * (1 + 1e-12))


def test_the_limit_surface_of_a_disc_is_five_percent_inside_an_ellipsoid():
    """From the closed form, at slips as fast in the middle as turning makes the rim: E = 1."""
    force, _, torque = disc(0.01).friction([1, 0, 1 / 0.01])[0]
    size = np.hypot(force, torque / (0.01 * 2 / 3))
    assert size == pytest.approx(np.hypot(8 / (3 * np.pi), 1.5 * 8 / (9 * np.pi)), rel=1e-9)
    assert size == pytest.approx(0.949, abs=1e-3)


def test_mass_and_inertia():
    assert disc(0.01, mass=0.5).inertia == pytest.approx(0.5 * 0.5 * 1e-4)
    assert len(bar(0.01, 0.02, points=300).points) == pytest.approx(300, rel=0.1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: disc(-1), "radius is -1 m, allowed: a positive number"),
        (lambda: disc(0.01, mass=np.nan), "mass is nan kg"),
        (lambda: bar(0.01, 0.01, points=3), "points is 3"),
        (lambda: bar(0.1, 0), "width is 0 m"),
        (lambda: polygon([[0, 0], [1, 0]]), "corners has shape"),
        (lambda: polygon([[0, 0], [1, 0], [2, 0]]), "no area"),
        (lambda: polygon([[0, 0], [1, 0], [0, np.inf]]), "finite"),
        (lambda: polygon([[0, 0], [2, 0], [0.5, 0.5], [0, 2]]), r"not convex at \[0.5, 0.5\]"),
        (lambda: polygon(feet(1, 5)[[0, 2, 4, 1, 3]]), "not convex"),
        (lambda: union([]), "no polygons"),
        (lambda: union([TRIANGLE, TRIANGLE]), "polygons 0 and 1 overlap"),
    ],
)
def test_wrong_shapes_are_refused(make, message):
    with pytest.raises(PlateError, match=message):
        make()
