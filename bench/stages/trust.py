"""Creep compared with baselines, neglected effects, and other laws of friction.

Three measurements show how accurate the simulator is. The first is the creep of parts that should
stick. The second is the size of the effects that the model neglects. The third is the result of
tasks under laws of friction that the loop does not assume.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import pi, sqrt
from typing import Any

import numpy as np

from harness import Cache, Result, Table, missing, optional
from plate_bringup.loop import Setup
from plate_core import PlateCycle, Rig, load_rig
from plate_sim import Ground, simulate, simulate_bodies
from plate_sim.friction import Footprint, disc, polygon
from plate_sim.world import STEP
from stages.mujoco_scene import MASS, MujocoScene
from stages.pymunk_scene import PymunkScene
from stages.scenes import FREQUENCY, GRAVITY, MU, MU_G, RADIUS, exact_cycle
from tasks.runs import cached_runs, summarise

Method = tuple[str, float | None, Callable[[PlateCycle, float, float], float]]
"""One simulation method: name, time step [ms] or None, and a function. The function returns the
drift [m] of a part. The function's arguments are a motion of the plate, the pull of gravity along
the plate [mu g], and a time [s]."""

CREEP_S = 10
"""Time in which a part should not move relative to the plate [s]."""

RIDES = {
    "level, shaken at 0.9 mu g": (0.9, 0.0),
    "still, tilt pulls 0.9 mu g": (0.0, 0.9),
    "0.45 mu g each": (0.45, 0.45),
}
"""For each scene, the peak acceleration of the plate and the pull by its tilt [mu g]. The sum of
acceleration and pull is below 1 mu g. Therefore friction holds the part, and the true drift of the
part is 0."""

HOME = np.zeros((1, 2))
"""Initial position of the part [m]."""

SQUARE = polygon(0.016 * (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - 0.5))

IN_CONTACT = """<mujoco>
<option timestep="{dt}" cone="elliptic" impratio="{impratio}" noslip_iterations="{noslip}"/>
<worldbody><geom type="plane" size="1 1 1" friction="{mu} 0 0"/>
<body pos="0 0 {height}"><freejoint/><geom type="cylinder" size="{radius} {height}" mass="{mass}"
friction="{mu} 0 0"/></body></worldbody>
</mujoco>"""
"""MuJoCo model of a cylinder on a plane."""

HEIGHT = 0.003
"""Half the height of the cylinder [m]."""

WORLDS: tuple[dict[str, float], ...] = (
    {}, {"static_ratio": 1.3}, {"friction_slope": 0.5}, {"friction_slope": -0.5},
    {"friction_slope": 2.0}, {"friction_slope": -2.0}, {"heave": 0.01}, {"heave": 0.05},
)  # fmt: skip
"""Differences of the simulated worlds from the model that the loop assumes. The first world has no
difference."""

NEGLECTED = ("effect", "formula", "assumed", "size")
"""Columns of the table of neglected effects."""

DENSITY = 7850.0
"""Density of a steel part [kg/m3]."""

STIFFNESS = 70e9
"""Young's modulus of an aluminium plate [Pa]."""

PLATE_DENSITY = 2700.0
"""Density of an aluminium plate [kg/m3]."""

POISSON = 0.33
"""Poisson's ratio of an aluminium plate."""

OFF_PLANE_M, OUT_OF_PLANE = 1e-3, 0.01
"""Assumptions: distance of the motors' forces from the plate's middle plane [m], and vertical
motion as a fraction of the horizontal motion."""

AIR_VISCOSITY, AIR_DENSITY, AIR_GAP_M = 1.8e-5, 1.2, 10e-6
"""Viscosity [Pa s] and density [kg/m3] of air, and gap between two surfaces that touch at their
peaks [m]."""

CHARGE, VACUUM = 2.7e-5, 8.85e-12
"""Maximum charge density in air before a breakdown [C/m2], and vacuum permittivity [F/m]."""

WEAR, HARDNESS = 1e-4, 1e9
"""Archard's coefficient of dry sliding [-], and hardness of the softer surface [Pa]."""

PRESLIDING_M = 1e-6
"""Displacement by which the asperities in a contact deform before the surfaces slide [m]."""


def measure(quick: bool) -> Result:
    """Measure creep and tasks, and estimate the neglected effects."""
    baselines = [method for package, method in BASELINES if optional(package)]
    tables = [
        Table.of(
            "creep", creep_rows([*PROJECT, *baselines], 0.5 if quick else CREEP_S), span=CREEP_S
        ),
        Table.of("left_out", neglected_effects(load_rig())),
        Table.of("worlds", world_rows(1 if quick else 3)),
    ]
    return Result(tables, missing("pymunk", "mujoco"))


