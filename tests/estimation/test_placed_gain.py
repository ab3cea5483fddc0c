import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from flexhinf.errors import InvalidInput, NotDetectable
from flexhinf.estimation.stationary import check_decay, check_detectable, placed_gain, unobservable

CHAIN = np.eye(4, k=1)  # four integrators
FIRST = np.eye(1, 4)
NAMES = ("a", "b", "c", "d")


def placed(drift, measured, period, poles):
    names = NAMES[: len(drift)]
    transition = expm(drift * period)
    gain = placed_gain(drift, measured, transition, period, poles, names)
    error = (np.eye(len(drift)) - gain @ measured) @ transition
    return np.sort_complex(np.log(np.linalg.eigvals(error).astype(complex)) / period)


@pytest.mark.parametrize("period", [1e-3, 0.05])
@pytest.mark.parametrize(
    "poles", [[-3, -4, -5, -6], [-10 + 8j, -10 - 8j, -4, -20], [-1 - 9j, -1 + 9j, -2 + 1j, -2 - 1j]]
)
def test_the_error_has_the_wanted_poles(poles, period):
    found = placed(CHAIN, FIRST, period, poles)
    np.testing.assert_allclose(found, np.sort_complex(np.array(poles, dtype=complex)), rtol=1e-6)


def test_several_measurements_of_different_scale_and_some_that_say_the_same():
    rng = np.random.default_rng(2)
    drift, poles = rng.normal(size=(4, 4)), np.array([-5.0, -5.0, -8.0 + 2.0j, -8.0 - 2.0j])
    rows = np.vstack([1e-3 * FIRST, 1e4 * np.eye(4)[2], 2e4 * np.eye(4)[2], np.zeros(4)])
    np.testing.assert_allclose(placed(drift, rows, 0.01, poles), np.sort_complex(poles), rtol=1e-5)


@pytest.mark.parametrize(
    ("poles", "found"),
    [
        ([-1, -2, -3], " 4 finite"),
        ([-1, -2, -3, -4, -5], " 4 finite"),
        ([-1, -2, -3, np.nan], " 4 finite"),
        ("fast", " 4 finite"),
        ([-1, -2, -3, 0.0], "negative"),
        ([-1, -2, -3 + 1j, -3 + 1j], "conjugate"),
        ([-1, -2, -3 + 1j, -3 - 1.1j], "conjugate"),
        ([-1, -2, -3 + 400j, -3 - 400j], "below 314.159 rad/s"),
        ([-1, -2, -3, -3], "independent"),
    ],
)
def test_poles_that_cannot_be(poles, found):
    with pytest.raises(InvalidInput) as caught:
        placed(CHAIN, FIRST, 0.01, poles)
    assert found in caught.value.found
    assert caught.value.advice


@pytest.mark.parametrize(
    ("measured", "mainly"), [(np.eye(4)[1:2], "a"), (np.eye(4)[3:4], "a"), (np.zeros((1, 4)), "a")]
)
def test_without_an_observable_pair_no_pole_is_placed(measured, mainly):
    with pytest.raises(NotDetectable, match=f"'{mainly}'"):
        placed(CHAIN, measured, 0.01, [-1, -2, -3, -4])


@pytest.mark.oracle
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_what_is_hidden_is_the_kernel_of_the_observability_matrix(scale):
    rng = np.random.default_rng(1)
    seen, hidden = rng.normal(size=(3, 3)), rng.normal(size=(2, 2))
    drift = block_diag(seen, hidden)
    drift[3:, :3] = rng.normal(size=(2, 3))
    change = np.diag([1.0, scale, 1.0, scale, 1.0]) @ rng.normal(size=(5, 5))
    drift = change @ drift @ np.linalg.inv(change)
    measured = np.hstack([rng.normal(size=(1, 3)), np.zeros((1, 2))]) @ np.linalg.inv(change)
    basis = unobservable(drift, measured)
    assert basis.shape == (5, 2)
    found = np.linalg.eigvals(basis.T @ drift @ basis)
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(np.linalg.eigvals(hidden)), rtol=1e-6)


def test_observable_chains_of_any_speed():
    for speed in (1e-3, 1.0, 1e4):
        assert unobservable(speed * CHAIN, FIRST).shape == (4, 0)
    assert unobservable(np.zeros((4, 4)), FIRST).shape == (4, 3)


def test_detectable_is_less_than_observable():
    stable = np.diag([1.0, -2.0])
    check_detectable(stable, np.eye(1, 2), ("a", "b"))
    with pytest.raises(NotDetectable, match="'a'"):
        check_detectable(stable, np.eye(2)[1:], ("a", "b"))
    with pytest.raises(NotDetectable, match="'a'"):
        check_detectable(CHAIN, np.eye(4)[1:2], NAMES)


def test_an_error_that_stays_is_refused():
    check_decay(np.diag([0.999999, 0.5]))
    for factor in (1.0, 1.1, -1.0):
        with pytest.raises(InvalidInput, match=f"decay(.|\n)*got {abs(factor):g}\n"):
            check_decay(np.diag([factor, 0.5]))
