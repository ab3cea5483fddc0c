import numpy as np
import pytest

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
    with pytest.raises(InvalidInput, match="positive definite"):
        Penalty({}, effort).r2(2)


@pytest.mark.parametrize("effort", [[1.0, 2.0, 3.0], [1.0], np.eye(3), np.ones((2, 3))])
def test_efforts_of_another_size_are_refused(effort):
    with pytest.raises(InvalidInput, match="wrong shape"):
        Penalty({}, effort).r2(2)


@pytest.mark.parametrize("effort", [np.nan, np.inf, "much", None, [[1.0], [1.0, 2.0]], np.ones((1, 1, 1))])
def test_efforts_that_are_no_numbers_are_refused(effort):
    with pytest.raises(InvalidInput, match="finite numbers"):
        Penalty({}, effort)


@pytest.mark.parametrize(
    "states",
    [{"d": 1.0}, {"a": np.nan}, {"a": "much"}, [1.0, 2.0], [1.0, 2.0, np.inf], 3.0, [[1.0, 2.0, 3.0]]],
)
def test_weights_that_do_not_fit_are_refused(states):
    with pytest.raises(InvalidInput):
        Penalty(states).weights(NAMES)
