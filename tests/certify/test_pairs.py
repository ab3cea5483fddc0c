"""Certificates of pairs: proved, by a second route, against eigenvalues of mixed errors, forged and damaged."""

import copy
import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.workspace import masses
from benchmarks.workspace.robots import ROBOTS
from benchmarks.workspace.rows import ROWS, kept
from flint import arb
from numpy.polynomial.chebyshev import chebval
from scipy.linalg import expm
from tests.refusals import refused_with
from tests.tiers import ci_and_night

from flexhinf.certify.checker import pairs as checker
from flexhinf.certify.checker.pair_claim import ERRORS, pair_claim
from flexhinf.certify.checker.pairs import CheckedPairs, check_pairs
from flexhinf.designs import Specification
from flexhinf.designs.workspace.pair_proof import claim_numbers, largest_certificate, pair_certificate
from flexhinf.designs.workspace.proof import sampled_pairs
from flexhinf.designs.workspace.search import RANDOM
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.modal import ModalLaw, pair_gains
from flexhinf.modal.multipliers import popov_tolerance, small_gain_tolerance
from flexhinf.modal.pair_errors import (
    EXACT,
    SYMMETRIC,
    ChannelWeights,
    Errors,
    FilterWeights,
    MotorWeights,
    Multipliers,
    Sector,
)
from flexhinf.modal.pair_period import worst_period
from flexhinf.modal.popov import PairStorages
from flexhinf.modal.sampled_pairs import Motors, SampledPairs
from flexhinf.modal.unstable import smallest_unstable
from flexhinf.robot import load_robot
from flexhinf.robot.workspace import workspace_of

PERIOD, ENDS = 1e-3, (100.0**2, 500.0**2)


@pytest.fixture(scope="module")
def pairs():
    return SampledPairs(pair_gains(ENDS, 110.0**2, 12.0, PERIOD), latency=1)


@pytest.fixture(scope="module")
def found(pairs):
    """Tolerance and certificate of symmetric errors of masses."""
    return largest_certificate(pairs, SYMMETRIC, lambda text: None)


#: λ at which springs err too; the whole range takes minutes.
SOME = (200.0**2, 225.0**2)


@pytest.fixture(scope="module")
def sprung(pairs):
    """The same at some λ, of springs that err by twice as much as masses."""
    some = replace(pairs, gains=replace(pairs.gains, ends=SOME))
    return largest_certificate(some, Errors(Sector(0.5, 0.5), Sector(1.0, 1.0)), lambda text: None)


@pytest.fixture(scope="module")
def falling(pairs):
    """The same at some λ, of masses beside springs that err by a tenth, where gravity has a slope."""
    some = replace(pairs, gains=replace(pairs.gains, ends=SOME))
    beside = Errors(EXACT, Sector(0.1, 0.1), Sector(0.03, 0.03))
    return largest_certificate(some, SYMMETRIC, lambda text: None, beside)


@pytest.fixture(scope="module")
def springy(pairs):
    """The same at some λ, of springs alone, with half of τ by a filter."""
    some = replace(pairs, gains=replace(pairs.gains, ends=SOME))
    tolerance = popov_tolerance(some, Errors(EXACT, Sector(1.0, 1.0)))
    half, vibration, pole = 0.5 * tolerance.multipliers.masses, PERIOD**2 * SOME[0], 0.3
    multipliers = Multipliers(half, filters=(FilterWeights(pole, 0.5 * half * (vibration + pole**2)),))
    size = Sector(*(0.95 * part for part in tolerance.errors.springs))
    storages = PairStorages(some, Errors(EXACT, size), multipliers, 0.0).lifted()
    return tolerance, pair_certificate(storages, lambda done: None)


@pytest.fixture(scope="module")
def filtered():
    """The same of seven links at some λ, by multipliers with a filter, which all of its λ need."""
    _, loop = masses.pairs_of(ROBOTS["seven-link"].robot())
    tolerance = popov_tolerance(loop)
    size = Sector(*(0.95 * part for part in tolerance.errors.masses))
    some = replace(loop, gains=replace(loop.gains, ends=SOME))
    storages = PairStorages(some, Errors(size), tolerance.multipliers, 0.0).lifted()
    return tolerance, pair_certificate(storages, lambda done: None)


