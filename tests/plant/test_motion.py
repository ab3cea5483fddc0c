import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.loop import Constant, JerkLimited, Quintic, Samples, Sine
from flexhinf.plant.plant import motion_of

T = np.linspace(0.0, 2.0, 11)
A, B = Sine(1.0, 0.5, phase=0.4), Quintic(0.0, 1.0, 1.5)


def test_one_signal_per_joint_in_order():
    motion = motion_of([A, B, 0.5], T, 4)
    assert motion.shape == (5, 11, 3)
    np.testing.assert_array_equal(motion[:, :, 0], A.derivatives(T))
    np.testing.assert_array_equal(motion[:, :, 1], B.derivatives(T))
    np.testing.assert_array_equal(motion[:, :, 2], Constant(0.5).derivatives(T))


def test_by_name_the_order_is_that_of_the_names():
    np.testing.assert_array_equal(
        motion_of({"a": A, "b": B}, T, 2, ("b", "a")), motion_of([B, A], T, 2, ("b", "a"))
    )


def test_one_signal_of_several_columns_or_of_one():
    both = JerkLimited((0.0, 1.0), (1.0, -1.0), 1.0, 2.0, 10.0, smoothing=0.1)
    np.testing.assert_array_equal(motion_of(both, T, 4), both.derivatives(T))
    np.testing.assert_array_equal(motion_of(A, T, 1)[:, :, 0], A.derivatives(T, 1))
    np.testing.assert_array_equal(
        motion_of([both, 2.0], T, 0)[0], np.column_stack([both(T), np.full(11, 2.0)])
    )
    np.testing.assert_array_equal(motion_of(np.array([1.0, 2.0]), T, 0)[0], np.tile([1.0, 2.0], (11, 1)))


@pytest.mark.parametrize(
    ("signals", "names"),
    [
        ({"a": A, "b": B}, ()), ({"a": A}, ("a", "b")), ({"a": A, "c": B}, ("a", "b")), ([A], ("a", "b")), ([], ()),
        ([lambda t: t], ()), (lambda t: t, ()), ("ab", ()), (None, ()), ([Samples([0.0, 1.0], [0.0, 1.0])], ()),
    ],
)  # fmt: skip
def test_signals_that_do_not_fit_are_refused(signals, names):
    with pytest.raises(InvalidInput) as caught:
        motion_of(signals, T, 4, names)
    assert caught.value.advice
