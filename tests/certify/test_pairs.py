"""Certificates of pairs: proved, by a second route, against eigenvalues of mixed errors, forged and damaged."""

import copy
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm

from flexhinf.certify.checker import pairs as checker
from flexhinf.certify.checker.pairs import CheckedPairs, check_pairs, interval_proved, pair_claim
from flexhinf.design.workspace.pair_proof import claim_numbers, largest_certificate
from flexhinf.errors import InvalidInput
from flexhinf.modal import ModalLaw, pair_gains
from flexhinf.modal.popov import (
    SYMMETRIC,
    PairStorages,
    SampledPairs,
    Sector,
    popov_tolerance,
    smallest_unstable,
)
from flexhinf.robot import load_robot

PERIOD, ENDS = 1e-3, (60.0**2, 500.0**2)


@pytest.fixture(scope="module")
def pairs():
    return SampledPairs(pair_gains(ENDS, 110.0**2, 12.0, PERIOD), latency=1)


@pytest.fixture(scope="module")
def found(pairs):
    """Tolerance and certificate of symmetric errors."""
    return largest_certificate(pairs, Sector(1.0, 1.0), lambda text: None)


@pytest.mark.costs("searches and checks one proof, which all tests here read")
def test_all_pairs_are_proved_to_tolerate_nearly_what_is_computed(found):
    tolerance, numbers = found
    assert 0.5 < tolerance.sector.lower < 1.0
    checked = check_pairs(pair_claim(json.loads(json.dumps(numbers))))
    assert isinstance(checked, CheckedPairs)
    assert checked.low <= ENDS[0] < ENDS[1] <= checked.high
    assert checked.lower >= 0.89 * tolerance.sector.lower


