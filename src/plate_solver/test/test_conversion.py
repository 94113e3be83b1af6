"""Requests become goals, by values computed by hand; and the four steps depend on nothing but their
arguments."""

from dataclasses import replace

import numpy as np
import pytest

from plate_core import AngleTargets, CycleRequest, Parts, PlateCycle, PlateError, Targets
from plate_sim import simulate
from plate_solver.controller import Controller, leaves_plate, refusal, result_of, search
from plate_solver.goal import Solution, Status
from plate_solver.goal.conversion import RequestFacts, form_goal
from plate_solver.sinusoids.solver import SinusoidCycles
from plate_solver.start import Memory, predict_start

MASS_KG, RADIUS_M = 0.01, 0.02
IDS = ("black_1", "grey_1")
PLACE = np.array([[0.004, 0.0], [-0.1, 0.05]])


@pytest.fixture
def heavy(rig):
    """A rig whose parts are discs of 10 g and 20 mm radius."""
    return replace(rig, parts=replace(rig.parts, mass_kg=MASS_KG, radius_m=RADIUS_M), types={})


def goal_of(rig, request, period=0.2, **state):
    """The goal of a request at a plate at rest, with a part of the start state replaced."""
    rotates = RequestFacts.of(rig, request).rotating_parts is not None
    start = replace(predict_start(rig, request, Memory(), None, rotates, False), **state)
    return form_goal(rig, request, start, period, 0.03, True)


def moving(places=PLACE, **what):
    """Parts that drift along x by 10 mm/s and spin by 2 rad/s."""
    drift = np.tile([0.01, 0.0], (len(places), 1))
    return Parts.make(IDS[: len(places)], places, drift, spin=np.full(len(places), 2.0), **what)


def test_a_force_becomes_an_interval_of_displacements(heavy):
    """d = (v + F T/m) P = (10 mm/s + 2 mN 0.1 s/10 g) 0.2 s = 6 mm, within 0.1 mN T P/m = 0.2 mm.

    The cycle whose drift the force changes need not be as long as the next.
    """
    force = np.array([[2e-3, -1e-3], [0.0, 0.0]])
    goal = goal_of(heavy, CycleRequest.make(moving(), force, np.full((2, 2), 1e-4), period=0.1))
    assert goal.displacement == pytest.approx(np.array([[6e-3, -2e-3], [2e-3, 0.0]]))
    assert goal.tolerance == pytest.approx(np.full((2, 2), 0.2e-3))
    assert (goal.multi_cycle, goal.weight, goal.coast, goal.free_end) == (False, 1.0, 0.0, False)
    assert goal.part_rotations is None


def test_a_torque_becomes_a_rotation(heavy):
    """turn = (w + N T/J) P with J = m r^2/2 = 2e-6 kg m2 of a disc: (2 + 4e-5 0.1/2e-6) 0.2 = 0.8.

    A torque of 0 requests nothing: its weight is 0, the other's is the part's radius.
    """
    goal = goal_of(heavy, CycleRequest.make(moving(), torque=np.array([4e-5, 0.0]), period=0.1))
    assert goal.part_rotations.low[0] == goal.part_rotations.high[0] == pytest.approx(0.8, rel=1e-3)
    assert goal.part_rotations.weight == pytest.approx([RADIUS_M, 0.0], rel=1e-3)


def test_forces_that_lead_off_the_plate_are_cut_at_the_edge(heavy):
    half = heavy.plate.half
    position = np.array([half - RADIUS_M - [0.001, 0.1]])
    goal = goal_of(heavy, CycleRequest.make(moving(position), np.full((1, 2), 1.0), period=0.1))
    assert goal.displacement[0] == pytest.approx([0.001, 0.1])
    assert np.all(goal.tolerance == 0)


def test_a_target_becomes_an_interval_of_displacements(heavy):
    """From the predicted place: 10 to 20 mm less 4 mm is 11 mm within 5 mm."""
    low, high = np.array([[0.01, 0.0], [-0.1, 0.05]]), np.array([[0.02, 0.0], [-0.1, 0.07]])
    weight = np.array([[0.5, 0.0], [0.1, 2.0]])
    goal = goal_of(heavy, CycleRequest.make(moving(), targets=Targets(low, high, weight, 0.003)))
    assert goal.displacement == pytest.approx(np.array([[0.011, 0.0], [0.0, 0.01]]))
    assert goal.tolerance == pytest.approx(np.array([[0.005, 0.0], [0.0, 0.01]]))
    assert np.array_equal(goal.weight, weight)
    assert (goal.multi_cycle, goal.coast, goal.free_end) == (True, 0.03, True)
    clear = 2 * RADIUS_M + 0.003
    assert goal.clear == pytest.approx(np.full((2, 2), clear))
    assert goal.part_rotations is None


