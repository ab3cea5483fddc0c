"""Names that stand for several signals, and operating points that are given."""

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.plant import GeneralisedPlant, Penalty, Plant


def two_carts():
    """Two carts, each with its own force and disturbance."""
    return Plant(
        lambda x, u, d, p: np.array([x[2], x[3], u[0] + d[0] - x[0], u[1] + d[1] - x[1]]),
        lambda x, u, p: x[:2],
        states=("place_a", "place_b", "speed_a", "speed_b"),
        inputs=("force_a", "force_b"),
        disturbances=("push_a", "push_b"),
        groups={"place": ("place_a", "place_b"), "push": ("push_a", "push_b")},
    )


def test_a_group_stands_for_its_signals():
    weights = {"place": 3.0, "place_b": 5.0, "place_integral": [1.0, 2.0], "speed_a": 7.0}
    problem = two_carts().with_objective(
        weights, command="disturbance", integrate="place", disturbances=("push",)
    )
    assert problem.state_names[4:] == ("place_a_integral", "place_b_integral")
    assert problem.disturbance_names == ("place_a_command", "place_b_command", "push_a", "push_b")
    assert problem.penalty.weights(problem.state_names).tolist() == [3.0, 5.0, 7.0, 0.0, 1.0, 2.0]


def test_names_outside_groups_stay():
    assert two_carts().expanded(("speed_a", "place")) == ("speed_a", "place_a", "place_b")
    assert two_carts().expanded("speed_b") == ("speed_b",)


def test_a_group_needs_one_weight_or_one_each():
    with pytest.raises(InvalidInput, match="place"):
        two_carts().with_objective({"place": [1.0, 2.0, 3.0]})


def test_a_given_operating_point_is_used_and_checked():
    plant, penalty = two_carts(), Penalty({"place_a": 1.0})
    problem = GeneralisedPlant(plant, penalty, equilibrium=([0.5, 0.0, 0.0, 0.0], [0.5, 0.0]))
    assert problem.operating_point.tolist() == [0.5, 0.0, 0.0, 0.0]
    assert problem.operating_input.tolist() == [0.5, 0.0]
    with refused_with(InvalidInput, "equilibrium", "/dt speed_a = -0.1"):
        GeneralisedPlant(plant, penalty, equilibrium=([0.5, 0.0, 0.0, 0.0], [0.4, 0.0]))
    with refused_with(InvalidInput, "equilibrium=", "(1,), (2,), pose=None"):
        GeneralisedPlant(plant, penalty, equilibrium=([0.5], [0.4, 0.0]))
    with refused_with(InvalidInput, "equilibrium=", "(4,), (2,), pose=[0.5]"):
        GeneralisedPlant(plant, penalty, ("place_a",), pose=[0.5], equilibrium=(np.zeros(4), np.zeros(2)))