@pytest.fixture(scope="module")
def unlike(pairs):
    """The same at some λ, of masses alone, with motors that differ by a tenth and in their friction."""
    of_motors = MotorWeights(
        (0.77, 0.0, 0.024, -0.059, 0.0026, 0.0143), (0.0033, -0.0016, -0.0044), (40.0, 18.0, 0.11), 9e-4
    )
    loop = replace(pairs, gains=replace(pairs.gains, ends=SOME), motors=Motors(0.1, 0.1, 0.6, 0.6))
    storages = PairStorages(loop, Errors(Sector(0.2, 0.2)), Multipliers(0.8, motors=of_motors), 0.0).lifted()
    return of_motors, pair_certificate(storages, lambda done: None)


@pytest.mark.ci("searches and checks two proofs, which all tests here read")
def test_all_pairs_are_proved_to_tolerate_nearly_what_is_computed(found, sprung, falling, filtered, springy):
    assert filtered[0].multipliers.filters
    for (tolerance, numbers), size, (low, high) in (
        (found, 0.5, ENDS),
        (sprung, 0.2, SOME),
        (falling, 0.3, SOME),
        (filtered, 0.5, SOME),
        (springy, 0.5, SOME),
    ):
        assert size < (tolerance.errors.masses.lower or tolerance.errors.springs.lower) < 1.0
        checked = check_pairs(pair_claim(json.loads(json.dumps(numbers))))
        assert isinstance(checked, CheckedPairs)
        assert checked.low <= low < high <= checked.high
        assert checked.lower >= 0.89 * tolerance.errors.masses.lower
        assert checked.softer >= 0.89 * tolerance.errors.springs.lower
        assert checked.falling == tolerance.errors.slope.lower