def test_a_target_angle_becomes_a_rotation_from_the_predicted_angle(heavy):
    """0.3 to 0.5 rad, from 0.1 rad and 0.05 rad of rotation until the start: 0.15 to 0.35."""
    free = np.zeros((1, 2))
    angles = AngleTargets(np.array([0.3]), np.array([0.5]), np.array([0.02]))
    request = CycleRequest.make(
        moving(PLACE[:1], angle=np.array([0.1])), targets=Targets(free, free, free, 0.0, angles)
    )
    goal = goal_of(heavy, request, rotation=np.array([0.05]))
    assert (goal.part_rotations.low[0], goal.part_rotations.high[0]) == pytest.approx((0.15, 0.35))
    assert goal.part_rotations.weight[0] == 0.02


def test_forces_beside_targets_are_information(heavy):
    zone = Targets(PLACE, PLACE + 0.01, np.ones((2, 2)), 0.003)
    bare = goal_of(heavy, CycleRequest.make(moving(), targets=zone))
    shown = CycleRequest.make(moving(), np.full((2, 2), 1e-3), None, np.full(2, 1e-6), targets=zone)
    with_targets = goal_of(heavy, shown)
    assert np.array_equal(with_targets.displacement, bare.displacement)
    assert np.array_equal(with_targets.tolerance, bare.tolerance)
    assert with_targets.part_rotations is None


def test_facts_of_a_request(rig):
    """Forces or targets, rotations, distances of more than 6 mm, parts without a tolerance."""
    parts = Parts.make(IDS, PLACE)
    bare = CycleRequest.make(parts, tolerance=np.array([[0.0, 1e-3], [0.0, 0.0]]))
    assert RequestFacts.of(rig, bare) == RequestFacts(False, None, False, True)
    one = CycleRequest.make(parts, tolerance=np.array([[1e-3, 1e-3], [0.0, 0.0]]))
    assert RequestFacts.of(rig, one).exact
    free = CycleRequest.make(
        parts, tolerance=np.array([[0.0, 1e-3], [1e-3, 0.0]]), torque=[0.0, 1e-6]
    )
    assert RequestFacts.of(rig, free) == RequestFacts(False, 1, False, False)
    for way, far in ((0.0059, False), (0.0061, True)):
        to = Targets(PLACE + [way, 0], PLACE + [way + 0.1, 0], np.ones((2, 2)))
        assert RequestFacts.of(rig, CycleRequest.make(parts, targets=to)).far is far
        assert not RequestFacts.of(
            rig, CycleRequest.make(parts, targets=replace(to, weight=0 * PLACE))
        ).far
    angle = 0.0061 / rig.parts.radius_m * np.ones(2)
    angles = AngleTargets(angle, angle, np.array([0.01, 0.0]))
    to = Targets(PLACE, PLACE, np.ones((2, 2)), 0.0, angles)
    assert RequestFacts.of(rig, CycleRequest.make(parts, targets=to)) == RequestFacts(
        True, 1, True, False
    )


def zone(**changed):
    """Targets, one field of which is wrong."""
    fields = {"low": PLACE, "high": PLACE + 0.01, "weight": np.ones((2, 2))}
    return Targets(**fields | changed)


def spoilt(name, row, value):
    """A field of `zone` with one wrong value."""
    array = np.array(getattr(zone(), name))
    array[row] = value
    return CycleRequest.make(moving(), targets=zone(**{name: array}))


make = CycleRequest.make


