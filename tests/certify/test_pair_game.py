"""What the checker says that errors do within a period is what they do in small steps, without the storages S."""

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm

from flexhinf.certify.checker import pairs as checker
from flexhinf.certify.checker.pair_claim import PairClaim, pair_claim
from flexhinf.certify.checker.pair_flow import free_flow
from flexhinf.certify.checker.taylor_matrix import TaylorMatrix
from flexhinf.designs.workspace.pair_proof import claim_numbers
from flexhinf.modal import pair_gains
from flexhinf.modal.pair_errors import EXACT, Errors, FilterWeights, Multipliers, Sector
from flexhinf.modal.pair_period import worst_period
from flexhinf.modal.popov import PairStorages
from flexhinf.modal.sampled_pairs import SampledPairs

#: A box of λ and of θ, the unknown delay, and how large errors are.
LINKS, DELAYS, DELAY, SECTOR = (150.0**2, 170.0**2), (0.3, 0.6), 0.8, Sector(0.3, 0.5)


def valued(matrix: TaylorMatrix, u: float, v: float) -> np.ndarray:
    """The polynomial at a place of the box."""
    parts = [
        u**k * v**l * np.array([[float(entry) for entry in row] for row in part.tolist()])
        for (k, l), part in matrix.terms.items()
    ]
    return sum(parts[1:], parts[0])


def stepped(claim: PairClaim, link: float, late: float, end: np.ndarray, steps: int = 100) -> np.ndarray:
    """The most that errors, constant in each step of a period, gain with a form of the states at its end.

    A form of (z, z′, w, w′), of the input of the period before, of the new one, and of a_f and d_f of each filter, all
    times exp(αt), in periods.
    """
    h, alone, n = claim.period, claim.softer > 0.0, 6 + 2 * len(claim.filters)
    pull, unit = link * h**2, np.eye(n + 1)
    root, (lower, upper) = (
        (1.0, (claim.softer, claim.stiffer)) if alone else (np.sqrt(pull), (claim.lower, claim.upper))
    )
    error, twist, flow = unit[n], unit[2] - unit[0], np.zeros((n + 1, n + 1))
    flow[[0, 2]] = unit[[1, 3]]
    flow[1] = pull * twist + (pull if alone else root) * error
    flow[3] = -claim.motor * h**2 * (twist + alone * error) - claim.damping * h * unit[3]
    flow[3] -= claim.holding * h**2 * unit[2]
    flow[:6] += claim.rate * h * unit[:6]
    signal, rate = root * twist, root * (flow[2] - flow[0])
    products = [(error + lower * signal, upper * signal - error), (2.0 * claim.multiplier * error, rate)]
    for k, (pole, multiplier, lift) in enumerate(claim.filters.tolist()):
        seen, answer = unit[6 + 2 * k], unit[7 + 2 * k]
        flow[6 + 2 * k], flow[7 + 2 * k] = signal - pole * seen, error - pole * answer
        products += [(2.0 * multiplier * answer, signal), (-2.0 * multiplier * error, seen)]
        products.append((-2.0 * lift * answer, flow[7 + 2 * k]))
    gained = 0.5 * sum((np.outer(x, y) + np.outer(y, x) for x, y in products), np.zeros_like(flow))
    value = end
    for acting, duration in ((5, 1.0 - late), (4, late)):
        driven = flow.copy()
        driven[3, acting] += claim.input * h**2
        zero = np.zeros_like(driven)
        whole = expm(duration / steps * np.block([[-driven.T, gained], [zero, driven]]))
        moved, beside = whole[n + 1 :, n + 1 :], whole[: n + 1, n + 1 :]
        for _ in range(steps):
            one = moved[:n].T @ value @ moved[:n] + moved.T @ beside
            assert one[n, n] < 0.0
            value = one[:n, :n] - np.outer(one[:n, n], one[n, :n]) / one[n, n]
    return value