@pytest.mark.oracle
@pytest.mark.parametrize(
    (
        "springs",
        "slope",
        "damping",
        "any_motion",
        "filters",
    ),  # with masses but where springs alone have errors
    [
        (EXACT, EXACT, 0.0, False, ()),
        (Sector(0.2, 0.3), EXACT, 0.0, False, ()),
        (EXACT, Sector(0.05, 0.1), 0.002, False, (FilterWeights(0.3, -4.0, 0.6),)),
        (
            Sector(0.2, 0.3),
            Sector(0.1, 0.05),
            0.0,
            False,
            (FilterWeights(0.3, -4.0, 0.6), FilterWeights(0.05, 2.0)),
        ),
        (Sector(0.2, 0.3), Sector(0.1, 0.05), 0.002, True, (FilterWeights(0.3, -4.0, 0.6),)),
        (Sector(0.2, 0.3), None, 0.0, False, (FilterWeights(0.3, -4.0, 0.6), FilterWeights(0.05, 2.0))),
    ],
)
@pytest.mark.parametrize(("latency", "watched"), [(0, None), (2, None), (1, [0, 2]), (1, [2])])
def test_search_and_checker_compute_the_same_game(
    pairs, latency, watched, springs, slope, damping, any_motion, filters
):
    """They share no code: A, Q and W of a pair agree, for a filter with links, and with motors alone."""
    seen = None if watched is None else np.eye(4)[watched]
    table = None if seen is None else np.random.default_rng(1).normal(size=(5, 4 * len(seen)))
    ends = (np.log(ENDS[0]) - 1.0, np.log(ENDS[1]) + 1.0)
    filter: Any = None if seen is None else SimpleNamespace(pair=(seen, table, ends))
    loop, link = SampledPairs(pairs.gains, latency, filter), 150.0**2
    alone = slope is None
    errors = (
        Errors(EXACT, springs) if alone else Errors(Sector(0.3, 0.5), springs, slope, damping, any_motion)
    )
    of_springs = ChannelWeights() if alone else ChannelWeights(0.3, 0.1, 0.5, 0.7)
    predicts = max(errors.slope) > 0.0 and (latency > 0 or watched is not None)
    latency = min(latency, 1) if predicts else latency
    loop = replace(loop, latency=latency)
    of_slope = ChannelWeights(0.2, 0.3, 0.4, 0.1, 0.17 * predicts)
    weights = of_springs, of_slope
    weights = *weights, ChannelWeights(0.0, 0.4, 0.6 if damping else 0.0, 0.2)
    high = (FilterWeights(0.4, 0.23, 0.05),) if predicts and not any_motion else ()
    multipliers = Multipliers(20.0, *weights, filters, prediction_filters=high)
    rate = 0.0 if any_motion else 0.4
    storages = PairStorages(loop, errors, multipliers, rate)
    every = worst_period(loop, link, errors, multipliers, rate)
    n = len(every.a)
    waiting = 4 if predicts else latency + 4 * (seen is not None)
    assert n == 6 + waiting + 2 * len(filters + high) + sum(errors.states(multipliers))
    parts = [{"low": link, "high": 2.0 * link, "storages": [[1.0] * (n * (n + 1) // 2)] * 2}]
    claim = pair_claim(claim_numbers(storages, parts))
    with checker._balls():
        checked = checker._loop(claim, arb(link), arb(0))
        values = [np.array([[float(e) for e in row] for row in part.constant.tolist()]) for part in checked]
    for value, expected in zip(values, every):
        np.testing.assert_allclose(value, expected, atol=1e-9 * np.abs(expected).max())


def mixed_radius(pairs, links, error, springs: Any = 0.0, slope: Any = 0.0, foreseen: Any = 0.0):
    """Spectral radius of pairs λ (n,) with symmetric errors Δ (n, n) of their inverse inertia, E (n, n) of their
    stiffness, and a slope Γ (n, n) of gravity, by SciPy: the law predicts with what the pairs should be, and with
    another slope (n, n)."""
    gains, n, h = pairs.gains, len(links), PERIOD
    kappa, beta, root = gains.motor, gains.damping, np.sqrt(links)

    def moved(inverse, stiffness, fall):
        zero, one = np.zeros((n, n)), np.eye(n)
        pulled, held = inverse @ stiffness, kappa * stiffness
        a = np.block([[zero, one, zero, zero], [-pulled - inverse @ fall, zero, pulled, zero], [zero, zero, zero, one],
                      [held, zero, -held, -beta * one]])  # fmt: skip
        b = np.vstack([zero, zero, zero, kappa * one])
        whole = expm(h * np.block([[a, b], [np.zeros((n, 5 * n))]]))
        return whole[: 4 * n, : 4 * n], whole[: 4 * n, 4 * n :]

    true, entry = moved(
        np.diag(links) + root[:, None] * error * root, np.eye(n) + springs, slope + np.zeros((n, n))
    )
    known, own = moved(np.diag(links), np.eye(n), foreseen + np.zeros((n, n)))
    k, unit = gains(links)[:, :5], np.eye(7 * n)
    x, total, last, waiting = unit[: 4 * n], unit[4 * n : 5 * n], unit[5 * n : 6 * n], unit[6 * n :]
    integral = total + 0.5 * h * (last + x[:n])
    ahead = known @ x + own @ waiting
    force = -(np.hstack([np.diag(column) for column in k.T[:4]]) @ ahead + np.diag(k[:, 4]) @ integral)
    loop = np.vstack([true @ x + entry @ waiting, integral, x[:n], force])
    return np.abs(np.linalg.eigvals(loop)).max()


@pytest.mark.ci("reads two proofs that the other tests share")
@pytest.mark.oracle
def test_proved_errors_that_mix_pairs_never_destabilise_and_larger_ones_do(
    pairs, found, sprung, falling, springy
):
    """By a second route to the loop of mixed pairs, which also confirms what the search of unstable ones says."""
    rng = np.random.default_rng(0)
    for numbers, ends in (
        [(found[1], ENDS)] * 60
        + [(sprung[1], SOME)] * 60
        + [(falling[1], SOME)] * 60
        + [(springy[1], SOME)] * 60
    ):
        links = np.exp(rng.uniform(*np.log(ends), 3))
        masses, springs, slope, foreseen = (
            turn @ np.diag(size * rng.choice([-1.0, 1.0], 3) * rng.choice([1.0, 0.5], 3)) @ turn.T
            for size in (numbers["lower"], numbers["softer"], numbers["falling"], numbers["falling"])
            for turn in (np.linalg.qr(rng.normal(size=(3, 3)))[0],)
        )
        assert mixed_radius(pairs, links, masses, springs, slope, foreseen) < 1.0
        assert mixed_radius(pairs, links, masses, springs, slope, slope) < 1.0
        level = mixed_radius(pairs, links, masses, springs)
        assert pairs.radius(links.tolist(), masses, springs) == pytest.approx(level, abs=1e-7)
    down = np.array([[-1.5]])  # a slope that lets the slowest pair fall
    assert mixed_radius(pairs, np.array([ENDS[0]]), np.zeros((1, 1)), 0.0, down) > 1.0
    soft = smallest_unstable(pairs, mixed=False, count=20, of_springs=True)
    assert soft.size > sprung[1]["softer"]
    for factor in (0.99, 1.01):
        radius = mixed_radius(
            pairs, np.array(soft.links), np.zeros((1, 1)), np.array([[factor * soft.error]])
        )
        assert (radius > 1.0) == (factor > 1.0)
    size = found[1]["lower"]
    unstable = smallest_unstable(pairs, mixed=False, count=20)
    (link,) = unstable.links
    assert size < unstable.size < 1.25 * size
    for factor in (0.99, 1.01):
        radius = mixed_radius(pairs, np.array([link]), np.array([[factor * unstable.error]]))
        assert (radius > 1.0) == (factor > 1.0)


@pytest.mark.ci("climbs from many places")
def test_two_pairs_that_an_error_mixes_may_bear_less_than_one():
    """Seven links: one pair alone bears more; the poles are those of a second route."""
    loop = SampledPairs(ModalLaw.tuned(load_robot("seven-link").problem()).gains, latency=1)
    alone, mixed = (smallest_unstable(loop, mixed) for mixed in (False, True))
    assert mixed.size < 0.98 * alone.size
    cosine, sine = np.cos(2.0 * mixed.turn), np.sin(2.0 * mixed.turn)
    error = mixed.size * np.array([[cosine, sine], [sine, -cosine]])
    assert mixed_radius(loop, np.array(mixed.links), error) == pytest.approx(mixed.radius, abs=1e-6)
    assert mixed_radius(loop, np.array(mixed.links), 0.97 * error) < 1.0 < mixed.radius


def peak(numbers, link, pieces=6):
    """Largest eigenvalue of δ₁δ₂ AᴴA + ½(δ₂ − δ₁)(A + Aᴴ) + τ (R + Rᴴ) + Σ σ ((Fᴴ − F) A + h. c.) over frequencies, of
    the lifted response from d to a and to its rate, in `pieces` of a period, F of a filter. Below 1 the inequality
    holds at λ, springs are exact; or with e and s for d and a, masses are. Of the file alone, by SciPy."""
    h, alone = numbers["period"], numbers["softer"] > 0.0
    root = 1.0 if alone else np.sqrt(link)
    a, b = np.zeros((4, 4)), np.eye(4)[3] * numbers["input"]
    g = np.array([0.0, link, 0.0, -numbers["motor"] if alone else 0.0]) / root
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
    k = np.array(numbers["coefficients"]) @ [*(p / (link + p) for p in numbers["poles"]), 1.0]
    observer, flow = numbers["observer"], state[:, :5]
    n = 7 + 4 * (observer is not None)
    unit = np.eye(n)
    estimate, (total, last, waiting) = unit[:4], unit[n - 3 :]
    position = unit[0]
    if observer is not None:
        seen, ends = np.array(observer["seen"]), observer["range"]
        gain = chebval((2.0 * np.log(link) - sum(ends)) / (ends[1] - ends[0]), np.array(observer["table"]))
        estimate = unit[4:8] + gain.reshape(4, -1) @ seen @ (unit[:4] - unit[4:8])
        position = position if [1.0, 0.0, 0.0, 0.0] in seen.tolist() else estimate[0]
    integral, acting = total + 0.5 * h * (last + position), np.vstack([unit[:4], waiting])
    ahead = flow @ np.vstack([estimate, waiting])
    force, predicted = -(k[:4] @ ahead + k[4] * integral), ahead[: n - 7]
    loop = np.vstack([flow @ acting, predicted, integral, position, force])
    entry = np.vstack([state[:, 5:], np.zeros((n - 4, pieces))])
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 3000))[:, None, None]
    inner = np.linalg.solve(z * np.eye(n) - loop, np.broadcast_to(entry, (len(z), *entry.shape)))
    out, rate = (np.array(rows)[:, :5] @ acting @ inner + np.array(rows)[:, 5:] for rows in (outs, rates))
    lower, upper = (numbers[name] for name in (("softer", "stiffer") if alone else ("lower", "upper")))
    tau = numbers["multiplier"] * h
    half = 0.5 * (upper - lower) * out + tau * rate
    for pole, part, _ in numbers["filters"]:
        kept, added = np.exp(-pole / pieces), (1.0 - np.exp(-pole / pieces)) / pole
        edge, passed = (
            np.zeros((len(z), 1, pieces), dtype=complex),
            np.zeros((len(z), pieces, pieces), complex),
        )
        edge[:, 0] = (added * kept ** np.arange(pieces)[::-1]) / (z[:, 0] - np.exp(-pole))
        for piece in range(pieces):
            after = kept * edge[:, 0]
            after[:, piece] += added
            passed[:, piece] = (edge[:, 0] + after) / 2
            edge[:, 0] = after
        half += part * (passed.conj().transpose(0, 2, 1) - passed) @ out
    total = lower * upper * out.conj().transpose(0, 2, 1) @ out + half + half.conj().transpose(0, 2, 1)
    return np.linalg.eigvalsh(total)[:, -1].max()


@pytest.mark.ci("reads two proofs that the other tests share")
@pytest.mark.oracle
def test_a_second_route_by_frequencies_finds_the_same_tolerance(found, filtered, springy):
    ends = masses.pairs_of(ROBOTS["seven-link"].robot())[1].gains.ends
    for (tolerance, numbers), links in (
        (found, np.geomspace(*ENDS, 12)),
        (filtered, np.geomspace(*ends, 16)),
    ):
        assert max(peak(numbers, link) for link in links) < 1.0
        lower, upper = tolerance.errors.masses
        beyond = {**numbers, "lower": 1.05 * lower, "upper": 1.05 * upper}
        assert max(peak(beyond, link) for link in links) > 1.0
    links = np.geomspace(*SOME, 16)
    assert max(peak(springy[1], link) for link in links) < 1.0
    size = 1.05 * springy[0].errors.springs.lower
    assert max(peak({**springy[1], "softer": size, "stiffer": size}, link) for link in links) > 1.0
    steady = {**numbers, "filters": []}  # one τ for all frequencies covers much less
    assert max(peak(steady, link) for link in np.geomspace(*ends, 16)) > 1.0


@pytest.mark.ci("reads two proofs that the other tests share")
def test_a_sector_larger_than_the_tolerance_is_not_accepted(found, sprung, falling, springy):
    for (tolerance, numbers), kinds, factor in (
        (found, (0, 1), 1.3),
        (sprung, (0, 1), 1.3),
        (sprung, (2, 3), 1.3),
        (falling, (4, 5), 5.0),
        (springy, (2, 3), 1.3),
    ):
        sizes = tolerance.errors.numbers
        larger = {**numbers, **{ERRORS[k]: min(0.99, factor * sizes[k]) for k in kinds}}
        assert isinstance(check_pairs(pair_claim(larger)), int)


@pytest.mark.ci("reads two proofs that the other tests share")
@pytest.mark.parametrize(
    ("name", "end"),
    [("lower", 1.0), ("softer", 1.0), ("period", 0.0), ("input", 0.0), ("rate_weight", 0.0)],
)
def test_numbers_at_the_open_ends_of_their_ranges_are_refused(sprung, name, end):
    with refused_with(InvalidInput, name):
        pair_claim({**sprung[1], name: end})


def forged(numbers, rng):
    """A file that says more than is proved, or of another law or loop than its storages are."""
    file = copy.deepcopy(numbers)
    (one,) = file["intervals"]
    first, *_, last = one["storages"]
    kinds = ["rate", "law", "number", "entry", "sign", "scale", "range", "latency"]
    kinds += ["sector"] * (file["lower"] > 0.0) + ["springs"] * (file["softer"] > 0.0)
    kinds += ["multiplier", "weight"] * (file["rate_weight"] > 0.0)
    kinds += ["slope", "prediction"] * (file["falling"] > 0.0) + ["filter"] * bool(file["filters"])
    motors = file["motors"]
    kinds += ["motors", "motor weight", "fading", "indefinite"] * bool(motors)
    kind = str(rng.choice(kinds))
    factor = float(rng.choice([0.2, 0.4, 3.0, 10.0, 1e200]))
    if kind == "sector":  # beside unlike motors more is true
        least = 4.0 if motors else 1.3
        file["lower"] = min(0.999, least * file["lower"])
        file["upper"] = rng.uniform(least, 9.0) * file["upper"]
    elif kind == "motors":
        name = str(rng.choice(["slower", "faster", "less_friction", "more_friction"]))
        motors[name] *= float(rng.uniform(3.0, 9.0)) * (100.0 if "friction" in name else 1.0)
    elif kind == "motor weight":
        name = str(rng.choice(["weights", "friction_weights", "skew"]))
        size = float(rng.uniform(1e3, 1e4) if name == "skew" else rng.uniform(1e-4, 1e-2))
        motors[name] = [size * x for x in motors[name]]
    elif kind == "fading":
        file["coefficients"][5] = [float(rng.choice([-1.0, 0.0, 0.5])) * x for x in file["coefficients"][5]]
    elif kind == "indefinite":
        motors["weights"][1] = float(rng.uniform(0.2, 9.0))
    elif (
        kind == "springs"
    ):  # beside masses and a slope three times as much is true: `popov_tolerance` finds it
        least = 6.0 if file["falling"] else 1.4
        file["softer"], file["stiffer"] = (
            min(0.999, least * file["softer"]),
            rng.uniform(least, 9.0) * file["stiffer"],
        )
    elif kind == "slope":
        file["falling"], file["holding_up"] = rng.uniform(5.0, 20.0, 2) * file["falling"]
    elif kind == "prediction":
        weight = [file["prediction_weight"], *file["prediction_filters"][0][:2]]
        place = int(rng.integers(3))
        weight[place] *= float(rng.choice([1e-7, 1e5]))
        file["prediction_weight"], file["prediction_filters"][0][:2] = weight[0], weight[1:]
    elif kind == "filter":
        place = int(rng.integers(3))
        file["filters"][0][place] *= (30.0, -1.0, -9.0)[place] * min(1.0, factor)
    elif kind == "multiplier":
        file[str(rng.choice(["spring_multiplier", "lift"]))] *= -float(rng.uniform(20.0, 1e3))
    elif kind == "weight":
        file[str(rng.choice(["twist_weight", "rate_weight"]))] *= float(rng.choice([1e-3, 1e2, 1e4]))
    elif kind == "rate":
        file["rate"] = float(rng.uniform(20.0, 1e3))
    elif kind == "law":
        row = int(rng.choice([0, 2, 3]))
        file["coefficients"][row] = [-x for x in file["coefficients"][row]]
    elif kind == "number":
        name = str(rng.choice(["motor", "input", "period", "multiplier"]))
        for one in ("motor", "input") if motors and name in ("motor", "input") else (name,):
            file[one] *= factor
    elif kind == "entry":
        first[int(rng.integers(len(first)))] += float(rng.choice([-1.0, 1.0])) * 10.0 * max(map(abs, first))
    elif kind == "sign":
        last[:] = [-x for x in last]
    elif kind == "scale":
        last[:] = [float(rng.uniform(2.0, 5.0)) * x for x in last]
    elif kind == "range":
        one["high"] = float(rng.uniform(4.0, 40.0)) * one["low"]
    else:
        file["latency"] = int(rng.choice([0, 2, 3]))
    return kind, file


def damaged(numbers, rng):
    """A file with a key that is missing, or of another kind."""
    whole = copy.deepcopy(numbers)
    file = whole["motors"] if whole["motors"] and rng.random() < 0.5 else whole
    name = str(rng.choice(sorted(set(file) - {"observer"})))
    wrong = [None, "text", [], {}, True, float("nan"), float("inf"), "1", [[1.0], [2.0, 3.0]]]
    file[name] = wrong[int(rng.integers(len(wrong)))]
    if rng.random() < 0.2 or (name, file[name]) in (
        ("filters", []),
        ("prediction_filters", []),
        ("error_filters", []),
        ("any_motion", True),
        ("motors", None),
    ):  # all are allowed
        del file[name]
    return whole


#: Kinds of forgeries of each certificate.
FORGED = {"found": 9, "sprung": 12, "falling": 14, "filtered": 10, "springy": 10, "unlike": 13}


@pytest.mark.parametrize(
    ("of", "count", "tried"),
    ci_and_night(
        "checks hundreds of files",
        [(of, count, 60) for of, count in FORGED.items()],
        [(of, count, 200) for of, count in FORGED.items()],
    ),
)
def test_none_of_hundreds_of_forged_and_damaged_files_is_accepted(of, count, tried, request):
    numbers = request.getfixturevalue(of)[1]
    rng, kept = np.random.default_rng(3), {**numbers, "intervals": numbers["intervals"][:1]}
    assert isinstance(check_pairs(pair_claim(kept)), CheckedPairs)
    if of == "sprung":  # storages of a loop whose springs err are of another size than those of exact ones
        for exact in ({"softer": 0.0, "stiffer": 0.0}, {"rate_weight": 0.0}):
            with pytest.raises(InvalidInput, match="certificate"):
                pair_claim({**kept, **exact})
    if of == "springy":  # what has no error in it must have none
        (one,) = kept["intervals"]
        n = int(np.sqrt(2 * len(one["storages"][0])))
        both = {"holding_up": "slope_rate_weight", "spring_damping": "damping_rate_weight"}
        for name in ("upper", *both):  # beside which e is a state, as what has the other weight
            more = [0.0] * n + [1.0] + ([0.0] * (n + 1) + [1.0]) * (name in both)
            wider = [{**one, "storages": [p + more for p in one["storages"]]}]
            with refused_with(InvalidInput, " rate_weight"):
                pair_claim({**kept, name: 1e-4, both.get(name, "rate"): 1e-6, "intervals": wider})
    kinds = set()
    for _ in range(tried):
        kind, file = forged(kept, rng)
        kinds.add(kind)
        if kind in ("latency", "indefinite"):
            with pytest.raises(InvalidInput, match="certificate"):
                pair_claim(file)
        else:
            assert isinstance(check_pairs(pair_claim(file)), int), kind
    assert len(kinds) == count
    for _ in range(tried):
        file = damaged(kept, rng)
        with pytest.raises(InvalidInput, match="certificate"):
            pair_claim(file)


@pytest.mark.ci("many loops of pairs")
def test_a_payload_alone_leaves_a_larger_sector(pairs):
    """Links that are only heavier may be so by more than links that may also be lighter."""
    both, heavier = (
        popov_tolerance(pairs, Errors(shape), 8).errors.masses
        for shape in (Sector(1.0, 1.0), Sector(1.0, 0.0))
    )
    assert heavier.lower >= 0.99 * both.lower
    assert heavier.upper == 0.0


@pytest.mark.ci("one more search")
def test_symmetric_errors_may_be_larger_than_any(pairs, found):
    """Small gain is the case without a multiplier, and bears errors that lag."""
    small = small_gain_tolerance(pairs, count=10).masses.lower
    assert 0.01 < small < 0.5 * found[0].errors.masses.lower


@pytest.mark.oracle
@pytest.mark.ci("proves the laws of two robots")
@pytest.mark.parametrize(
    ("name", "watched", "kind"),
    [("scara", False, "masses"), ("planar-two-link", True, "masses"), ("paper", False, "springs")],
)
def test_certificates_of_robots_hold_by_a_second_route(name, watched, kind):
    """By frequencies, of the numbers in the file alone; without an estimator the row of the docs is what is proved."""
    robot = ROBOTS[name].robot()
    law, loop = masses.pairs_of(robot)
    if watched:
        loop = sampled_pairs(WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0]))
    shape, sides = (SYMMETRIC, ("lower", "upper"))
    if kind == "springs":
        shape, sides = Errors(EXACT, Sector(1.0, 1.0)), ("softer", "stiffer")
    tolerance, numbers = largest_certificate(loop, shape, lambda text: None)
    assert numbers is not None
    assert (numbers["observer"] is not None) == watched
    numbers = json.loads(json.dumps(numbers))
    links = np.geomspace(*loop.gains.ends, 12)
    assert max(peak(numbers, link) for link in links) < 1.0
    size = 1.05 * tolerance.share
    assert max(peak({**numbers, **dict.fromkeys(sides, size)}, link) for link in links) > 1.0
    if not watched:
        row = kept(ROWS, f"{name}.{kind}")
        assert row is not None
        assert [row["grid"], row["proved"]] == pytest.approx([tolerance.share, numbers[sides[0]]], rel=0.02)