@pytest.mark.parametrize(
    ("invalid", "message"),
    [
        (make(moving(), period=0.0), "period of forces is 0, allowed: above 0"),
        (
            make(moving(), [[0, 0], [0, np.nan]]),
            r"force of grey_1 is nan, allowed: -1e\+09",
        ),
        (
            make(moving(), None, [[0, -0.5], [0, 0]]),
            "black_1 is -0.5, allowed: 0 to inf",
        ),
        (make(moving(), torque=[0, np.inf]), "torque of grey_1 is inf, allowed: -1e"),
        (spoilt("low", (1, 0), np.nan), "lower bound of the target of grey_1 is nan, allowed: -1e"),
        (spoilt("high", (0, 1), -0.5), "width of the target of black_1 is -0.5, allowed: 0 to"),
        (spoilt("weight", (0, 1), 2e9), r"weight of the target of black_1 is 2e\+09, all"),
        (
            make(moving(), targets=zone(gap_m=-0.1)),
            "gap_m of targets is -0.1, allowed: 0",
        ),
    ],
)
def test_a_wrong_request_is_refused_by_name_value_and_range(heavy, invalid, message):
    with pytest.raises(PlateError, match=message):
        goal_of(heavy, invalid)


def swing(period=0.1):
    """A cycle that swings along x and rotates."""
    angle = 2 * np.pi * np.arange(64) / 64
    return PlateCycle.from_samples(period, np.outer(1 - np.cos(angle), [4e-3, 1e-3, 0.02]))


def test_the_state_at_the_start_is_that_of_an_independent_simulation(rig):
    """From the places of the image and the velocities of the memory, over the running cycle."""
    velocity = np.array([[0.02, 0.0], [0.0, -0.03]])
    memory = Memory(dict(zip(IDS, velocity, strict=True)))
    start = predict_start(
        rig, CycleRequest.make(Parts.make(IDS, PLACE)), memory, swing(), False, False
    )
    run = simulate(swing(), PLACE, velocity, rig.friction.mu, rig.friction.gravity)
    np.testing.assert_allclose(start.position, run.position[-1], atol=1e-4)
    np.testing.assert_allclose(start.velocity, run.velocity[-1], atol=5e-3)
    assert start.spin is None
    assert np.array_equal(start.memory.velocity["grey_1"], start.velocity[1])


def test_a_known_friction_limit_counts_before_the_rigs(heavy):
    """12 mN on 10 g are 1.2 m/s2; 0 is unknown."""
    parts = Parts.make(IDS, PLACE, friction_limit=np.array([12e-3, 0.0]))
    start = predict_start(heavy, CycleRequest.make(parts), Memory(), None, False, False)
    own = heavy.friction.mu * heavy.friction.gravity
    assert start.friction_accel == pytest.approx([1.2, own])


def test_predictions_of_the_request_count_before_our_own(rig):
    state = np.array([[0.1, 0.02, 0.0, 0.01], [-0.1, 0.0, 0.03, 0.0]])
    request = CycleRequest.make(Parts.make(IDS, PLACE), start=state)
    start = predict_start(rig, request, Memory(), swing(), False, False)
    assert np.array_equal(np.hstack([start.position, start.velocity]), state)


def test_a_method_that_begins_at_rest_begins_after_the_tail(rig):
    state = np.hstack([PLACE, np.zeros((2, 2))])
    plate = swing().state(19)
    request = CycleRequest.make(Parts.make(IDS, PLACE), start=state, plate=plate)
    going, resting = (
        predict_start(rig, request, Memory(), swing(), False, rest) for rest in (False, True)
    )
    assert np.array_equal(going.plate, plate)
    assert np.array_equal(going.position, PLACE)
    assert resting.plate is None
    assert np.all(np.abs(resting.position - PLACE).max(axis=1) > 1e-4), "the tail moves them"


def test_each_step_gives_the_same_for_the_same_input_and_leaves_the_input_alone(rig):
    """Predict, form the goal, search (from solvers in the same state), check."""
    torque, force = np.array([1e-6, 0.0]), np.full((2, 2), 1e-3)
    request = CycleRequest.make(Parts.make(IDS, PLACE), force, torque=torque)
    memory = Memory({IDS[0]: np.array([0.02, 0.0])}, {IDS[1]: 1.0})
    ends = []
    for _ in range(2):
        start = predict_start(rig, request, memory, swing(), True, False)
        goal = form_goal(rig, request, start, 0.1, 0.0, False)
        found = search(SinusoidCycles(rig, seed=1), goal, 1.0, 0.1, 0.15, np.inf)
        assert not leaves_plate(rig, IDS, goal, found.predicted)
        ends.append(
            [
                start.position,
                start.spin,
                goal.displacement,
                goal.part_rotations.low,
                found.predicted,
            ]
        )
    for first, second in zip(*ends, strict=True):
        assert np.array_equal(first, second)
    assert np.array_equal(request.parts.position, PLACE)
    assert np.array_equal(request.forces.force, np.full((2, 2), 1e-3))
    assert list(memory.velocity) == [IDS[0]]
    assert np.array_equal(memory.velocity[IDS[0]], [0.02, 0.0])
    assert memory.spin == {IDS[1]: 1.0}