def creep_rows(methods: list[Method], span: float) -> list[dict[str, Any]]:
    """Return rows of the drift [um] of a sticking part within a time [s], by method and scene."""
    rows = []
    for name, ms, run in methods:
        row: dict[str, Any] = {"method": name, "step_ms": ms}
        for scene, (gamma, pull) in RIDES.items():
            cycle = exact_cycle(gamma) if gamma else PlateCycle.rest(1 / FREQUENCY)
            row[scene] = 1e6 * abs(run(cycle, pull, span))
        rows.append(row)
    return rows


def tilted_ground(pull: float) -> Ground:
    """Return the ground whose tilt pulls parts along x with this acceleration [mu g]."""
    return Ground(tilt=(float(np.arcsin(pull * MU)), 0.0))


def drift_by_events(cycle: PlateCycle, pull: float, span: float) -> float:
    """Return the drift of a point by the event-driven reference [m]. The plate ends at home."""
    cycles = round(span * FREQUENCY)
    start = cycle.twist(0.0)[:, :2]
    run = simulate(cycle, HOME, start, MU, GRAVITY, cycles, 1, ground=tilted_ground(pull))
    return float(run.position[-1, 0, 0])


def drift_in_steps(part: Footprint, cycle: PlateCycle, pull: float, span: float) -> float:
    """Return the drift of a part in the simulator's `World` [m]."""
    start, cycles = cycle.twist(0.0)[:, :2], round(span * FREQUENCY)
    run = simulate_bodies(
        cycle, part, HOME, 0, start, 0, MU, GRAVITY, cycles, 0, ground=tilted_ground(pull)
    )  # fmt: skip
    return float(run.position[-1, 0, 0])


def drift_in_pymunk(dt: float, cycle: PlateCycle, pull: float, span: float) -> float:
    """Return the drift in pymunk [m]."""
    scene = PymunkScene(cycle, dt, span, HOME, MU_G, cycle.twist(0.0)[:, :2])
    scene.space.gravity = pull * MU_G, 0.0
    return float(scene.run()[0, 0] - scene.plate.position.x)


def drift_in_joints(dt: float, cycle: PlateCycle, pull: float, span: float) -> float:
    """Return the drift in MuJoCo with friction of joints, as in the scene of `sim` [m]."""
    scene = MujocoScene(cycle, dt, span, HOME, MU, cycle.twist(0.0)[:, :2])
    scene.shake[:, 0] += pull * MU_G
    return float(scene.run()[0, 0] - scene.moved[0])


