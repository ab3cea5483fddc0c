"""Elastic inverse dynamics: judged by the plant itself, and by Pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters
from flexhinf.robot import Parameter, Robot, load_robot, paper_arm
from flexhinf.robot.elastic import InverseFlow
from flexhinf.scalars import apply, jacobian, trace

#: Weights of f' from f at ±h … ±4h, of order eight.
WEIGHTS = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840.0
STEP = 5e-3


def torque_driven(robot: Robot) -> Robot:
    """The same robot without its motors' electrics."""
    kept = [
        p
        for p in robot.parameters
        if not p.name.startswith(("resistance", "torque_c", "back_emf", "inductance"))
    ]
    return replace(robot, parameters=tuple(kept), drive="torque", penalty=None)


def voltage_driven(robot: Robot) -> Robot:
    """The same robot with motors of some electrics."""
    if robot.drive == "voltage":
        return robot
    rng = np.random.default_rng(5)
    electric = [
        Parameter(name if len(robot.joint_names) == 1 else f"{name}_{joint}", rng.uniform(0.5, 2.0))
        for joint in robot.joint_names
        for name in ("resistance", "torque_constant", "back_emf_constant")
    ]
    return replace(robot, parameters=(*robot.parameters, *electric), drive="voltage", penalty=None)


ROBOTS = {
    "paper": paper_arm,
    "paper, torque": lambda: torque_driven(paper_arm()),
    "quanser": lambda: load_robot("quanser-rotflex"),
    "two links": lambda: load_robot("planar-two-link"),
    "two links, voltage": lambda: voltage_driven(load_robot("planar-two-link")),
    "two links, torque": lambda: torque_driven(load_robot("planar-two-link")),
    "three links": lambda: load_robot("spatial-three-link"),
    "seven links": lambda: load_robot("seven-link"),
    "seven links, voltage": lambda: voltage_driven(load_robot("seven-link")),
}


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> Robot:
    return ROBOTS[request.param]()


def path(n: int, seed: int = 3) -> list[Polynomial]:
    """One polynomial of degree seven per joint."""
    return [Polynomial(row) for row in np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 8))]


def along(polynomials: list[Polynomial], t: np.ndarray) -> list[np.ndarray]:
    return [
        np.stack([(q.deriv(k) if k else q)(t) for q in polynomials], axis=-1) for k in range(5)
    ]  # fmt: skip


@pytest.mark.quick_cases(5)
@pytest.mark.oracle
def test_the_plant_moves_along_the_states(robot):
    """ẋ of the plant at (x(t), u(t)) is the derivative of x(t), taken by differences of order eight."""
    q, plant = path(len(robot.joint_names)), robot.plant()
    for t in (0.0, 0.4, 0.9):
        x, u = robot.inverse_dynamics(*along(q, t + STEP * np.arange(-4, 5)))
        expected = WEIGHTS @ x / STEP
        found = plant.derivative(x[4], u[4])
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.oracle
def test_dry_friction_is_fed_forward():
    arm = paper_arm().with_parameters(
        Parameter("coulomb_friction", 2.0),
        Parameter("static_friction", 3.0),
        Parameter("friction_smoothing", 0.05),
    )
    for extras in ("coulomb_friction", ("coulomb_friction", "stribeck_friction")):
        x, u = arm.inverse_dynamics(*along(path(1), 0.3 + STEP * np.arange(-4, 5)), extras=extras)
        expected = WEIGHTS @ x / STEP
        np.testing.assert_allclose(
            arm.plant(extras=extras).derivative(x[4], u[4]), expected, rtol=1e-9, atol=1e-9
        )
    assert (
        abs(
            arm.inverse_dynamics(*along(path(1), 0.3), extras=extras)[1]
            - arm.inverse_dynamics(*along(path(1), 0.3))[1]
        )
        > 0.1
    )


def test_rest_is_the_operating_point(robot):
    x, u = robot.inverse_dynamics(robot.home)
    expected = robot.operating_point()
    np.testing.assert_allclose(x, expected[0], rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(u, expected[1], rtol=1e-13, atol=1e-13)


@pytest.mark.oracle
def test_the_spring_carries_what_pinocchio_says(robot, rigid, pinocchio_model):
    pin = pytest.importorskip("pinocchio")
    n = len(robot.joint_names)
    model = pinocchio_model(*rigid(robot))
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, n))
    x, _ = robot.inverse_dynamics(q, dq, ddq)
    found = np.atleast_1d(robot.plant_parameters()["stiffness"]) * (x[2 * n : 3 * n] - q)
    expected = pin.rnea(model, model.createData(), q, dq, ddq)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.oracle