@pytest.mark.parametrize(
    ("at", "to", "end", "leaves"),
    [
        (0.10, 0.15, 0.15, False),  # stays
        (0.10, 0.15, 0.30, True),  # is carried over the edge
        (0.10, 0.40, 0.30, False),  # must leave there
        (0.10, 0.40, -0.30, True),  # must leave, but on the other side
        (0.30, 0.10, 0.298, False),  # comes in from the edge
    ],
)
def test_a_part_leaves_the_plate_only_where_its_goal_lies(rig, at, to, end, leaves):
    """Along x, of a plate that is 0.3 m long to either side."""
    assert rig.plate.half[0] == 0.3
    position, target = np.array([[at, 0.0]]), np.array([[to, 0.0]])
    request = CycleRequest.make(
        Parts.make(IDS[:1], position), targets=Targets(target, target, np.ones((1, 2)))
    )
    start = predict_start(rig, request, Memory(), None, False, False)
    goal = form_goal(rig, request, start, 0.1, 0.0, False)
    assert leaves_plate(rig, IDS[:1], goal, np.array([end, 0.0])) is leaves


FRICTION_ACCEL = 2.5
"""mu g of the parts below [m/s2]: displacements of 0.1 m over 0.2 s are 1 mu m g."""


def half_way(rig, **goal):
    """A goal of 2 mm and -4 mm for one part, and a solution that misses half of it by 0.01 and
    0.02 mu m g (1 mm and 2 mm)."""
    request = CycleRequest.make(Parts.make(IDS[:1], PLACE[:1]))
    start = predict_start(rig, request, Memory(), None, False, False)
    start = replace(start, friction_accel=np.array([FRICTION_ACCEL]))
    goal = replace(
        form_goal(rig, request, start, 0.2, 0.0, False),
        displacement=np.array([[2e-3, -4e-3]]),
        **goal,
    )
    cycle, miss = PlateCycle.rest(0.2), np.array([[0.01, 0.02]])
    return goal, Solution(True, "found", cycle, miss, 3, 1.0, predicted=np.zeros(2))


def test_the_error_of_a_fraction_is_relative_to_the_whole_request(rig):
    """Half of the request is missed beforehand: 1 + 1 mm along x, 2 - 2 mm along y."""
    goal, found = half_way(rig)
    whole, half = result_of(goal, found, 1.0, 0.2), result_of(goal, found, 0.5, 0.2)
    assert (whole.fraction, whole.message, whole.solution.success) == (1.0, "found", True)
    assert whole.error_m == pytest.approx(np.sqrt((1e-6 + 4e-6) / 2))
    assert half.error_m == pytest.approx(np.sqrt((4e-6 + 0.0) / 2))
    assert half.solution.residual == pytest.approx(np.array([[0.02, 0.0]]))
    assert half.requested_m == whole.requested_m == pytest.approx(np.sqrt((4e-6 + 16e-6) / 2))
    assert (half.solution.success, half.solution.status) == (False, Status.PARTIAL)
    assert (half.fraction, half.message) == (0.5, "a fraction of 0.5 of the request is met; found")


def test_a_goal_that_lasts_is_never_missed(rig):
    goal, found = half_way(rig, multi_cycle=True)
    result = result_of(goal, found, 0.5, 0.2)
    assert (result.error_m, result.requested_m, result.fraction) == (0.0, 0.0, 0.5)
    assert result.solution is found


def test_in_place_of_a_refused_motion_the_plate_rests_and_all_is_missed(rig):
    goal, found = half_way(rig)
    result = refusal(goal, found, PlateCycle.rest(0.2))
    assert not result.cycle.moves
    assert result.solution.cycle is result.cycle
    assert result.error_m == result.requested_m == pytest.approx(np.sqrt(10e-6))
    assert result.solution.residual == pytest.approx(np.array([[0.02, -0.04]]))
    assert (result.solution.success, result.solution.status) == (False, Status.FAILED)
    assert (result.fraction, result.solution.fraction) == (0.0, 0.0)
    multi_cycle, found = half_way(rig, multi_cycle=True)
    assert refusal(multi_cycle, found, PlateCycle.rest(0.2)).requested_m == 0.0


