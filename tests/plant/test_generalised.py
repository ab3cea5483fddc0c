import re

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.plant import GeneralisedPlant, Penalty, Plant
from flexhinf.plant.polynomial_plant import Problem
from flexhinf.robot import paper_arm


def arm(**arguments):
    settings = {"command": "disturbance", "integrate": ("link_position",)}
    return paper_arm().plant().with_objective(paper_arm().penalty, **{**settings, **arguments})


def by_hand(x):
    """The paper's Sec. 6, written out."""
    x = np.atleast_2d(x)
    f = np.column_stack([
        x[:, 1], -9.8 * np.sin(x[:, 0]) - 100.0 * (x[:, 0] - x[:, 2]),
        x[:, 3], 100.0 * (x[:, 0] - x[:, 2]) - (0.9 + 0.1) * x[:, 3], x[:, 0],
    ])  # fmt: skip
    return f, np.column_stack([60.0 * x[:, 0], 300.0 * x[:, 4]])


@pytest.mark.oracle
def test_the_papers_problem():
    problem = arm()
    assert isinstance(problem, Problem)
    assert problem.state_names[-1] == "link_position_integral"
    assert problem.disturbance_names == ("link_position_command",)
    np.testing.assert_array_equal(problem.r2, [[10.0]])
    x = np.random.default_rng(0).normal(size=(20, 5))
    f, g1, g2, h = problem.fields(x)
    expected_f, expected_h = by_hand(x)
    np.testing.assert_allclose(f, expected_f, rtol=1e-14, atol=1e-13)
    np.testing.assert_allclose(h, expected_h, rtol=1e-15)
    np.testing.assert_array_equal(g1, np.tile([[0.0], [0.0], [0.0], [0.0], [-1.0]], (20, 1, 1)))
    np.testing.assert_allclose(g2, np.tile([[0.0], [0.0], [0.0], [0.9], [0.0]], (20, 1, 1)), rtol=1e-15)


def test_one_point_is_a_row():
    f, g1, g2, h = arm().fields(np.ones(5))
    assert (f.shape, g1.shape, g2.shape, h.shape) == ((1, 5), (1, 5, 1), (1, 5, 1), (1, 2))
    shapes = [field.shape for field in arm().fields(np.zeros((0, 5)))]
    assert shapes == [(0, 5), (0, 5, 1), (0, 5, 1), (0, 2)]


def test_about_a_pose_the_fields_are_deviations():
    problem = arm(pose=[1.0])
    torque = 9.8 * np.sin(1.0)
    np.testing.assert_allclose(
        problem.operating_point, [1.0, 0.0, 1.0 + torque / 100.0, 0.0, 0.0], atol=1e-13
    )
    np.testing.assert_allclose(problem.operating_input, [torque / 0.9], rtol=1e-12)
    f, _, _, h = problem.fields(np.zeros(5))
    np.testing.assert_allclose(f, 0.0, atol=1e-12)
    np.testing.assert_allclose(h, 0.0, atol=1e-15)
    x = np.array([[0.2, -0.1, 0.3, 0.4, 0.5]])
    absolute = x + problem.operating_point
    expected, _ = by_hand(absolute)
    expected[0, 3] += 0.9 * problem.operating_input[0]
    expected[0, 4] = 0.2
    np.testing.assert_allclose(problem.fields(x)[0], expected, rtol=1e-13, atol=1e-12)


def test_torques_as_disturbances_after_the_command():
    problem = arm(disturbances=("motor_torque",))
    assert problem.disturbance_names == ("link_position_command", "motor_torque")
    _, g1, _, _ = problem.fields(np.zeros(5))
    np.testing.assert_array_equal(g1[0].T, [[0.0, 0.0, 0.0, 0.0, -1.0], [0.0, 0.0, 0.0, 1.0, 0.0]])
    alone = arm(command=None)
    assert alone.disturbance_names == ("link_torque", "motor_torque")
    np.testing.assert_array_equal(alone.fields(np.zeros(5))[1][0], np.eye(5)[:, [1, 3]])


def test_parameters_and_penalty_code_reach_the_fields():
    penalty = Penalty(lambda x, p: np.array([p.stiffness * x[0], x[1] ** 2]), 10.0)
    problem = arm()
    stiff = GeneralisedPlant(
        problem.plant.with_parameters(stiffness=200.0), penalty, ("link_position",), "disturbance"
    )
    f, _, _, h = stiff.fields(np.array([[0.1, 0.2, 0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(h, [[20.0, 0.04]], rtol=1e-15)
    assert f[0, 3] == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"command": "reference"}, r"command[\s\S]*'reference'"),
        ({"integrate": ()}, r"integral[\s\S]* integrate=\(\)"),
        ({"integrate": ("link_pos",)}, r"state[\s\S]*'link_pos'"),
        ({"integrate": ("link_position", "link_position")}, r"integrated.*'link_position'[\s\S]*distinct"),
        ({"disturbances": ("wind",)}, "disturbance 'wind'"),
        ({"disturbances": ("link_torque", "link_torque")}, "distinct"),
        ({"command": None, "disturbances": ()}, r"disturbances[\s\S]*got \[\]"),
        ({"penalty": {"speed": 1.0}}, r"penalty.*'speed'"),
        ({"penalty": Penalty({}, -1.0)}, r"R2.*definite"),
        ({"penalty": Penalty(lambda x, p: x + 1.0)}, r"h\(x\).*zero[\s\S]*\[1\.0, 1\.0, 1\.0, 1\.0, 1\.0\]"),
        ({"penalty": Penalty(lambda x, p: np.array([np.nan * x[0]]))}, r"h\(x\).*zero[\s\S]*\[nan\]"),
        ({"pose": [1.0, 2.0]}, r"pose[\s\S]* 1 finite.*\['link_position'\], got \[1\.0, 2\.0\]"),
        ({"pose": {"motor_position": 1.0}}, r"pose.*'motor_position'"),
    ],
)
def test_bad_problems_are_refused(arguments, word):
    settings = {"penalty": paper_arm().penalty, "command": "disturbance", "integrate": ("link_position",)}
    with pytest.raises(InvalidInput, match=word):
        paper_arm().plant().with_objective(**{**settings, **arguments})


def test_an_origin_that_is_no_rest_is_refused():
    plant = Plant(lambda x, u, d, p: u - 1.0 + d, lambda x, u, p: x, ("x",), ("u",), ("d",))
    with refused_with(InvalidInput, "equilibrium", "/dt x = -1"):
        plant.with_objective([1.0])


def test_a_pose_that_nothing_holds_is_a_failure():
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], 0.0 * u[0] + 1.0 + d[0]]),
        lambda x, u, p: x,
        ("x", "v"),
        ("u",),
        ("d",),
    )
    with refused_with(NumericalFailure, "equilibrium", "pose", "/dt v = 1"):
        plant.with_objective([1.0, 0.0, 0.0], integrate=("x",), pose=[1.0])


@pytest.mark.parametrize("x", [np.zeros(4), np.zeros((3, 6)), np.zeros((1, 1, 5))])
def test_points_that_do_not_fit_are_refused(x):
    with pytest.raises(InvalidInput, match=re.escape(f"shape {x.shape}")):
        arm().fields(x)