@pytest.mark.oracle
@pytest.mark.parametrize("motor", [110.0**2, 0.0])
@pytest.mark.parametrize("errors", [Errors(SECTOR), Errors(EXACT, SECTOR)])
def test_errors_do_within_a_period_what_they_do_in_small_steps(errors: Errors, motor: float) -> None:
    """Of masses, and of springs alone, at places of a box, with filters, a rate and an unknown delay."""
    loop = SampledPairs(pair_gains(LINKS, 110.0**2, 12.0, 1e-3), 1, None, DELAY)
    multipliers = Multipliers(7.0, filters=(FilterWeights(0.3, -0.4, 0.6), FilterWeights(0.05, 0.2, -0.1)))
    one = {
        "low": LINKS[0],
        "high": LINKS[1],
        "delays": [0.0, DELAY],
        "storages": [[[1.0] * 78] * 2] * 2,
    }
    numbers = claim_numbers(PairStorages(loop, errors, multipliers, 40.0), [one])
    claim = pair_claim({**numbers, "motor": motor, "holding": 300.0})
    (low, high), (begin, last), n = map(arb, LINKS), map(arb, DELAYS), claim.states
    with checker._balls():
        worst = checker._loop(
            claim, (low + high) / 2, (high - low) / 2, ((begin + last) / 2, (last - begin) / 2)
        )
    rng, own = np.random.default_rng(7), [*range(4), *range(n - 4, n)]
    for u, v in ((-1.0, 1.0), *rng.uniform(-1.0, 1.0, (2, 2))):
        link, late = np.mean(LINKS) + 0.5 * np.ptp(LINKS) * u, np.mean(DELAYS) + 0.5 * np.ptp(DELAYS) * v
        a, q, w = (valued(part, u, v) for part in worst)
        root = rng.normal(size=(8, 8))
        end = 0.002 * root @ root.T * rng.choice([-1.0, 1.0])
        expected = q + a[own].T @ end @ np.linalg.inv(np.eye(8) - w[np.ix_(own, own)] @ end) @ a[own]
        with checker._balls():
            acting, _ = checker.sampled(claim, arb(link), arb(0), free_flow(claim, arb(link), arb(0)))
        # The checker has s for w, and of masses a_f/√λ and √λ d_f.
        size = 1.0 if claim.springs_alone else np.sqrt(link) * claim.period
        whole, kept = np.eye(10), np.delete(np.eye(10), [4, 5], axis=0)
        whole[[2, 3], [0, 1]] = 1.0
        whole[range(6, 10), range(6, 10)] = [size, 1.0 / size] * 2
        back = kept @ np.linalg.inv(whole)
        value = stepped(claim, link, late, back.T @ end @ back)
        states = whole @ valued(acting, 0.0, 0.0)
        np.testing.assert_allclose(states.T @ value @ states, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.oracle
@pytest.mark.parametrize("springs", [False, True])
def test_errors_that_gain_without_bound_within_a_period_are_refused(springs: bool) -> None:
    """Beyond the instant at which W is infinite it has eigenvalues below 0, and is regular again."""
    loop = SampledPairs(pair_gains(LINKS, 110.0**2, 12.0, 1e-3), 1)
    for upper, bounded in ((0.5, True), (60.0, True), (600.0, False)):
        sector = Sector(0.3, upper)
        errors, multipliers = Errors(EXACT, sector) if springs else Errors(sector), Multipliers(0.0)
        w = worst_period(loop, LINKS[0], errors, multipliers).w
        assert (np.linalg.eigvalsh(w)[0] > -1e-9 * np.abs(w).max()) == bounded
        one = {"low": LINKS[0], "high": LINKS[1], "storages": [[1.0] * 28] * 2}
        claim = pair_claim(claim_numbers(PairStorages(loop, errors, multipliers, 0.0), [one]))
        assert checker.regular_at_first(claim) == bounded


def test_a_storage_beyond_the_inverse_of_w_is_refused() -> None:
    """There the Schur complement of N is positive too, and P − PWP is not."""
    loop, ends = SampledPairs(pair_gains((1e4, 25e4), 110.0**2, 12.0, 1e-3), 1), (200.0**2, 205.0**2)
    storages = PairStorages(loop, Errors(EXACT, Sector(0.5, 0.5)), Multipliers(15.2), 0.0).lifted()
    found = [storages.at(float(link), 0.05, 0.0) for link in np.linspace(*ends, 4)]
    p = np.array([[one.matrices[0] for one in found if one is not None]])
    one = {"low": ends[0], "high": ends[1], "storages": [[1.0] * 28] * 2}
    claim = pair_claim(claim_numbers(storages, [one]))
    for factor in (1.0, 300.0, 1e4, 1e5):
        assert checker.box_proved(claim, checker.Box(ends, (0.0, 0.0), factor * p)) == (factor == 1.0)