def test_the_paper_arm_in_closed_form():
    """θ̈ = q̈ + K⁻¹ d²/dt²(I q̈ + m g l sin q), written out."""
    q, dq, ddq, dddq, ddddq = 0.7, -0.4, 1.3, 2.0, -3.0
    load = ddq + 9.8 * np.sin(q)
    rate = dddq + 9.8 * np.cos(q) * dq
    second = ddddq + 9.8 * (np.cos(q) * ddq - np.sin(q) * dq**2)
    dtheta = dq + rate / 100.0
    motor = ddq + second / 100.0 + 0.1 * dtheta + load
    x, u = paper_arm().inverse_dynamics([q], [dq], [ddq], [dddq], [ddddq])
    np.testing.assert_allclose(x, [q, dq, q + load / 100.0, dtheta], rtol=1e-14)
    np.testing.assert_allclose(u, [10.0 / 9.0 * motor + dtheta], rtol=1e-14)


def test_the_way_back(robot):
    """A state has the position and three derivatives that it was made of."""
    q = along(path(len(robot.joint_names)), np.array(0.6))
    x, _ = robot.inverse_dynamics(*q)
    found = robot.flat_coordinates(x, Parameters(robot.plant_parameters()))
    for one, expected in zip(found, q[:4]):
        np.testing.assert_allclose(one, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())


@pytest.mark.quick_cases(5)
def test_laws_can_trace_it_with_other_parameters(robot):
    """On symbols, parameters included: other numbers need no new trace."""
    n, table = len(robot.joint_names), robot.plant().parameters
    inverse = InverseFlow(robot.links, robot.drive, layout=robot.layout)
    function = trace(lambda *a: inverse(*a[:5], table.named(a[5])), *(n,) * 5, table.size)
    softer = robot.with_values(
        {name: 0.7 * v for name, v in robot.nominal.items() if name.startswith("stiffness")}
    )
    q = along(path(n), np.array(0.2))
    for one in (robot, softer):
        x, u = one.inverse_dynamics(*q)
        found = apply(function, *q, one.plant().parameters.vector())
        np.testing.assert_allclose(found[0], x, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(found[1], u, rtol=1e-12, atol=1e-12)


@pytest.mark.quick_cases(5)
@pytest.mark.oracle
def test_the_last_chain_is_the_decoupling_matrix(robot):
    """∂u/∂q⁗ is J K⁻¹ M(q), times R/k_t for voltages, [spong1987]."""
    n, p = len(robot.joint_names), Parameters(robot.plant_parameters())
    q = along(path(n), np.array(0.2))
    inverse = InverseFlow(robot.links, robot.drive, layout=robot.layout)
    _, found = jacobian(lambda v: inverse(*q[:4], v, p)[1], n)(q[4])
    mass = np.linalg.inv(
        np.stack([robot.links.accelerations(q[0], 0 * q[0], e, p) - robot.links.accelerations(q[0], 0 * q[0], 0 * e, p)
                  for e in np.eye(n)], axis=1).astype(float)
    )  # fmt: skip
    expected = np.diag(np.broadcast_to(p.motor_inertia / p.stiffness, n)) @ mass
    if robot.drive == "voltage":
        expected = np.diag(np.broadcast_to(p.resistance / p.torque_constant, n)) @ expected
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())


def test_rows_and_single_points_agree():
    robot = load_robot("planar-two-link")
    rows = along(path(2), np.linspace(0.0, 1.0, 5))
    x, u = robot.inverse_dynamics(*rows)
    assert x.shape == (5, 8)
    assert u.shape == (5, 2)
    for k in range(5):
        xk, uk = robot.inverse_dynamics(*(row[k] for row in rows))
        np.testing.assert_allclose(xk, x[k], rtol=1e-13)
        np.testing.assert_allclose(uk, u[k], rtol=1e-13)
    still, hold = robot.inverse_dynamics(rows[0])
    np.testing.assert_array_equal(still[:, 2:4], 0.0)
    assert hold.shape == (5, 2)
    assert [a.shape for a in robot.inverse_dynamics(np.zeros((0, 2)))] == [(0, 8), (0, 2)]


def arm_with_everything() -> Robot:
    return paper_arm().with_parameters(
        Parameter("damping", 1.0), Parameter("spring_hardening", 5.0), Parameter("backlash", 0.01)
    )


@pytest.mark.parametrize("extra", ["inductance", "joint_damping", "spring_hardening", "backlash"])
def test_what_has_no_such_inverse_is_refused_by_name(extra):
    with pytest.raises(InvalidInput, match=extra) as caught:
        arm_with_everything().inverse_dynamics([0.0], extras=extra)
    assert caught.value.advice


@pytest.mark.parametrize(
    "motion",
    [([0.0, 0.0],), ([np.nan],), ("up",), (np.zeros((3, 1)), np.zeros((2, 1))), (np.zeros((1, 1, 1)),)],
)
def test_motions_that_do_not_fit_are_refused(motion):
    with pytest.raises(InvalidInput) as caught:
        paper_arm().inverse_dynamics(*motion)
    assert caught.value.advice
