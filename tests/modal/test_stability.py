"""Proved ranges of pairs against eigenvalues."""

from types import SimpleNamespace

import numpy as np
import pytest
from flint import ctx
from scipy.linalg import expm, solve_discrete_are

from flexhinf.modal import pair_gains, proved_range, stability
from flexhinf.modal.tolerance import sampled_pair

PERIOD, ENDS = 1e-3, (60.0**2, 300.0**2)
SEEN = np.eye(4)[[0, 2]]

#: Factor of the gains with which the fastest pairs are unstable.
LOUDER = 12.0

#: Ends of log λ in the filter's series, beyond those of the pairs.
LOW, HIGH = np.log(ENDS[0]) - 0.5, np.log(ENDS[1]) + 0.5


@pytest.fixture(scope="module")
def gains():
    return pair_gains(ENDS, 110.0**2, 12.0, PERIOD)


@pytest.fixture(scope="module")
def filter(gains):
    """SciPy's Kalman gains of pairs with both encoders, as a Chebyshev series."""

    def gain(places):
        rows = []
        for place in np.atleast_1d(places):
            f, _ = model(gains, np.exp(0.5 * (LOW + HIGH) + 0.5 * (HIGH - LOW) * place))
            noise, errors = np.diag([1e-14, 1e-7, 1e-14, 1e-7]), 1e-10 * np.eye(2)
            p = solve_discrete_are(f.T, SEEN.T, noise, errors)
            rows.append((p @ SEEN.T @ np.linalg.inv(SEEN @ p @ SEEN.T + errors)).ravel())
        return np.array(rows)

    table = np.polynomial.chebyshev.chebinterpolate(gain, 20)
    return SimpleNamespace(pair=(SEEN, table, (LOW, HIGH)), gain=gain)


def model(gains, link):
    """F (4, 4) and the column of the held input, by SciPy."""
    a, k = np.zeros((5, 5)), gains.motor
    a[0, 1] = a[2, 3] = 1.0
    a[1, [0, 2]] = -link, link
    a[3] = [k, 0.0, -k, -gains.damping, k]
    whole = expm(PERIOD * a)
    return whole[:4, :4], whole[:4, 4:]


@pytest.mark.costs("laws of all tests here")
@pytest.mark.quick_cases(1)
@pytest.mark.oracle
@pytest.mark.parametrize(("latency", "fastest"), [(0, 100.0), (0, 300.0), (1, 300.0)])
def test_all_pairs_are_proved_stable_and_are(gains, filter, latency, fastest):
    """With the filter, in which modes of the law's loop and of the filter's error stand beside each other."""
    cap = ctx.cap
    for each in (None, filter):
        found = proved_range(gains, fastest=fastest, latency=latency, filter=each)
        assert (found.low, found.high) == (ENDS[0], fastest**2)
        assert found.intervals > 1
    assert ctx.cap == cap
    for link in np.geomspace(*ENDS, 5):
        f, g = model(gains, link)
        place = (2.0 * np.log(link) - LOW - HIGH) / (HIGH - LOW)
        observer = filter.gain(place).reshape(4, 2)
        parts = []
        for observed in (None, (observer, SEEN)):
            acting, memory = sampled_pair(np.hstack([f, g]), gains(link)[:5], PERIOD, latency, observed)
            parts.append(np.linalg.eigvals(np.vstack([np.hstack([f, g]) @ acting, memory])))
        error = np.linalg.eigvals(f @ (np.eye(4) - observer @ SEEN))
        np.testing.assert_allclose(np.sort(np.abs(parts[1])), np.sort(np.abs([*parts[0], *error])), atol=1e-4)
        assert np.abs(parts[1]).max() < 1.0


@pytest.mark.oracle
def test_between_the_ends_of_an_interval_the_loop_is_where_the_proof_says(gains, filter, monkeypatch):
    """A in the middle less the mean of the ends, by the pairs of those λ, against the second coefficient."""
    asked, positive = [], stability._positive

    def spied(ends, between, bend, root):
        most = np.array(
            [[float(e.abs_upper()) for e in row] for row in stability._order(between, 2).tolist()]
        )
        asked.append(([stability._numbers(stability._order(end, 0)) for end in ends], most * float(bend)))
        return positive(ends, between, bend, root)

    monkeypatch.setattr(stability, "_positive", spied)
    first = proved_range(gains, fastest=1.3 * np.sqrt(ENDS[0]), latency=1, filter=filter).low
    (low, high), bound = asked[0]
    table = filter.pair[1]

    def loop(link):
        place = (2.0 * np.log(link) - LOW - HIGH) / (HIGH - LOW)
        observer = np.polynomial.chebyshev.chebval(place, table).reshape(4, 2), SEEN
        period = np.hstack(model(gains, link))
        # The proof counts motors from links.
        apart = np.eye(4) - np.eye(4, k=-2)
        acting, memory = sampled_pair(period, gains(link)[:5], PERIOD, 1, observer)
        return apart, np.vstack([period @ acting, memory])

    apart, start = loop(first)
    turn = np.eye(len(low))
    turn[:4, :4] = turn[4:8, 4:8] = apart
    np.testing.assert_allclose(low, turn @ start @ np.linalg.inv(turn), atol=1e-6)
    ends = first * np.exp(np.array([0.0, stability.LONGEST]))
    matrices = [turn @ loop(link)[1] @ np.linalg.inv(turn) for link in (*ends, ends.mean())]
    np.testing.assert_allclose(high, matrices[1], atol=1e-6)
    distance = np.abs((matrices[0] + matrices[1]) / 2.0 - matrices[2])
    assert distance.max() > 1e-5
    assert np.all(distance <= bound + 1e-9)


@pytest.mark.ci("one more proof")
def test_the_proof_ends_where_pairs_are_unstable(gains):
    loud = pair_gains(ENDS, 110.0**2, 12.0, PERIOD)
    vars(loud).update(coefficients=LOUDER * loud.coefficients)
    links, radius = np.geomspace(*ENDS, 400), []
    for link in links:
        period = np.hstack(model(gains, link))
        acting, memory = sampled_pair(period, loud(link)[:5], PERIOD, 1)
        radius.append(np.abs(np.linalg.eigvals(np.vstack([period @ acting, memory]))).max())
    first = links[np.argmax(np.array(radius) >= 1.0)]
    assert ENDS[0] < first < ENDS[1]
    assert 0.9 * first < proved_range(loud, latency=1).high < first