@pytest.mark.oracle
@pytest.mark.parametrize(("latency", "watched"), [(0, None), (2, None), (1, [0, 2]), (1, [2])])
def test_search_and_checker_compute_the_same_game(pairs, latency, watched):
    """They share no code: A, Q and W of a pair agree, for a filter with links, and with motors alone."""
    seen = None if watched is None else np.eye(4)[watched]
    table = None if seen is None else np.random.default_rng(1).normal(size=(5, 4 * len(seen)))
    ends = (np.log(ENDS[0]) - 1.0, np.log(ENDS[1]) + 1.0)
    filter = None if seen is None else SimpleNamespace(pair=(seen, table, ends))
    loop, link = SampledPairs(pairs.gains, latency, filter), 150.0**2
    storages = PairStorages(loop, Sector(0.3, 0.5), 20.0, 0.4)
    n = 6 + latency + 4 * (seen is not None)
    parts = [{"low": link, "high": 2.0 * link, "storages": [[1.0] * (n * (n + 1) // 2)] * 2}]
    claim = pair_claim(claim_numbers(storages, parts))
    with checker._balls():
        checked = checker._loop(claim, arb(link), arb(0))
        values = [np.array([[float(e) for e in row] for row in part.parts[0].tolist()]) for part in checked]
    for value, expected in zip(values, loop.worst_period(link, *(storages.sector, 20.0, 0.4))):
        np.testing.assert_allclose(value, expected, atol=1e-9 * np.abs(expected).max())


def mixed_radius(pairs, links, error):
    """Spectral radius of pairs λ (n,) with a symmetric error Δ (n, n) of their inverse inertia, by SciPy: the law
    predicts with what the pairs should be."""
    gains, n, h = pairs.gains, len(links), PERIOD
    kappa, beta, root = gains.motor, gains.damping, np.sqrt(links)

    def moved(stiffness):
        zero, one = np.zeros((n, n)), np.eye(n)
        a = np.block([[zero, one, zero, zero], [-stiffness, zero, stiffness, zero], [zero, zero, zero, one],
                      [kappa * one, zero, -kappa * one, -beta * one]])  # fmt: skip
        b = np.vstack([zero, zero, zero, kappa * one])
        whole = expm(h * np.block([[a, b], [np.zeros((n, 5 * n))]]))
        return whole[: 4 * n, : 4 * n], whole[: 4 * n, 4 * n :]

    true, entry = moved(np.diag(links) + root[:, None] * error * root)
    known, own = moved(np.diag(links))
    k, unit = gains(links)[:, :5], np.eye(7 * n)
    x, total, last, waiting = unit[: 4 * n], unit[4 * n : 5 * n], unit[5 * n : 6 * n], unit[6 * n :]
    integral = total + 0.5 * h * (last + x[:n])
    ahead = known @ x + own @ waiting
    force = -(np.hstack([np.diag(column) for column in k.T[:4]]) @ ahead + np.diag(k[:, 4]) @ integral)
    loop = np.vstack([true @ x + entry @ waiting, integral, x[:n], force])
    return np.abs(np.linalg.eigvals(loop)).max()


@pytest.mark.oracle
def test_proved_errors_that_mix_pairs_never_destabilise_and_larger_ones_do(pairs, found):
    size, rng = found[1]["lower"], np.random.default_rng(0)
    for _ in range(60):
        links = np.exp(rng.uniform(*np.log(ENDS), 3))
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        error = turn @ np.diag(size * rng.choice([-1.0, 1.0], 3) * rng.choice([1.0, 0.5], 3)) @ turn.T
        assert mixed_radius(pairs, links, error) < 1.0
    worst = max(
        mixed_radius(pairs, np.array([link]), np.array([[sign * factor * size]]))
        for link in np.geomspace(*ENDS, 20) for sign in (-1.0, 1.0) for factor in (1.3, 1.6)
    )  # fmt: skip
    assert worst > 1.0


def peak(numbers, link, pieces=6):
    """Largest eigenvalue of δ₁δ₂ AᴴA + ½(δ₂ − δ₁)(A + Aᴴ) + τ (R + Rᴴ) over frequencies, of the lifted response from
    d to a and to its rate, in `pieces` of a period. Below 1 the inequality holds at λ. Of the file alone, by SciPy."""
    h, root = numbers["period"], np.sqrt(link)
    a, b, g = np.zeros((4, 4)), np.eye(4)[3] * numbers["input"], np.eye(4)[1] * root
    a[0, 1] = a[2, 3] = 1.0
    a[1, [0, 2]] = -link, link
    a[3, [0, 2, 3]] = numbers["motor"], -numbers["motor"], -numbers["damping"]
    whole = np.zeros((6, 6))
    whole[:4] = np.column_stack([a, b, g])
    part = expm(whole * h / pieces)[:4]
    c, columns = np.array([-root, 0.0, root, 0.0]), 5 + pieces
    state, outs, rates = np.eye(4, columns), [], []
    for piece in range(pieces):
        after = part[:, :4] @ state
        after[:, 4] += part[:, 4]
        after[:, 5 + piece] += part[:, 5]
        outs.append(c @ (state + after) / 2)
        rates.append(c @ (after - state) * pieces / h)
        state = after
    unit = np.eye(7)
    k = np.array(numbers["coefficients"]) @ [*(p / (link + p) for p in numbers["poles"]), 1.0]
    integral = unit[4] + 0.5 * h * (unit[5] + unit[0])
    ahead = state[:, :5] @ np.vstack([unit[:4], unit[6]])
    force = -(k[:4] @ ahead + k[4] * integral)
    acting = np.vstack([unit[:4], unit[6]])
    loop = np.vstack([state[:, :5] @ acting, integral, unit[0], force])
    entry = np.vstack([state[:, 5:], np.zeros((3, pieces))])
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 3000))[:, None, None]
    inner = np.linalg.solve(z * np.eye(7) - loop, np.broadcast_to(entry, (len(z), *entry.shape)))
    out, rate = (np.array(rows)[:, :5] @ acting @ inner + np.array(rows)[:, 5:] for rows in (outs, rates))
    lower, upper, tau = numbers["lower"], numbers["upper"], numbers["multiplier"] * h
    half = 0.5 * (upper - lower) * out + tau * rate
    total = lower * upper * out.conj().transpose(0, 2, 1) @ out + half + half.conj().transpose(0, 2, 1)
    return np.linalg.eigvalsh(total)[:, -1].max()


@pytest.mark.oracle
def test_a_second_route_by_frequencies_finds_the_same_tolerance(found):
    tolerance, numbers = found
    links = np.geomspace(*ENDS, 12)
    assert max(peak(numbers, link) for link in links) < 1.0
    beyond = {**numbers, "lower": 1.05 * tolerance.sector.lower, "upper": 1.05 * tolerance.sector.upper}
    assert max(peak(beyond, link) for link in links) > 1.0


def test_a_sector_larger_than_the_tolerance_is_not_accepted(found):
    tolerance, numbers = found
    larger = {**numbers, "lower": 1.1 * tolerance.sector.lower, "upper": 1.1 * tolerance.sector.upper}
    assert isinstance(check_pairs(pair_claim(larger)), int)


@pytest.mark.costs("many loops of pairs")
def test_forged_and_damaged_files_are_never_accepted(found):
    """A forged number that claims more, or a storage of another pair, is refused; damage cannot be read."""
    _, numbers = found
    rng, kept = np.random.default_rng(3), {**numbers, "intervals": numbers["intervals"][:1]}
    assert interval_proved(pair_claim(kept), 0)
    for _ in range(60):  # the law or the loop is another one than the storage's, by more than its room
        forged = copy.deepcopy(kept)
        first, last = forged["intervals"][0]["storages"]
        name = rng.choice(
            ["motor", "input", "lower", "coefficients", "multiplier", "storage", "sign", "swap"]
        )
        factor = float(rng.choice([0.3, 3.0, 1e200]))
        if name == "coefficients":
            forged[name] = (np.array(forged[name]) * -1.0).tolist()
        elif name == "storage":
            place = int(rng.integers(len(first)))
            first[place] += float(rng.choice([-1.0, 1.0])) * 10.0 * max(map(abs, first))
        elif name == "sign":
            last[:] = [-x for x in last]
        elif name == "swap":
            last[:] = [3.0 * x for x in last]
        elif name == "lower":
            forged["lower"], forged["upper"] = 0.99, 3.0
        else:
            forged[name] *= factor
        assert not interval_proved(pair_claim(forged), 0), name
    damaged, names = 0, sorted(numbers)
    for _ in range(200):
        broken, name = copy.deepcopy(kept), str(rng.choice(names))
        wrong = [None, "text", [], {}, True, float("nan"), float("inf"), -1.0, [[1.0], [2.0, 3.0]]]
        broken[name] = wrong[int(rng.integers(len(wrong)))]
        if rng.random() < 0.2:
            del broken[name]
        if (name == "observer" and broken.get(name, 0) is None) or (
            name == "multiplier" and broken.get(name) == -1.0
        ):
            continue
        with pytest.raises(InvalidInput):
            pair_claim(broken)
        damaged += 1
    assert damaged > 150


@pytest.mark.costs("many loops of pairs")
def test_a_payload_alone_leaves_a_larger_sector(pairs):
    """Links that are only heavier may be so by more than links that may also be lighter."""
    both, heavier = (
        popov_tolerance(pairs, shape, 8).sector for shape in (Sector(1.0, 1.0), Sector(1.0, 0.0))
    )
    assert heavier.lower >= 0.99 * both.lower
    assert heavier.upper == 0.0


@pytest.mark.nightly("proves the laws of two robots")
@pytest.mark.parametrize("name", ["paper", "scara"])
def test_the_table_of_the_page_is_what_is_proved(name, repository):
    page = (repository / "docs" / "certificate.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| {name} \| (\d+) % \| (\d+) % \| (\d+) % \|", page, re.MULTILINE)
    assert row is not None
    loop = SampledPairs(ModalLaw.tuned(load_robot(name).problem()).gains, latency=1)
    tolerance, numbers = largest_certificate(loop, SYMMETRIC, lambda text: None)
    assert numbers is not None
    sizes = tolerance.sector.lower, numbers["lower"], smallest_unstable(loop).error
    np.testing.assert_allclose([100.0 * size for size in sizes], [float(x) for x in row.groups()], atol=1.5)
