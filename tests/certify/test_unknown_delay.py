"""An unknown constant delay of up to a sample in the certificates of pairs: proved, by second routes, and forged."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm
from tests.refusals import refused_with

from flexhinf.certify.checker import pairs as checker
from flexhinf.certify.checker.pair_claim import pair_claim
from flexhinf.certify.checker.pairs import Box, CheckedPairs, box_proved, check_pairs
from flexhinf.designs import Specification
from flexhinf.designs.workspace.pair_proof import claim_numbers, pair_certificate
from flexhinf.designs.workspace.preset import check_provable
from flexhinf.designs.workspace.proof import of_controller, pair_verdict
from flexhinf.errors import InvalidInput
from flexhinf.modal import pair_gains
from flexhinf.modal.multipliers import PopovTolerance, popov_tolerance
from flexhinf.modal.pair_errors import (
    EXACT,
    SYMMETRIC,
    ChannelWeights,
    Errors,
    FilterWeights,
    Multipliers,
    Sector,
)
from flexhinf.modal.pair_period import worst_period
from flexhinf.modal.popov import PairStorages
from flexhinf.modal.sampled_pairs import SampledPairs
from flexhinf.pages.workspace_check import pair_text
from flexhinf.pages.workspace_proof import delay_text
from flexhinf.robot import load_robot

PERIOD, ENDS, DELAY = 1e-3, (200.0**2, 215.0**2), 0.8


@pytest.fixture(scope="module")
def pairs() -> SampledPairs:
    return SampledPairs(pair_gains(ENDS, 110.0**2, 12.0, PERIOD), 1, None, DELAY)


@pytest.fixture(scope="module")
def found(pairs: SampledPairs) -> tuple[PopovTolerance, dict[str, Any]]:
    """The tolerance, and the certificate of most of it."""
    tolerance = popov_tolerance(pairs, SYMMETRIC, 5)
    size = 0.93 * tolerance.errors.masses.lower
    numbers = pair_certificate(
        PairStorages(pairs, Errors(Sector(size, size)), tolerance.multipliers, 0.05).lifted(),
        lambda done: None,
    )
    assert numbers is not None
    return tolerance, json.loads(json.dumps(numbers))


def lagrange(place: float, count: int) -> np.ndarray:
    """Weights of values at equidistant places, 0 to 1, in their polynomial at a place."""
    nodes = np.linspace(0.0, 1.0, count)
    others = [np.delete(nodes, k) for k in range(count)]
    return np.array([np.prod((place - other) / (own - other)) for own, other in zip(nodes, others)])


def late_radius(
    pairs: SampledPairs, links: np.ndarray, error: np.ndarray, springs: np.ndarray, late: float
) -> float:
    """Spectral radius of pairs λ (n,) that symmetric errors mix, in seconds and (z, w), by SciPy: inputs wait for the
    latency of a sample, of which the law knows, and for a part of one more, of which it does not."""
    gains, n, h = pairs.gains, len(links), PERIOD
    kappa, beta, root = gains.motor, gains.damping, np.sqrt(links)
    zero, one = np.zeros((n, n)), np.eye(n)

    def moved(inverse: np.ndarray, stiffness: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
        pulled, held = inverse @ stiffness, kappa * stiffness
        a = np.block([[zero, one, zero, zero], [-pulled, zero, pulled, zero], [zero, zero, zero, one],
                      [held, zero, -held, -beta * one]])  # fmt: skip
        b = np.vstack([zero, zero, zero, kappa * one])
        whole = expm(duration * np.block([[a, b], [np.zeros((n, 5 * n))]]))
        return whole[: 4 * n, : 4 * n], whole[: 4 * n, 4 * n :]

    true = np.diag(links) + root[:, None] * error * root, one + springs
    first, old = moved(*true, late * h)
    last, new = moved(*true, (1.0 - late) * h)
    known, own = moved(np.diag(links), one, h)
    k, unit = gains(links)[:, :5], np.eye(8 * n)
    x, total, before, acted, waiting = (
        unit[: 4 * n],
        *(unit[4 * n + i * n : 5 * n + i * n] for i in range(4)),
    )
    integral = total + 0.5 * h * (before + x[:n])
    ahead = known @ x + own @ waiting
    force = -(np.hstack([np.diag(column) for column in k.T[:4]]) @ ahead + np.diag(k[:, 4]) @ integral)
    after = last @ (first @ x + old @ acted) + new @ waiting
    return float(np.abs(np.linalg.eigvals(np.vstack([after, integral, x[:n], waiting, force]))).max())


@pytest.mark.ci("searches one proof, which four tests here read")
@pytest.mark.oracle
def test_proved_errors_never_destabilise_with_any_delay_and_larger_ones_do(
    pairs: SampledPairs, found: tuple[PopovTolerance, dict[str, Any]]
) -> None:
    """By a second route to the loop, which also gives the loop that the search has."""
    checked, rng = check_pairs(pair_claim(found[1])), np.random.default_rng(4)
    assert isinstance(checked, CheckedPairs)
    assert (checked.delay, checked.lower) == (DELAY, found[1]["lower"])
    assert checked.rate > 0.0
    for _ in range(60):
        late, links = (
            DELAY * float(rng.choice([0.0, rng.random(), 1.0])),
            np.exp(rng.uniform(np.log(ENDS[0]), np.log(ENDS[1]), 2)),
        )
        turn = np.linalg.qr(rng.normal(size=(2, 2)))[0]
        error = turn @ np.diag(checked.lower * rng.choice([-1.0, 1.0], 2)) @ turn.T
        radius = late_radius(pairs, links, error, 0.0 * error, late)
        assert radius < np.exp(-checked.rate * PERIOD)
        assert pairs.late_by(late).radius(links.tolist(), error, 0.1 * error) == pytest.approx(
            late_radius(pairs, links, error, 0.1 * error, late), abs=1e-9
        )
    one = np.array([[1.5 * found[0].errors.masses.lower]])
    radii = [
        late_radius(pairs, np.array([link]), sign * one, 0.0 * one, DELAY)
        for link in ENDS
        for sign in (1, -1)
    ]
    assert max(radii) > 1.0


def test_a_whole_sample_of_unknown_delay_is_one_more_input_that_waits(pairs: SampledPairs) -> None:
    """At θ = 1 the loop is that of a law which believes in one sample less than there are."""
    link, none = ENDS[0], np.zeros((1, 1))
    unknown = replace(pairs, delay=1.0, late=1.0)
    acting, memory = pairs.memory(link)
    flow = expm(pairs.model(link))[:4]
    loop = np.vstack([flow @ acting[:5], memory])
    assert unknown.radius([link], none) == pytest.approx(np.abs(np.linalg.eigvals(loop)).max(), abs=1e-12)
    known = replace(pairs, delay=0.0)
    assert replace(pairs, late=0.0).radius([link], none) == pytest.approx(
        known.radius([link], none), abs=1e-12
    )


@pytest.mark.oracle
@pytest.mark.parametrize("late", [0.0, 0.3, DELAY])
@pytest.mark.parametrize(("latency", "watched", "springs"), [(0, None, EXACT), (1, [0, 2], Sector(0.2, 0.3))])
def test_search_and_checker_compute_the_same_game(
    pairs: SampledPairs, late: float, latency: int, watched: list[int] | None, springs: Sector
) -> None:
    """They share no code: A, Q and W agree, with filters of the multiplier, springs and a slope."""
    seen = None if watched is None else np.eye(4)[watched]
    table = None if seen is None else np.random.default_rng(1).normal(size=(5, 4 * len(seen)))
    ends = (np.log(ENDS[0]) - 1.0, np.log(ENDS[1]) + 1.0)
    filter: Any = None if seen is None else SimpleNamespace(pair=(seen, table, ends))
    loop, link = SampledPairs(pairs.gains, latency, filter, DELAY, late), 205.0**2
    slope = Sector(0.0, 0.1) if springs != EXACT else EXACT
    weights = ChannelWeights(0.3, 0.1, 0.5, 0.7)
    predicted = weights._replace(prediction=0.17 * (slope != EXACT))
    high = (FilterWeights(0.4, 0.23, 0.05),) * (slope != EXACT)
    multipliers = Multipliers(
        20.0, weights, predicted, filters=(FilterWeights(0.2, 0.3, 0.1),), prediction_filters=high
    )
    errors = Errors(Sector(0.3, 0.5), springs, slope)
    expected = worst_period(loop, link, errors, multipliers, 0.4)
    n = len(expected.a)
    rows = [[[1.0] * (n * (n + 1) // 2)] * 2] * 2
    parts = [{"low": link, "high": 2.0 * link, "delays": [0.0, DELAY], "storages": rows}]
    claim = pair_claim(claim_numbers(PairStorages(loop, errors, multipliers, 0.4), parts))
    with checker._balls():
        found = checker._loop(claim, arb(link), arb(0), (arb(late), arb(0)))
        values = [np.array([[float(e) for e in row] for row in part.constant.tolist()]) for part in found]
    for value, own in zip(values, expected):
        np.testing.assert_allclose(value, own, atol=1e-9 * np.abs(own).max())


@pytest.mark.ci("searches one proof, which four tests here read")
@pytest.mark.oracle
def test_the_inequality_holds_between_the_ends_of_boxes(
    pairs: SampledPairs, found: tuple[PopovTolerance, dict[str, Any]]
) -> None:
    """At random λ and θ, by the search's numbers, with P as Lagrange's polynomial of both."""
    claim, rng = pair_claim(found[1]), np.random.default_rng(2)
    errors, multipliers = Errors(Sector(claim.lower, claim.upper)), found[0].multipliers
    assert max(map(len, claim.delays)) > 2
    each, count = len(claim.storages[0]) // (len(claim.delays[0]) - 1), claim.storages[0].shape[1]
    assert min(each, count) > 2
    for k in rng.integers(len(claim.storages), size=20):
        box = int(rng.integers(len(claim.delays[k]) - 1))
        u, v = rng.random(2)
        begin, end = claim.delays[k][box : box + 2]
        link, late = claim.links[k] + u * (claim.links[k + 1] - claim.links[k]), begin + v * (end - begin)
        weights = np.outer(lagrange(float(v), each), lagrange(float(u), count))
        p = np.tensordot(weights, claim.storages[k][box * each : (box + 1) * each], 2)
        a, q, w = worst_period(pairs.late_by(late), float(link), errors, multipliers, claim.rate)
        root = np.linalg.inv(np.linalg.cholesky(p)).T
        n = np.block([[p - q, a.T @ p], [p @ a, p - p @ w @ p]])
        both = np.kron(np.eye(2), root)
        assert np.linalg.eigvalsh(both.T @ n @ both)[0] > 0.0


@pytest.mark.ci("searches two proofs more")
@pytest.mark.oracle
def test_a_delay_that_destabilises_has_no_certificate(pairs: SampledPairs) -> None:
    """Gains at which the loop is stable without the unknown delay, and not with all of it."""
    none, links = np.zeros((1, 1)), np.array(ENDS)
    gains = replace(pairs.gains, coefficients=6.0 * pairs.gains.coefficients)
    radii = [
        [late_radius(replace(pairs, gains=gains), links[k : k + 1], none, none, late) for k in (0, 1)]
        for late in (0.0, DELAY)
    ]
    assert max(radii[0]) < 1.0 < max(radii[1])
    loud = SampledPairs(gains, 1, None, DELAY)
    assert popov_tolerance(loud, SYMMETRIC, 5).share == 0.0
    storages = PairStorages(loud, Errors(Sector(1e-3, 1e-3)), Multipliers(0.0), 0.0)
    assert pair_certificate(storages, lambda done: None) is None
    assert pair_certificate(replace(storages, pairs=replace(loud, delay=0.0)), lambda done: None) is not None


@pytest.mark.ci("searches one proof, which four tests here read")
def test_forged_delays_are_not_accepted(found: tuple[PopovTolerance, dict[str, Any]]) -> None:
    """A delay that the boxes do not cover, or boxes that are larger than their storages bear."""
    numbers = found[1]
    one = numbers["intervals"][0]
    for delay, delays in (
        (1.5 * DELAY, one["delays"]),
        (0.5 * DELAY, one["delays"]),
        (0.0, one["delays"]),
        (-DELAY, one["delays"]),
        (DELAY, [0.1, *one["delays"][1:]]),
        (DELAY, [*one["delays"][:-1], 0.9 * DELAY]),
        (DELAY, [0.0, *reversed(one["delays"][1:-1]), DELAY] if len(one["delays"]) > 3 else [0.0] * 3),
        (DELAY, [0.0, DELAY, DELAY]),
        (DELAY, one["delays"][:-1]),
        (DELAY, np.linspace(0.0, DELAY, len(one["storages"]) + 2).tolist()),
        (DELAY, None),
        (True, one["delays"]),
    ):
        file = {**numbers, "delay": delay, "intervals": [{**one, "delays": delays}]}
        with pytest.raises(InvalidInput, match="certificate"):
            pair_claim(file)
    ends = {"delays": [0.0, DELAY], "storages": one["storages"][:1]}
    assert check_pairs(pair_claim({**numbers, "intervals": [{**one, **ends}]})) == 0
    claim = pair_claim(numbers)
    storages = claim.storages[0][:1]
    whole = Box((float(claim.links[0]), float(claim.links[1])), (0.0, 0.0), storages)
    assert box_proved(claim, whole)
    assert not box_proved(claim, whole._replace(delays=(DELAY, DELAY)))


@pytest.mark.ci("searches one proof, which four tests here read")
def test_a_file_that_says_less_delay_than_its_design_has_is_refused(
    found: tuple[PopovTolerance, dict[str, Any]],
) -> None:
    """Its certificate holds delays up to 0.8 samples."""
    numbers = {**found[1], "intervals": found[1]["intervals"][:1]}
    file = {"pairs": numbers, "controller": of_controller(estimates=False)}
    verdict = pair_verdict({**file, "unknown_delay": DELAY})
    assert verdict.is_proved
    assert "0.8 ms" in pair_text(verdict)
    assert verdict.checked is not None
    for unknown in (1, 0.9, True, "0.5", None):
        other = pair_verdict({**file, "unknown_delay": unknown})
        assert not other.is_proved
        assert "samples" in other.beyond
    proved = {**verdict.checked._asdict(), "delay": 1.0}
    assert not pair_verdict({**file, "unknown_delay": 0.5, "proved": proved}).is_proved
    assert delay_text(verdict.checked._replace(delay=0.0), PERIOD) == ""


def test_more_than_a_sample_of_unknown_delay_is_refused_by_name() -> None:
    robot = load_robot("planar-two-link")
    check_provable(robot, Specification(unknown_delay=1e-3))
    with refused_with(InvalidInput, "unknown delay", "1 ms", "latency=3"):
        check_provable(robot, Specification(unknown_delay=3e-3))