def drift_in_contact(
    dt: float, cycle: PlateCycle, pull: float, span: float, impratio: float = 1.0, noslip: int = 0,
) -> float:  # fmt: skip
    """Return the drift in MuJoCo of a cylinder on a plane, in the plate's frame [m]."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        IN_CONTACT.format(
            dt=dt, impratio=impratio, noslip=noslip, mu=MU, height=HEIGHT, radius=RADIUS, mass=MASS
        )
    )
    data = mujoco.MjData(model)
    twist = cycle.twist((np.arange(round(span / dt) + 1) * dt) % cycle.period)[:, 0]
    normal = GRAVITY * sqrt(1 - (pull * MU) ** 2)
    for shake in pull * MU_G - np.diff(twist) / dt:
        model.opt.gravity[:] = shake, 0.0, -normal
        mujoco.mj_step(model, data)
    return float(data.qpos[0])


PROJECT: list[Method] = [
    ("plate_sim, point by events", None, drift_by_events),
    ("plate_sim, disc", 1e3 * STEP, partial(drift_in_steps, disc(RADIUS))),
    ("plate_sim, square", 1e3 * STEP, partial(drift_in_steps, SQUARE)),
]

BASELINES: list[tuple[str, Method]] = [
    (package, (name, ms, partial(run, 1e-3 * ms)))
    for package, name, run in (
        ("pymunk", "pymunk, pivot of limited force", drift_in_pymunk),
        ("mujoco", "MuJoCo, dry friction of joints", drift_in_joints),
        ("mujoco", "MuJoCo, contact", drift_in_contact),
        ("mujoco", "MuJoCo, contact, impratio 100", partial(drift_in_contact, impratio=100.0)),
        ("mujoco", "MuJoCo, contact, 10 noslip iterations", partial(drift_in_contact, noslip=10)),
    )
    for ms in (1.0, 0.1)
]
"""Required package, and method."""


def neglected_effects(rig: Rig) -> list[dict[str, str]]:
    """Return the effects that the simulator neglects on a rig, with their sizes by formulas."""
    mu, g, m, r = rig.friction.mu, rig.friction.gravity, rig.parts.mass_kg, rig.parts.radius_m
    a, s = rig.limits.accel, 2 / pi * rig.limits.speed
    push, area, length = mu * m * g, pi * r**2, rig.plate.length_m
    height = m / (DENSITY * area)
    thick = rig.plate.mass_kg / (PLATE_DENSITY * length * rig.plate.width_m)
    rigid = STIFFNESS / (1 - POISSON**2) * thick**3 / 12
    bend = 22.37 / (2 * pi * length**2) * sqrt(rigid / (PLATE_DENSITY * thick))
    slope = rig.plate.mass_kg * a * OFF_PLANE_M / (rigid * rig.plate.width_m) * length / 2
    shake = sqrt(a / rig.limits.stroke_m) / (2 * pi)
    sag = 2 / 3 * slope * length
    stretch = PLATE_DENSITY * a * length**2 / (2 * STIFFNESS)
    film, drag = AIR_VISCOSITY * area * s / AIR_GAP_M, 0.5 * AIR_DENSITY * 2 * r * height * s**2
    rows = [
        ("plate moves up and down: weight changes", "r a/g", f"r = {100 * OUT_OF_PLANE:g} %",
         f"{percent(OUT_OF_PLANE * a / g)} of mu m g, alternating"),
        ("part leaves the plate and bounces", "r > g/a", "",
         f"not below r = {percent(g / a)}"),
        ("plate bends: its first mode", "22.4/(2 pi L^2) sqrt(D/(rho h))",
         f"free aluminium plate, h = {1e3 * thick:.1f} mm", f"{bend:.0f} Hz"),
        ("plate bends: tilt at its ends, below that", "M a e L/(2 D W)",
         f"motors e = {1e3 * OFF_PLANE_M:g} mm off the middle plane",
         f"{percent(slope / mu)} of mu m g"),
        ("plate bends: weight at its ends changes", "M a e L^2/(3 D W) w^2/g",
         f"the same, at {shake:.0f} Hz",
         f"{percent(sag * (2 * pi * shake) ** 2 / g)} of mu m g, alternating"),
        ("plate stretches", "rho a L^2/(2 E)", "pushed at one end", f"{1e6 * stretch:.1f} um"),
        ("parts push the plate back", "10 mu m g/(M a)", "ten parts",
         f"{percent(10 * push / (rig.plate.mass_kg * a))} of its acceleration"),
        ("friction shifts the pressure", "mu h/2", f"steel part, h = {1e3 * height:.1f} mm",
         f"{1e3 * mu * height / 2:.1f} mm; tips above h = {1e3 * 2 * r / mu:.0f} mm"),
        ("the same: side force on a rotating part", "(mu h/2) w/s",
         "w = 1 rad/s above the plate's",
         f"{percent(mu * height / 2 / s)} of mu m g"),
        ("contact deforms before it slides", "sqrt(2 d/a)/(T/4)",
         f"d = {1e6 * PRESLIDING_M:g} um, T = 0.1 s",
         f"{percent(sqrt(2 * PRESLIDING_M / a) / 0.025)} of the time between reversals"),
        ("air film", "eta A s/d", f"d = {1e6 * AIR_GAP_M:g} um",
         f"{percent(film / push)} of mu m g"),
        ("drag of the air", "rho s^2 R h", "", f"{percent(drag / push)} of mu m g"),
        ("static charge", "q^2 A/(2 eps)", "breakdown field of air",
         f"{percent(CHARGE**2 / (2 * VACUUM) * area / (m * g))} of the weight, at most"),
        ("wear of a part", "k m g s t/(H A)", "k = 1e-4, H = 1 GPa, an hour",
         f"{1e6 * WEAR * m * g * s * 3600 / (HARDNESS * area):.2f} um"),
    ]  # fmt: skip
    return [dict(zip(NEGLECTED, row, strict=True)) for row in rows]


def percent(fraction: float) -> str:
    """Return a fraction as a percentage with two digits."""
    return f"{100 * fraction:.2g} %"


def world_rows(seeds: int) -> list[dict[str, Any]]:
    """Run tasks in each world. Return one row per world: runs done, median time, parts lost."""
    cases = {}
    for world in WORLDS:
        name = ", ".join(f"{k} {v:g}" for k, v in world.items()) or "as assumed"
        settings = {key: str(value) for key, value in world.items()}
        for task in ("sort_4", "sort_10"):
            cases[name, task] = [(Setup(task, k), settings, load_rig()) for k in range(seeds)]
    rows: dict[str, dict[str, Any]] = {}
    for (world, task), runs in cached_runs(Cache.of(__name__), cases).items():
        found = summarise(runs)
        time_s = "" if found["time_s"] is None else f", {found['time_s']:.3g} s"
        lost = f", {found['dropped']} lost" if found["dropped"] else ""
        rows.setdefault(world, {"world": world})[task] = found["succeeded"] + time_s + lost
    return list(rows.values())
