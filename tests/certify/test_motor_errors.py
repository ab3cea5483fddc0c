"""What the checker says of unlike motors: the game of the search and that of small steps; guards of the file."""

import copy
from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flint import arb
from scipy.linalg import block_diag, expm
from tests.certify.test_pair_game import valued
from tests.refusals import refused_with

from flexhinf.certify.checker import moves, pairs as checker
from flexhinf.certify.checker.pair_claim import PairClaim, pair_claim
from flexhinf.certify.checker.pair_flow import PairForms
from flexhinf.certify.checker.taylor_matrix import TaylorMatrix
from flexhinf.certify.checker.worst_forms import WorstForms, add
from flexhinf.designs.workspace.pair_proof import Numbers, claim_numbers
from flexhinf.errors import InvalidInput
from flexhinf.modal import pair_gains
from flexhinf.modal.pair_errors import (
    EXACT,
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

PERIOD, ENDS, LINK = 1e-3, (100.0**2, 500.0**2), 150.0**2

#: Motors with and without unlike friction.
UNLIKE, SAME_FRICTION = Motors(0.2, 0.3, 1.5, 2.0), Motors(0.2, 0.3)

FILTERS = FilterWeights(0.3, -0.04, 0.6), FilterWeights(0.5, 0.03, 0.2)


def game(
    loop: SampledPairs, springs: Sector, slope: Sector = EXACT, damping: float = 0.0, filters: bool = True
) -> PairStorages:
    """A loop with errors of all kinds, and weights that are all different."""
    of_motors = MotorWeights(
        (0.8, -0.2, 0.7, 0.1, 0.05, 1.2),
        (-0.11, 0.07, -0.13),
        (200.0, 300.0, 1.3),
        0.15,
        FILTERS[:1] if filters else (),
        FILTERS if filters else (),
    )
    foreseen = slope != EXACT and loop.predicts
    weights = ChannelWeights(0.3, 0.1, 50.0, 0.7), ChannelWeights(0.2, 0.3, 0.4, 0.1, 0.17 * foreseen)
    damped = ChannelWeights(0.0, 0.4, 15.0 if damping else 0.0, 0.2)
    high = (FilterWeights(0.4, 0.23, 0.05),) * foreseen
    multipliers = Multipliers(20.0, *weights, damped, FILTERS[:1] if filters else (), of_motors, high)
    return PairStorages(loop, Errors(Sector(0.3, 0.5), springs, slope, damping), multipliers, 0.4)


def numbers_of(storages: PairStorages) -> Numbers:
    """A file of a game, with storages of no meaning."""
    n = len(worst_period(storages.pairs, LINK, storages.errors, storages.multipliers, storages.rate).a)
    parts = [{"low": LINK, "high": 2.0 * LINK, "storages": [[1.0] * (n * (n + 1) // 2)] * 2}]
    return claim_numbers(storages, parts)


def played(claim: PairClaim) -> list[np.ndarray]:
    """A, Q and W of the checker at one λ."""
    with checker._balls():
        return [valued(part, 0.0, 0.0) for part in checker._loop(claim, arb(LINK), arb(0))]


@pytest.fixture(scope="module")
def loop() -> SampledPairs:
    return SampledPairs(pair_gains(ENDS, 110.0**2, 12.0, PERIOD), 1, motors=UNLIKE)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("springs", "slope", "damping", "filters"),
    [
        (EXACT, EXACT, 0.0, False),
        (EXACT, Sector(0.05, 0.1), 0.002, True),
        (Sector(0.2, 0.3), EXACT, 0.002, True),
        (Sector(0.2, 0.3), Sector(0.1, 0.05), 0.0, False),
    ],
)
@pytest.mark.parametrize("motors", [UNLIKE, SAME_FRICTION])
@pytest.mark.parametrize(("latency", "watched"), [(0, None), (0, [0, 2]), (1, None), (1, [2])])
def test_search_and_checker_compute_the_same_game_of_unlike_motors(
    loop, latency, watched, motors, springs, slope, damping, filters
):
    """They share no code: A, Q and W of a pair agree, with a rate."""
    filter: Any = None
    if watched is not None:
        seen = np.eye(4)[watched]
        table = np.random.default_rng(1).normal(size=(5, 4 * len(seen)))
        filter = SimpleNamespace(pair=(seen, table, (np.log(ENDS[0]) - 1.0, np.log(ENDS[1]) + 1.0)))
    own = replace(loop, latency=latency, filter=filter, motors=motors)
    one = game(own, springs, slope, damping, filters)
    expected = worst_period(own, LINK, one.errors, one.multipliers, one.rate)
    for value, known in zip(played(pair_claim(numbers_of(one))), expected):
        np.testing.assert_allclose(value, known, atol=1e-11 * np.abs(known).max())


#: (z, z′, w, w′) of (z, z′, s, s′).
TO_PLAIN = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 1, 0], [0, 1, 0, 1]])

#: States of a period in coordinates of the test, what a sample chooses, what it holds, and errors.
MOVED = ["z", "dz", "w", "dw", "hz", "hdz", "hw", "hdw", "a0", "d0", "x0", "n0", "y0", "m0", "y1", "m1", "e"]
CHOSEN, SAMPLED, INPUTS = ["n", "p"], ["s0", "w0", "f"], ["d", "v", "m", "me", "p rate", "pe"]
STATES = [*MOVED, *CHOSEN, *SAMPLED]


def rates_and_gains(claim: PairClaim) -> tuple[np.ndarray, np.ndarray]:
    """Rates of all states and errors, these constant, and what errors gain, of masses, springs and motors; in periods,
    with the motors' positions and speeds."""
    h, own, kappa, pull = claim.period, claim.motors, claim.motor * claim.period**2, LINK * claim.period**2
    assert own is not None
    names = [*STATES, *INPUTS]
    at, root = dict(zip(names, np.eye(len(names)))), np.sqrt(pull)
    rate, products = {name: np.zeros(len(names)) for name in names}, []
    left = 1.0 - claim.coefficients[5] @ [*(p / (LINK + p) for p in claim.poles), 1.0]
    s, model = at["w"] - at["z"], at["hw"] - at["hz"]
    x = s + at["e"]
    pushed = claim.input * h**2 * at["f"] - kappa * (at["m"] + left * at["n"]) - at["p rate"] - left * at["p"]
    for one in ("z", "w", "hz", "hw"):
        rate[one] = at[one.replace("z", "dz").replace("w", "dw")]
    rate["dz"], rate["hdz"] = pull * x + root * at["d"], pull * model
    rate["dw"] = pushed - kappa * (x + at["me"]) - claim.damping * h * at["dw"] - at["pe"]
    rate["hdw"] = pushed - kappa * model - claim.damping * h * at["hdw"]
    turned = rate["dw"] - rate["dz"]  # of s′
    for one in (*MOVED[:8], *CHOSEN, *SAMPLED):
        rate[one] = rate[one] + claim.rate * h * at[one]
    rate["e"], r = at["v"], rate["w"] - rate["z"]
    whole, unknown = at["m"] + at["me"] + at["n"], x - model

    def sector(weight: float, y: np.ndarray, u: np.ndarray, low: float, high: float) -> None:
        products.append((weight * (y + low * u), high * u - y))

    def alike(weight: float, first: tuple[np.ndarray, ...], second: tuple[np.ndarray, ...]) -> None:
        """Of two signals and what a symmetric matrix makes of them."""
        products.append((2.0 * weight * first[0], second[1]))
        products.append((-2.0 * weight * second[0], first[1]))

    sector(1.0, at["d"], root * x, claim.lower, claim.upper)
    sector(claim.twist_weight, at["e"], s, claim.softer, claim.stiffer)
    sector(claim.rate_weight, at["v"], r, claim.softer, claim.stiffer)
    for weight, left_one, right_one in (
        (claim.multiplier * root, at["d"], r + at["v"]),
        (claim.multiplier, at["v"], turned + claim.rate * h * (at["dw"] - at["dz"] + r)),
        (claim.spring_multiplier, at["e"], r),
        (-claim.lift, at["e"], at["v"]),
        (own.multiplier, whole, r + at["v"]),
    ):
        products.append((2.0 * weight * left_one, right_one))
    filters = [("a0", "d0", root * x, at["d"], claim.filters[0]), ("x0", "n0", x, whole, own.filters[0])]
    filters += [(f"y{k}", f"m{k}", unknown, at["me"], one) for k, one in enumerate(own.error_filters)]
    for seen, answered, signal, answer, (pole, weight, lift) in filters:
        rate[seen], rate[answered] = signal - pole * at[seen], answer - pole * at[answered]
        alike(weight, (at[answered], at[seen]), (answer, signal))
        products.append((-2.0 * lift * at[answered], rate[answered]))
    parts = [(at["m"], model - at["s0"]), (at["me"], unknown), (at["n"], at["s0"])]
    for (i, first), (j, second) in product(enumerate(parts), repeat=2):
        alike(own.skew[i, j], first, second)
        up, down = first[0] + own.slower * first[1], own.faster * second[1] - second[0]
        products.append((own.weights[i, j] * up, down))
    speeds = (at["p rate"], at["hdw"] - at["w0"]), (at["pe"], at["dw"] - at["hdw"]), (at["p"], at["w0"])
    for weight, (y, u) in zip(own.friction_weights, speeds):
        sector(weight, y, u, own.less_friction * h, own.more_friction * h)
    zero = np.zeros((len(names), len(names)))
    gained = 0.5 * sum((np.outer(one, other) + np.outer(other, one) for one, other in products), zero)
    return np.array([rate[name] for name in names]), gained


def best(form: np.ndarray, n: int) -> np.ndarray:
    """The most of a form over all but its first n variables."""
    weight = -form[n:, n:]
    assert np.linalg.eigvalsh(weight)[0] > 0.0
    return form[:n, :n] + form[:n, n:] @ np.linalg.solve(weight, form[n:, :n])


def stepped(claim: PairClaim, end: np.ndarray, steps: int = 300) -> np.ndarray:
    """The most that errors, constant in each step of a period, gain with a form of `MOVED` at its end, by `STATES`."""
    rates, gained = rates_and_gains(claim)
    size, n = len(rates), len(STATES)
    doubled = expm(np.block([[-rates.T, gained], [np.zeros_like(rates), rates]]) / steps)
    moved, beside, value = doubled[size:, size:], doubled[:size, size:], np.zeros((n, n))
    value[: len(end), : len(end)] = end
    for _ in range(steps):
        value = best(moved[:n].T @ value @ moved[:n] + moved.T @ beside, n)
    return value


def begun(claim: PairClaim, latency: int) -> np.ndarray:
    """`STATES` at a sample by the states of a loop without a filter, and by what is chosen."""
    h, n = claim.period, claim.states
    unit = np.eye(n + 2)
    gains = claim.coefficients[:5] @ [*(p / (LINK + p) for p in claim.poles), 1.0]
    state, used = TO_PLAIN @ unit[:4], TO_PLAIN @ unit[4 * latency : 4 * latency + 4]
    total, last = unit[4 * latency + 4 : 4 * latency + 6]
    integral = total if latency else total + 0.5 * (last + unit[0])
    force = -(gains[:4] / [1.0, h, 1.0, h]) @ used - gains[4] * h * integral
    size = np.sqrt(LINK) * h
    added = unit[n - claim.added : n] * np.r_[size, 1.0 / size, np.ones(claim.added - 2)][:, None]
    sampled = used[2] - used[0], used[3], force
    return np.vstack([state, state, added, unit[n:], sampled])


@pytest.mark.oracle
@pytest.mark.parametrize("latency", [0, 1])
def test_unlike_motors_do_within_a_period_what_they_do_in_small_steps(loop, latency):
    """With filters of all kinds, unlike friction, springs and a rate, without the storages S."""
    own = replace(loop, latency=latency)
    claim = pair_claim(numbers_of(game(own, Sector(0.2, 0.3))))
    a, q, w = played(claim)
    n, rng = claim.states, np.random.default_rng(7)
    kept, count, size = (
        [*range(4 + 4 * latency), *range(n - claim.added, n)],
        claim.added,
        np.sqrt(LINK) * PERIOD,
    )
    twist = np.linalg.inv(TO_PLAIN)
    back = np.asarray(block_diag(twist, twist, np.diag(np.r_[1.0 / size, size, np.ones(count - 2)])))
    back = back if latency else np.delete(back, range(4, 8), axis=0)
    root = rng.normal(size=(len(kept), len(kept)))
    for sign in (-1.0, 1.0):
        end = sign * 0.02 * root @ root.T
        at_end = end @ np.linalg.inv(np.eye(len(kept)) - w[np.ix_(kept, kept)] @ end)
        start = begun(claim, latency)
        value = best(start.T @ stepped(claim, back.T @ end @ back) @ start, n)
        expected = q + a[kept].T @ at_end @ a[kept]
        print(
            sign,
            np.abs(value - expected).max() / np.abs(expected).max(),
            np.abs(expected - q).max() / np.abs(q).max(),
        )
        np.testing.assert_allclose(value, expected, atol=1e-6 * np.abs(expected).max())


@pytest.fixture(scope="module")
def numbers(loop) -> Numbers:
    return numbers_of(game(loop, Sector(0.2, 0.3)))


def changed(numbers: Numbers, **others: Any) -> Numbers:
    """A file with other numbers; those of motors too."""
    motors = {name: others.pop(name) for name in [*others] if name in numbers["motors"]}
    return {**numbers, **others, "motors": {**numbers["motors"], **motors}}


@pytest.mark.parametrize(
    "others",
    [
        {"slower": 1.0},
        {"slower": -1e-9},
        {"faster": -1e-9},
        {"less_friction": -1e-9},
        {"more_friction": -1e-9},
        {"friction_weights": [1.0, -1e-9, 1.0]},
        {"filters": [[0.0, 0.1, 0.1]]},
        {"error_filters": [[0.3, 0.1, 0.1], [-0.1, 0.1, 0.1]]},
        {"weights": [0.0, 0.0, -1e-300, 0.0, 0.0, 0.0]},  # larger minors are 0
        {"weights": [1.0, 1.0, 1.0 - 2.0**-53, 0.0, 0.0, 0.0]},  # one of two is negative by one rounding
        {"weights": [0.0, 0.0, 1.0, 0.0, 1.0, 1.0 - 2.0**-53]},
        {"weights": [1.0, -0.75, 1.0, -0.75, -0.75, 1.0]},  # all minors of two are positive
    ],
)
def test_numbers_of_unlike_motors_outside_their_ranges_are_refused(numbers, others):
    with refused_with(InvalidInput, " motors"):
        pair_claim(changed(numbers, **others))


@pytest.mark.parametrize(
    "weights", [[1.0, 1.0, 1.0, 1.0, 1.0, 1.0], [0.0] * 6, [1.0, 0.0, 1.0, 0.75, 0.625, 1.0]]
)
def test_weights_at_the_end_of_their_range_are_read(numbers, weights):
    claim = pair_claim(changed(numbers, weights=weights))
    assert claim.motors is not None
    assert claim.motors.weights[np.tril_indices(3)].tolist() == weights


@pytest.mark.parametrize(
    ("others", "name"),
    [
        ({"delay": 0.5}, "unknown delay"),
        ({"any_motion": True, "rate": 0.0}, "any size"),
        ({"latency": 2}, "latency"),
        ({"holding": 1.0}, "inner loop"),
        ({"input": 1.0}, "inner loop"),
        ({"rate_weight": 0.0}, " rate_weight"),
        ({"rate_weight": 0.0, "lower": 0.0, "upper": 0.0}, " rate_weight"),  # springs alone as an input
    ],
)
def test_what_the_proof_of_unlike_motors_does_not_treat_is_refused(numbers, others, name):
    parts = [{**numbers["intervals"][0], "delays": [0.0, 0.5]}]
    with refused_with(InvalidInput, name):
        pair_claim(changed(numbers, intervals=parts, **others))


@pytest.mark.parametrize(
    "others",
    [{"motors": None}, {"skew": [0.0] * 6}, {"weights": [1.0] * 9}, {"slower": True}, {"slower": [0.1]}],
)
def test_files_of_unlike_motors_with_other_shapes_are_refused(numbers, others):
    """Without motors a law has five rows, and with motors six."""
    with refused_with(InvalidInput, "certificate"):
        pair_claim({**numbers, **others} if "motors" in others else changed(numbers, **others))
    rows = {"coefficients": numbers["coefficients"][:5]}
    with refused_with(InvalidInput, "another shape"):
        pair_claim(changed(numbers, **rows))


def test_inputs_without_a_positive_weight_are_not_completed_to_squares(numbers):
    """Π ≥ 0 alone is not enough, nor is a weight that is positive without the product with the rate of springs."""
    for others in (
        {},
        {"weights": [0.8, 0.0, 0.0, 0.0, 0.0, 1.2]},
        {"multiplier": 40.0},
        {"multiplier": -40.0},
    ):
        claim = pair_claim(changed(numbers, **copy.deepcopy(others)))
        with checker._balls():
            if others:
                with pytest.raises(ZeroDivisionError):
                    PairForms(claim).completed()
            else:
                PairForms(claim).completed()
        if others:
            assert not checker.regular_at_first(claim)


def test_a_ball_about_zero_is_kept_in_a_form():
    """It is not certain to be 0, and to leave it out would make an enclosure too narrow."""
    form, left, right = (np.full(size, arb(0), dtype=object) for size in ((2, 2), 2, 2))
    left[0], right[1] = arb(0, 1), arb(1)
    add(form, left, right)
    assert [entry.contains(1) for entry in form.ravel().tolist()] == [False, True, False, False]


def test_factors_of_inputs_that_are_not_completed_to_squares_are_refused():
    """They would be left out, and less would be gained than errors can."""
    for name, place, first, second in (
        ("gained", 1, "v", "v"),
        ("gained", 2, "v", "z"),
        ("moved", 2, "z", "v"),
        ("moved", 0, "v", "z"),
        ("shift", 0, "v", "v"),
    ):
        forms = WorstForms(["z"], ["v"], ["none"])
        add(forms.gained[0], arb(-1) * forms["v"], forms["v"])
        assert forms.completed().moved[0].nrows() == 1
        add(getattr(forms, name)[place], forms[first], forms[second])
        with pytest.raises(ValueError, match="other factors"):
            forms.completed()
    assert not forms["none"].any()
    with pytest.raises(KeyError):
        forms["nothing"]


def test_what_is_chosen_at_a_sample_must_not_gain_without_bound():
    """−gᵀQg is regular where it is negative too."""
    unit = TaylorMatrix.of([[1, 0], [0, 1]])
    chosen = TaylorMatrix.of([[1], [0]])
    found = checker._with_chosen(checker._WorstPeriod(unit, -unit, unit), chosen)
    np.testing.assert_allclose(valued(found.w, 0.0, 0.0), [[2.0, 0.0], [0.0, 1.0]], atol=1e-12)
    np.testing.assert_allclose(valued(found.q, 0.0, 0.0), [[0.0, 0.0], [0.0, -1.0]], atol=1e-12)
    with pytest.raises(ZeroDivisionError):
        checker._with_chosen(checker._WorstPeriod(unit, unit, unit), chosen)


@pytest.mark.ci("halves a period many times")
def test_unlike_motors_that_gain_without_bound_within_a_period_are_refused(loop):
    """Beyond the instant at which W is infinite it has eigenvalues below 0, and is regular again."""
    kinds = set()
    for faster in (0.3, 30.0, 300.0, 1000.0):
        own = game(replace(loop, motors=Motors(0.2, faster, 1.5, 2.0)), EXACT, filters=False)
        w = worst_period(own.pairs, LINK, own.errors, own.multipliers, own.rate).w
        bounded = bool(np.linalg.eigvalsh(w)[0] > -1e-9 * np.abs(w).max())
        kinds.add(bounded)
        assert checker.regular_at_first(pair_claim(numbers_of(own))) == bounded
    assert kinds == {True, False}


def test_moves_are_of_the_loop_with_motors_alike(loop, numbers):
    """What a file says of unlike motors does not change it, and is not covered."""
    alike = replace(loop, motors=None)
    of_masses = PairStorages(alike, Errors(Sector(0.1, 0.1)), Multipliers(1.0), 0.0)
    with checker._balls():
        own, other = (
            valued(moves._loop(pair_claim(one), arb(LINK), arb(0)), 0.0, 0.0)
            for one in (numbers, numbers_of(of_masses))
        )
    np.testing.assert_array_equal(own, other)
