import copy
import pickle

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty

NAMES = ("a", "b", "c")


def test_weights_by_name_and_in_order():
    np.testing.assert_array_equal(Penalty({"c": 3.0, "a": 1.0}).weights(NAMES), [1.0, 0.0, 3.0])
    np.testing.assert_array_equal(Penalty([1.0, 2.0, 3.0]).weights(NAMES), [1.0, 2.0, 3.0])


def test_h_leaves_out_what_may_be_large():
    x = np.array([2.0, 3.0, 4.0])
    np.testing.assert_array_equal(Penalty({"a": 5.0, "c": 7.0}).evaluate(x, NAMES, None), [10.0, 28.0])
    np.testing.assert_array_equal(Penalty(lambda x, p: x[0] * x[1]).evaluate(x, NAMES, None), [6.0])


def test_effort_as_number_diagonal_and_matrix():
    np.testing.assert_array_equal(Penalty({}, 10.0).r2(2), 10.0 * np.eye(2))
    np.testing.assert_array_equal(Penalty({}, [1.0, 2.0]).r2(2), np.diag([1.0, 2.0]))
    matrix = np.array([[2.0, 1.0], [1.0, 3.0]])
    np.testing.assert_array_equal(Penalty({}, matrix).r2(2), matrix)
    np.testing.assert_array_equal(Penalty.of({"a": 1.0}).r2(1), [[1.0]])
    penalty = Penalty({"a": 1.0}, 3.0)
    assert Penalty.of(penalty) is penalty


def test_weights_are_copied():
    weights = {"a": 1.0}
    penalty = Penalty(weights)
    weights["a"] = 2.0
    assert penalty.weights(NAMES)[0] == 1.0


@pytest.mark.parametrize(
    "effort", [0.0, -1.0, [1.0, 0.0], [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]]]
)
def test_efforts_that_are_not_positive_definite_are_refused(effort):
    with refused_with(InvalidInput, "R2", "definite"):
        Penalty({}, effort).r2(2)


@pytest.mark.parametrize("effort", [[1.0, 2.0, 3.0], [1.0], np.eye(3), np.ones((2, 3))])
def test_efforts_of_another_size_are_refused(effort):
    with refused_with(InvalidInput, "R2", "shape", "(2, 2)"):
        Penalty({}, effort).r2(2)


@pytest.mark.parametrize("effort", [np.nan, np.inf, "much", None, [[1.0], [1.0, 2.0]], np.ones((1, 1, 1))])
def test_efforts_that_are_no_numbers_are_refused(effort):
    with refused_with(InvalidInput, "effort", "R2", "finite"):
        Penalty({}, effort)


@pytest.mark.parametrize(
    "states",
    [{"d": 1.0}, {"a": np.nan}, {"a": "much"}, [1.0, 2.0], [1.0, 2.0, np.inf], 3.0, [[1.0, 2.0, 3.0]]],
)
def test_weights_that_do_not_fit_are_refused(states):
    with pytest.raises(InvalidInput):
        Penalty(states).weights(NAMES)


def test_a_matrix_gives_rows_of_h():
    rows = np.array([[1.0, -2.0, 0.0], [0.0, 0.5, 3.0]])
    x = np.array([2.0, 3.0, 4.0])
    penalty = Penalty(rows, 2.0)
    np.testing.assert_array_equal(penalty.evaluate(x, NAMES, None), [-4.0, 13.5])
    np.testing.assert_array_equal(Penalty(rows.tolist()).evaluate(x, NAMES, None), [-4.0, 13.5])
    np.testing.assert_array_equal(penalty.matrix, rows)
    assert penalty.expanded({"a": ("b", "c")}) is penalty
    assert Penalty({"a": 1.0}).matrix is None
    assert Penalty([1.0, 2.0, 3.0]).matrix is None


def test_a_matrix_goes_through_a_problem_as_weights_do():
    """Rows of a diagonal matrix are weights by name: the same h, expansion and smallest level."""
    import flexhinf as fh

    arm = fh.paper_arm()
    named = arm.problem(Penalty({"link_position": 60.0, "link_position_integral": 300.0}, 10.0))
    rows = arm.problem(Penalty(np.array([[60.0, 0, 0, 0, 0], [0, 0, 0, 0, 300.0]]), 10.0))
    x = np.random.default_rng(0).normal(size=(6, 5))
    np.testing.assert_allclose(rows.fields(x)[3], named.fields(x)[3], rtol=1e-14)
    np.testing.assert_allclose(rows.expand(3).h_parts[1], named.expand(3).h_parts[1], atol=1e-15)
    assert fh.smallest_gamma(rows) == pytest.approx(fh.smallest_gamma(named), rel=1e-9)


@pytest.mark.parametrize("rows", [np.eye(2), np.zeros((0, 3)), [[1.0, np.nan, 0.0]], np.ones((1, 4))])
def test_matrices_that_do_not_fit_the_states_are_refused(rows):
    with refused_with(InvalidInput, "penalty", "finite", "['a', 'b', 'c']", "shape"):
        Penalty(rows).evaluate(np.ones(3), NAMES, None)


@pytest.mark.parametrize(
    "states", [{"a": -1.0}, {"a": [1.0, -1.0]}, [1.0, 0.0, -2.0], np.array([-1.0, 0.0, 0.0])]
)
def test_negative_weights_are_refused(states):
    with refused_with(InvalidInput, "negative", "weights >= 0"):
        Penalty(states)


def test_a_misspelt_name_is_answered_with_the_nearest():
    with refused_with(InvalidInput, "'bb'", "'b'"):
        Penalty({"bb": 1.0}).weights(NAMES)


def test_a_penalty_of_nameless_code_is_copied_but_not_pickled():
    penalty = Penalty(lambda x, p: x, effort=2.0)
    assert copy.copy(penalty).states is copy.deepcopy(penalty).states is penalty.states
    with refused_with(InvalidInput, "penalty", "pickled"):
        pickle.dumps(penalty)
    same = pickle.loads(pickle.dumps(Penalty({"a": 1.0}, effort=[2.0])))
    assert same == Penalty({"a": 1.0}, effort=[2.0])