def test_a_missed_rotation_counts_by_its_arc(rig):
    """Two parts go where they should; one lacks 0.1 rad at 20 mm, the other need not rotate."""
    request = CycleRequest.make(Parts.make(IDS, PLACE), torque=[1e-6, 0.0])
    start = predict_start(rig, request, Memory(), None, True, False)
    goal = form_goal(rig, request, start, 0.2, 0.0, False)
    rotations = replace(
        goal.part_rotations, low=np.full(2, 0.3), high=np.full(2, 0.4), weight=np.array([0.02, 0])
    )
    end = np.array([*PLACE.T.ravel(), 0.2, 9.0])
    found = Solution(True, "found", PlateCycle.rest(0.2), np.zeros((2, 2)), 3, 1.0, predicted=end)
    result = result_of(replace(goal, part_rotations=rotations), found, 1.0, 0.2)
    assert result.error_m == pytest.approx(0.002 / np.sqrt(5))


class Refused:
    """A solver whose motions carry the part off the plate until a quarter is requested."""

    cut_short = 0

    def __init__(self):
        self.calls = []

    def steering_period(self, *given):
        return 0.2

    def forget(self):
        self.calls.append("forget")

    def steer(self, goal, tolerance, good_enough, until):
        self.calls.append((goal.displacement[0, 0], tolerance, good_enough))
        self.position = goal.position
        x = 0.01 if len(self.calls) > 4 else 1.0
        miss = np.zeros((1, 2))
        end = np.array([x, 0.0])
        return Solution(True, "found", PlateCycle.rest(0.2), miss, 3, 1.0, predicted=end)


def test_less_is_searched_for_afresh_until_no_part_leaves_the_plate(heavy):
    """All, half, a quarter of 8 mm by 0 (5.66 mm root mean square), exact within 2 % of that; a
    search stops at 50 um/s over 0.2 s."""
    solver, controller = Refused(), Controller(heavy)
    controller._solvers["sinusoids"] = solver
    force = np.array([[4e-3, 0.0]])  # 4 mN 0.1 s/10 g is a drift of 40 mm/s
    result = controller.solve(
        CycleRequest.make(Parts.make(IDS[:1], [[0, 0]]), force, period=0.1), None
    )
    searches = [call for call in solver.calls if call != "forget"]
    assert solver.calls[1::2] == ["forget", "forget"]
    size = 0.02 * 8e-3 / np.sqrt(2)
    expected = [(8e-3 * share, 1e-5, size * share) for share in (1, 0.5, 0.25)]
    assert searches == [pytest.approx(each) for each in expected]
    assert result.fraction == 0.25


@pytest.mark.parametrize(("radii", "leaves"), [(0.6, False), (0.4, True)])
def test_a_part_leaves_the_plate_half_a_radius_before_its_edge(heavy, radii, leaves):
    request = CycleRequest.make(Parts.make(IDS[:1], [[0.0, 0.0]]))
    start = predict_start(heavy, request, Memory(), None, False, False)
    goal = form_goal(heavy, request, start, 0.1, 0.0, False)
    end = np.array([0.0, heavy.plate.half[1] - radii * RADIUS_M])
    assert leaves_plate(heavy, IDS[:1], goal, end) is leaves


def test_velocities_are_kept_from_cycle_to_cycle_by_id(heavy):
    """A part that begins a cycle at 50 mm/s slides v^2/(2 mu g) on a plate at rest."""
    solver, controller = Refused(), Controller(heavy)
    controller._solvers["sinusoids"] = solver
    parts, force = Parts.make(IDS[:1], [[0.0, 0.0]]), np.array([[1e-3, 0.0]])
    state = np.array([[0.0, 0.0, 0.05, 0.0]])
    controller.solve(CycleRequest.make(parts, force, start=state), None)
    rest, slide = PlateCycle.rest(0.1), 0.05**2 / (2 * heavy.friction.accel)
    for ids, way in ((IDS[:1], slide), (IDS[:1], 0.0), (IDS[1:], 0.0)):
        controller.solve(CycleRequest.make(Parts.make(ids, [[0.0, 0.0]]), force), rest)
        assert solver.position[0] == pytest.approx([way, 0.0], abs=1e-5)
