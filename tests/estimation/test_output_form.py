"""Which plants have the form ẋ = A x + φ(y, u): by hand, for robots, and where symbols alone would mislead."""

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.estimation.output_injection import null_space, output_form
from flexhinf.plant import Plant
from flexhinf.robot import load_robot, paper_arm
from flexhinf.robot.robot_file import catalogue
from flexhinf.scalars import clip, sign, where


def plant(flow, measured, n=3, **parameters):
    rows = np.atleast_2d(measured)
    return Plant(
        lambda x, u, d, p: np.array(flow(x, u, p)),
        lambda x, u, p: rows @ x,
        [f"x{i + 1}" for i in range(n)],
        ("u",),
        parameters=parameters,
    )


FIRST, BOTH, SUM = [1.0, 0.0, 0.0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [1.0, 0.0, 2.0]


@pytest.mark.parametrize(
    ("flow", "measured"),
    [
        (lambda x, u, p: [x[1] - x[0] ** 3, x[2] + np.sin(x[0]) * u[0], -2.0 * x[1] + np.exp(x[0])], FIRST),
        (lambda x, u, p: [x[2], x[0] * x[1] * u[0], x[1] ** 2 - x[2]], BOTH),
        (lambda x, u, p: [x[1], np.sin(x[0] + 2.0 * x[2]), x[0] + (2.0 * x[2] + x[0]) ** 2 * u[0]], SUM),
        (
            lambda x, u, p: [x[1], clip(x[0], -1.0, 1.0) - x[2], sign(x[0]) + where(x[0] > 5.0, u[0], 0.0)],
            FIRST,
        ),
        (lambda x, u, p: [x[1], p.off * x[1] * x[2] + x[2], -x[1]], FIRST),
        (lambda x, u, p: [x[1] * np.cos(x[2]) ** 2 + x[1] * np.sin(x[2]) ** 2, x[2], -x[1]], FIRST),
        (lambda x, u, p: [x[1], x[2], np.sqrt(x[0] + 4.0) / (1.0 + x[0] ** 2)], FIRST),
    ],
    ids=["one", "two", "sum", "switch", "switched off", "identity", "domain"],
)
def test_a_nonlinearity_that_is_measured_is_found(flow, measured):
    made = plant(flow, measured, off=0.0)
    drift, rows = output_form(made)
    np.testing.assert_array_equal(rows, np.atleast_2d(measured))
    rng, hidden = np.random.default_rng(0), null_space(rows)
    p = made.parameters.named(made.parameters.vector())
    for _ in range(20):
        x, u = rng.normal(size=3), rng.normal(size=1)
        other = x + hidden @ rng.normal(size=hidden.shape[1])  # the same output
        rest = [made.flow(s, u, np.zeros(0), p) - drift @ s for s in (x, other)]
        np.testing.assert_allclose(*rest, atol=1e-13)


@pytest.mark.parametrize(
    ("flow", "measured", "entering"),
    [
        (lambda x, u, p: [x[1], x[2] - x[1] ** 3, x[0]], FIRST, "x2"),
        (lambda x, u, p: [x[1], x[2] * x[0], x[0]], FIRST, "x3"),
        (lambda x, u, p: [x[1] * u[0], x[2], x[0]], FIRST, "x2"),
        (lambda x, u, p: [x[1], x[2] + 1e-6 * x[1] ** 3, 1e3 * x[1]], FIRST, "x2"),
        (lambda x, u, p: [x[1], x[2], sign(x[2])], FIRST, "x3"),
        (lambda x, u, p: [x[1], x[2], clip(x[2], -50.0, 50.0)], FIRST, "x3"),
        (lambda x, u, p: [x[1], where(x[1] > 40.0, 1.0, 0.0), x[2]], FIRST, "x2"),
        (lambda x, u, p: [x[1], x[2], where(x[0] > 40.0, 2.0 * x[2], x[2])], FIRST, "x3"),
        (lambda x, u, p: [x[1], x[2], abs(x[1])], FIRST, "x2"),
        (lambda x, u, p: [x[1], x[2], np.floor(x[2])], FIRST, "x3"),
        (lambda x, u, p: [x[1], x[2], np.sin(x[1] + x[2])], FIRST, "x2, x3"),
    ],
    ids=[
        "cube", "product", "input", "small", "sign", "clip", "jump", "far branch", "abs", "floor", "sum",
    ],
)  # fmt: skip
def test_what_enters_nonlinearly_and_is_not_measured_is_named(flow, measured, entering):
    with pytest.raises(InvalidInput) as caught:
        output_form(plant(flow, measured))
    assert f" {entering} enter" in caught.value.what
    assert "UnscentedKalmanFilter" in caught.value.advice
    names = entering.split(", ")
    assert f"measure {entering} " in caught.value.advice
    rows = np.vstack([np.atleast_2d(measured), *(np.eye(3)[int(name[1]) - 1] for name in names)])
    output_form(plant(flow, rows))  # the advice helps


def test_only_what_the_other_measurements_do_not_settle_is_asked_for():
    """x1 and x3 both enter, but their sum is measured: one of them will do."""
    flow = lambda x, u, p: [x[1], x[0] * x[2], -x[1]]  # noqa: E731
    with pytest.raises(InvalidInput) as caught:
        output_form(plant(flow, [1.0, 0.0, 1.0]))
    assert " x1, x3 " in caught.value.what
    assert "x1" in caught.value.advice
    assert "x3" not in caught.value.advice


@pytest.mark.parametrize(
    ("output", "found"),
    [
        (lambda x, u, p: np.array([x[0] ** 2]), "x1"),
        (lambda x, u, p: np.array([x[0] + x[1] * u[0]]), "x2"),
        (lambda x, u, p: np.array([sign(x[2]) + x[0]]), "x3"),
    ],
)
def test_a_curved_measurement_is_named(output, found):
    made = Plant(lambda x, u, d, p: -x, output, ("x1", "x2", "x3"), ("u",), outputs=("angle",))
    with refused_with(InvalidInput, "'angle'", "linear") as caught:
        output_form(made)
    assert f"∂angle/∂({found})" in caught.value.found


def test_an_input_and_a_constant_in_the_measurement_are_no_harm():
    made = Plant(
        lambda x, u, d, p: np.array([x[1], -np.sin(x[0]) - x[1]]),
        lambda x, u, p: np.array([p.scale * x[0] + u[0] ** 2 + 3.0]),
        ("x1", "x2"), ("u",), parameters={"scale": 2.0},
    )  # fmt: skip
    np.testing.assert_array_equal(output_form(made)[1], [[2.0, 0.0]])


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize(
    ("name", "measured", "missing"),
    [
        ("paper", ["link_position"], None),
        ("paper", ["motor_position"], "link_position"),
        ("paper", ["motor_position", "joint_torque"], None),  # together they are the link's position
        ("vertical-rig", ["link_position"], None),
        ("quanser-rotflex", ["motor_velocity"], None),  # linear, whatever is measured
        ("planar-two-link", ["link_position"], "link_velocity, motor_position"),
        ("planar-two-link", ["link_position", "link_velocity"], "motor_position"),
        ("planar-two-link", ["link_position", "link_velocity", "joint_torque"], None),
        ("planar-two-link", ["joint_torque"], "link_position, link_velocity"),
        (
            "planar-two-link",
            ["link_position_shoulder", "link_velocity", "motor_position"],
            "link_position_elbow",
        ),
        ("seven-link", ["link_position"], "link_velocity, motor_position"),
        ("seven-link", ["link_position", "link_velocity", "motor_position"], None),
    ],
)
def test_robots(name, measured, missing):
    arm = load_robot(catalogue()[name])
    if missing is None:
        output_form(arm.plant(measured))
        return
    with pytest.raises(InvalidInput) as caught:
        output_form(arm.plant(measured))
    assert f"measure {missing} " in caught.value.advice
    output_form(arm.plant([*measured, *missing.split(", ")]))


def test_a_hardening_spring_wants_its_twist_and_a_hard_friction_its_velocity():
    arm = load_robot(catalogue()["planar-two-link"])
    measured = ["link_position", "link_velocity", "motor_position"]
    with pytest.raises(InvalidInput, match=r"try: .* motor_velocity "):
        output_form(arm.plant(measured, extras=["coulomb_friction"]))
    output_form(arm.plant([*measured, "motor_velocity"], extras=["coulomb_friction"]))


def test_the_split_is_flat_at_the_asked_point():
    arm = paper_arm().plant()
    point = np.array([np.pi, 0.0, np.pi, 0.0])
    np.testing.assert_array_equal(output_form(arm, point)[0], arm.linearise(point)[0])
    np.testing.assert_array_equal(output_form(arm)[0], arm.linearise()[0])


def test_a_point_without_a_linearisation_is_named():
    made = plant(lambda x, u, p: [x[1] + np.sqrt(x[0]), x[2], -x[1]], FIRST)
    with pytest.raises(InvalidInput, match="about="):
        output_form(made)
    output_form(made, np.ones(3))


def test_null_space_keeps_states_apart():
    matrix = np.array([[0.0, 5.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1e-6]])
    np.testing.assert_array_equal(np.abs(null_space(matrix)), np.eye(4)[:, [0, 2]])
    assert null_space(np.eye(3)).shape == (3, 0)
    np.testing.assert_array_equal(null_space(np.zeros((1, 2))), np.eye(2))
    mixed = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 6.0]])
    assert null_space(mixed).shape == (3, 2)
    np.testing.assert_allclose(mixed @ null_space(mixed), 0.0, atol=1e-15)


@pytest.mark.parametrize(
    "wrap",
    [
        lambda angle: np.arctan2(np.sin(angle), np.cos(angle)),
        lambda angle: np.arctan(np.tan(angle)),
        lambda angle: np.arctan(np.sin(angle) / np.cos(angle)),
    ],
)
def test_an_angle_that_wraps_is_not_linear(wrap):
    """Its slope is one wherever it has one."""
    measured = Plant(
        lambda x, u, d, p: np.array([x[1], u[0]]), lambda x, u, p: [wrap(x[0])], ("a", "b"), ("u",)
    )
    with refused_with(InvalidInput, "'output_1'", "linear"):
        output_form(measured)
    hidden = Plant(
        lambda x, u, d, p: np.array([wrap(x[1]), u[0] - x[1]]), lambda x, u, p: x[:1], ("a", "b"), ("u",)
    )
    with refused_with(InvalidInput, "measure b"):
        output_form(hidden)
