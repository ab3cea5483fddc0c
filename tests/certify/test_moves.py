"""Certificates of moves: proved, by a second route in many pairs at once, at the edge, forged and damaged."""

import copy
import json
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.workspace import masses
from benchmarks.workspace.robots import ROBOTS
from flint import arb, arb_mat, ctx
from numpy.polynomial.chebyshev import chebval
from scipy.linalg import expm
from tests.refusals import refused_with, unnamed
from tests.tiers import ci_and_night

from flexhinf.certify.checker import moves as checker
from flexhinf.certify.checker.arm import arm_claim
from flexhinf.certify.checker.moves import CheckedMoves, check_moves, moves_claim
from flexhinf.certify.checker.pair_claim import pair_claim
from flexhinf.certify.checker.pairs import CheckedPairs
from flexhinf.certify.checker.taylor_matrix import TaylorMatrix
from flexhinf.designs import Specification
from flexhinf.designs.workspace import proof
from flexhinf.designs.workspace.everywhere import everywhere
from flexhinf.designs.workspace.moves import proved_moves, storage_numbers
from flexhinf.designs.workspace.pair_proof import claim_numbers
from flexhinf.designs.workspace.proof import sampled_pairs
from flexhinf.designs.workspace.search import RANDOM
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.modal import moves as search, pair_gains
from flexhinf.modal.moves import fastest_moves, free_loop, storage_of
from flexhinf.modal.pair_errors import Errors, Multipliers, Sector
from flexhinf.modal.popov import PairStorages
from flexhinf.modal.sampled_pairs import SampledPairs
from flexhinf.numerals import at_least
from flexhinf.pages.workspace_check import pair_text
from flexhinf.plant.joints import link_compliance
from flexhinf.robot.workspace import workspace_of

PERIOD, ENDS = 1e-3, (100.0**2, 500.0**2)

#: The largest errors of masses of an arm that is shown in boxes here.
WIDE = Sector(0.5, 0.4)


def pair_numbers(pairs):
    """The law and the loop of a file of pairs, whose storages no one checks here."""
    low, high = map(float, pairs.gains.ends)
    n = 6 + pairs.latency + 4 * (pairs.filter is not None)
    parts = [{"low": low, "high": high, "storages": [[1.0] * (n * (n + 1) // 2)] * 2}]
    return claim_numbers(PairStorages(pairs, Errors(WIDE), Multipliers(1.0), 0.0), parts)


def checked_of(numbers, loop, arm=None):
    return check_moves(moves_claim(numbers, pair_claim(loop), arm))


@pytest.fixture(scope="module")
def pairs():
    """Without an estimator."""
    return SampledPairs(pair_gains(ENDS, 110.0**2, 12.0, PERIOD), latency=1)


@pytest.fixture(scope="module")
def found(pairs):
    """The pairs, the largest change, and a file of 0.9 times that."""
    largest = fastest_moves(pairs)
    moves = storage_of(pairs, 0.9 * largest)
    assert moves is not None
    numbers = {"change": moves.change, **storage_numbers(moves.storage), "turnings": []}
    return pairs, largest, json.loads(json.dumps(numbers)), pair_numbers(pairs)


@pytest.fixture(scope="module")
def robots():
    """Two arms with the estimator of a design: their setups, loops, and what is proved of their moves."""
    made = {}
    for name in ("planar-two-link", "scara"):
        robot = ROBOTS[name].robot()
        law, _ = masses.pairs_of(robot)
        setup = WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0])
        pairs = sampled_pairs(setup).alike
        shown, loop = everywhere(setup, WIDE, pairs.gains.ends), pair_numbers(pairs)
        assert shown is not None
        made[name] = setup, loop, shown.arm, proved_moves(setup, pairs, loop, shown.arm)
    return made


@pytest.mark.oracle
@pytest.mark.parametrize(("latency", "watched"), [(0, None), (2, None), (1, [0, 2]), (1, [2])])
def test_search_and_checker_compute_the_same_loop(pairs, latency, watched):
    """They share no code; for a filter with links, and with motors alone."""
    seen = None if watched is None else np.eye(4)[watched]
    table = None if seen is None else np.random.default_rng(1).normal(size=(5, 4 * len(seen)))
    ends = (np.log(ENDS[0]) - 1.0, np.log(ENDS[1]) + 1.0)
    filter: Any = None if seen is None else SimpleNamespace(pair=(seen, table, ends))
    loop = SampledPairs(pairs.gains, latency, filter)
    with ctx.workprec(106):
        own = checker._loop(pair_claim(pair_numbers(loop)), arb(150.0**2), arb(0)).constant
        value = np.array([[float(entry) for entry in row] for row in own.tolist()])
    expected = free_loop(loop, 150.0**2)
    np.testing.assert_allclose(value, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.oracle
def test_polynomials_of_matrices_count_as_positive_only_where_they_are():
    """Of random ones with eigenvalues of several sizes, many of which just touch zero, on a fine grid."""
    rng, grid, counts = np.random.default_rng(6), np.linspace(-1.0, 1.0, 801), [0, 0]
    for _ in range(150):
        degree, size = int(rng.integers(1, 6)), 3
        scale = np.diag(10.0 ** rng.uniform(-4.0, 0.0, size))
        parts = [scale @ (part + part.T) @ scale for part in rng.normal(size=(degree, size, size))]
        values = sum(part * grid[:, None, None] ** k for k, part in enumerate(parts, 1))
        relative = np.linalg.inv(scale) @ values @ np.linalg.inv(scale)
        level = float(rng.choice([0.5, 0.98, 1.02, 1.5])) * -np.linalg.eigvalsh(relative)[:, 0].min()
        found = False
        with ctx.workprec(106), suppress(ZeroDivisionError):  # no enclosure, as the checker takes it
            own = [arb_mat(part.tolist()) for part in (level * scale @ scale, *parts)]
            found = checker._positive(TaylorMatrix({(k, 0): part for k, part in enumerate(own)}))
        true = np.linalg.eigvalsh(relative + level * np.eye(size)).min() > 0.0
        assert true or not found
        counts[int(found)] += 1
    assert min(counts) > 20


@pytest.mark.ci("checks what the search shares with other tests")
def test_nearly_all_that_the_search_finds_is_proved_and_no_more_than_is_there(found):
    pairs, largest, numbers, loop = found
    checked = checked_of(numbers, loop)
    assert isinstance(checked, CheckedMoves)
    assert (checked.low, checked.high) == pairs.gains.ends
    assert checked.rate * PERIOD == pytest.approx(0.9 * largest)
    assert isinstance(checked_of({**numbers, "change": 1.25 * numbers["change"]}, loop), str)
    assert storage_of(pairs, 1.2 * largest) is None


@pytest.mark.ci("searches once more")
def test_a_storage_has_room_between_its_nodes(found, monkeypatch):
    """With so few nodes that it has none there at first."""
    pairs, largest, _, loop = found
    monkeypatch.setattr(search, "NODES", 0.3)
    few = search._parts(pairs)[0]
    change = 0.8 * largest
    solved = few.solved(float(np.sinh(0.5 * change)))
    assert solved is not None
    alone = few.storage(solved)
    links = np.geomspace(*ENDS, 60)
    assert min(alone.room(link, free_loop(pairs, link), float(np.sinh(0.5 * change))) for link in links) < 0.0
    moves = storage_of(pairs, change)
    assert moves is not None
    numbers = {"change": moves.change, **storage_numbers(moves.storage), "turnings": []}
    assert isinstance(checked_of(numbers, loop), CheckedMoves)


def of_matrix(function, inertia):
    """A function of a symmetric matrix, by its eigenvectors."""
    values, vectors = np.linalg.eigh(inertia)
    return (vectors * np.array([function(value) for value in values])) @ vectors.T


def whole_loop(numbers, inertia):
    """A of many pairs at once, by the matrix Λ (k, k): states by kind, each k long. Of the file alone, by SciPy."""
    k, h = len(inertia), numbers["period"]
    one, zero = np.eye(k), np.zeros((k, k))
    kappa, beta = numbers["motor"] * one, numbers["damping"] * one
    # z, z′, w, w′, in seconds; the file counts in z, z′, s, s′ and periods.
    a = np.block(
        [
            [zero, one, zero, zero, zero],
            [-inertia, zero, inertia, zero, zero],
            [zero, zero, zero, one, zero],
            [kappa, zero, -kappa, -beta, numbers["input"] * one],
            [np.zeros((k, 5 * k))],
        ]
    )
    flow = expm(h * a)[: 4 * k]
    observer = numbers["observer"]
    n = 7 + 4 * (observer is not None)
    unit = np.eye(n * k)
    state, (total, last, waiting) = unit[: 4 * k], unit[(n - 3) * k :].reshape(3, k, -1)
    estimate = state
    if observer is not None:
        seen, (low, high), table = np.array(observer["seen"]), observer["range"], np.array(observer["table"])
        predicted = unit[4 * k : 8 * k]
        gains = [
            of_matrix(lambda x, c=c: chebval((2.0 * np.log(x) - low - high) / (high - low), c), inertia)
            for c in table.T
        ]
        gain = np.block([[gains[i * len(seen) + j] for j in range(len(seen))] for i in range(4)])
        estimate = predicted + gain @ np.kron(seen, one) @ (state - predicted)
        assert [1.0, 0.0, 0.0, 0.0] in seen.tolist()
    integral, ahead = total + 0.5 * h * (last + state[:k]), flow @ np.vstack([estimate, waiting])
    poles = numbers["poles"]
    feedback = [
        of_matrix(lambda x, c=c: np.dot(c, [*(p / (x + p) for p in poles), 1.0]), inertia)
        for c in numbers["coefficients"]
    ]
    force = -np.hstack(feedback[:4]) @ ahead - feedback[4] @ integral
    moved = [flow @ np.vstack([part, waiting]) for part in (state, estimate)]
    loop = np.vstack([*moved[: 1 + (observer is not None)], integral, state[:k], force])
    kind = np.array([[1, 0, 0, 0], [0, 1 / h, 0, 0], [1, 0, 1, 0], [0, 1 / h, 0, 1 / h]])
    plain = np.eye(n)
    plain[:4, :4], plain[n - 3, n - 3] = kind, h
    if observer is not None:
        plain[4:8, 4:8] = kind
    return np.kron(np.linalg.inv(plain), one) @ loop @ np.kron(plain, one)


def whole_storage(numbers, inertia):
    """S of many pairs at once, in the same order."""
    c, poles = np.sinh(0.5 * numbers["change"]), numbers["poles"]
    n = int(np.sqrt(2.0 * len(numbers["constant"])))
    rows, columns = np.tril_indices(n)

    def full(triangle):
        matrix = np.zeros((n, n))
        matrix[rows, columns] = matrix[columns, rows] = triangle
        return matrix

    whole = np.kron(full(numbers["constant"]), np.eye(len(inertia)))
    for p, falls, rises in zip(poles, numbers["falling"], numbers["rising"]):
        share = of_matrix(lambda x, p=p: p / (x + p), inertia)
        rate = share - share @ share
        whole += np.kron(full(falls), share - c * rate) - np.kron(full(rises), share + c * rate)
    return whole


def growth(numbers, loop, before, after):
    """The largest V′/V of a sample at Λ after which Λ′ follows, over all states."""
    a, own = whole_loop(loop, before), whole_storage(numbers, before)
    root = np.linalg.inv(np.linalg.cholesky(0.5 * (own + own.T)))
    return np.linalg.eigvalsh(root @ a.T @ whole_storage(numbers, after) @ a @ root.T)[-1]


def moved_by(inertia, change, rng):
    """Λ′ with Λ/e^ρ ≤ Λ′ ≤ e^ρ Λ, as far as that goes, turned at random."""
    root, turn = of_matrix(np.sqrt, inertia), np.linalg.qr(rng.normal(size=inertia.shape))[0]
    return root @ (turn * np.exp(change * rng.choice([-1.0, 1.0], len(turn)))) @ turn.T @ root


@pytest.mark.oracle
@pytest.mark.ci("reads what the search shares with other tests")
def test_three_pairs_that_turn_at_random_never_let_the_storage_rise_and_faster_ones_do(found):
    """By eigenvectors, of the numbers in the file alone."""
    _, _, numbers, loop = found
    rng, largest = np.random.default_rng(2), {1.0: 0.0, 4.0: 0.0}
    for _ in range(60):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        low, high = np.log(ENDS)
        inertia = (turn * np.exp(rng.uniform(low, high, 3))) @ turn.T
        for factor in largest:
            after = moved_by(inertia, factor * numbers["change"], rng)
            if ENDS[0] <= np.linalg.eigvalsh(after)[0] and np.linalg.eigvalsh(after)[-1] <= ENDS[1]:
                largest[factor] = max(largest[factor], growth(numbers, loop, inertia, after))
    assert 0.99 < largest[1.0] < 1.0 < largest[4.0]


@pytest.mark.oracle
@pytest.mark.ci("proves the moves of two robots")
@pytest.mark.parametrize("name", ["planar-two-link", "scara"])
def test_along_fast_moves_of_robots_the_storage_falls_at_every_sample(robots, name):
    """Λ of the plant along a swing of all joints, at the speeds that are proved; by eigenvectors."""
    setup, loop, arm, moves = robots[name]
    assert moves is not None
    assert moves.poses == 0
    numbers, share = json.loads(json.dumps(moves.numbers)), moves.share
    assert checked_of(numbers, loop, arm_claim(arm)) == moves.checked
    model, own = link_compliance(setup.law.plant), setup.law.plant.parameters.vector()
    root = np.sqrt(setup.law.joints.stiffness)
    space, rng = setup.workspace, np.random.default_rng(4)

    def inertia_at(pose):
        return root[:, None] * model.matrix(pose, own) * root

    fastest, largest = 0.0, 0.0
    for _ in range(25):
        pose = rng.uniform(space.lower, space.upper)
        later = pose + PERIOD * share * moves.limits * rng.choice([-1.0, 1.0], len(pose))
        if (later < space.lower).any() or (later > space.upper).any():
            continue
        before, after = inertia_at(pose), inertia_at(later)
        change = np.abs(np.log(np.linalg.eigvals(np.linalg.solve(before, after)).real)).max()
        fastest = max(fastest, change / numbers["change"])
        largest = max(largest, growth(numbers, loop, before, after))
    assert 0.5 < fastest <= 1.0
    assert 0.99 < largest < 1.0


@pytest.mark.ci("proves the moves of two robots")
@pytest.mark.parametrize("name", ["planar-two-link", "scara"])
def test_rates_of_inertia_hold_at_every_pose_and_little_smaller_ones_are_not_shown(robots, name):
    setup, _, arm, moves = robots[name]
    model, own = link_compliance(setup.law.plant), setup.law.plant.parameters.vector()
    rng, largest = np.random.default_rng(9), 0.0
    for pose in setup.workspace.sample(300, 6):
        speeds = moves.limits * rng.choice([-1.0, 1.0], len(pose))
        before, after = (model.matrix(pose + side * 1e-5 * speeds, own) for side in (-0.5, 0.5))
        rate = np.abs(np.linalg.eigvals(np.linalg.solve(before, after - before)).real).max() / 1e-5
        largest = max(largest, rate)
        assert rate <= moves.together
    assert largest > 0.9 * moves.together
    claim = moves_claim(moves.numbers, pair_claim(robots[name][1]), arm_claim(arm))
    for turning in claim.turnings:
        assert checker.turning_boxes(claim.arm, turning) is not None
        assert checker.turning_boxes(claim.arm, turning._replace(rate=0.95 * turning.rate)) is None
    assert checker.turning_boxes(None, claim.turnings[0]) is None


def forged(numbers, loop, rng):
    """A file that says more than is proved, or of another law or loop than its storage is."""
    file, other, kind = copy.deepcopy(numbers), copy.deepcopy(loop), str(rng.choice(KINDS))
    which = int(rng.integers(len(file["poles"])))
    if kind == "change":
        file["change"] = min(0.99, float(rng.uniform(1.5, 20.0)) * file["change"])
    elif kind == "sign":
        name = str(rng.choice(["falling", "rising"]))
        file[name][which] = [-x for x in file[name][which]]
    elif kind == "negative":
        file["constant"] = [-x for x in file["constant"]]
    elif kind == "scale":
        file["rising"][which] = [float(rng.uniform(300.0, 1e4)) * x for x in file["rising"][which]]
    elif kind == "entry":
        part = file[str(rng.choice(["falling", "rising"]))][which]
        part[int(rng.integers(len(part)))] -= 10.0 * max(map(abs, part))
    elif kind == "law":
        row = int(rng.choice([0, 2, 3]))
        other["coefficients"][row] = [-x for x in other["coefficients"][row]]
    elif kind == "loop":
        other[str(rng.choice(["input", "period"]))] *= float(rng.choice([0.2, 4.0, 10.0]))
    elif kind == "range":
        other["intervals"][0]["high"] *= float(rng.uniform(20.0, 100.0))
    else:
        file["turnings"] = [{"speeds": [1.0, 1.0], "rate": 1e9}]  # of no arm
    return kind, file, other


KINDS = ["change", "sign", "negative", "scale", "entry", "law", "loop", "range", "speed"]


def damaged(numbers, rng):
    """A part of a file with a key that is missing, or of another kind."""
    file, name = copy.deepcopy(numbers), str(rng.choice(sorted(numbers)))
    wrong = [None, "text", {}, True, float("nan"), float("inf"), "1", [[1.0], [2.0, 3.0]], [{}], -1.0, 0.0]
    file[name] = wrong[int(rng.integers(len(wrong)))]
    if rng.random() < 0.2:
        del file[name]
    return file


@pytest.mark.parametrize("tried", ci_and_night("checks dozens of files", [40], [150]))
def test_none_of_dozens_of_forged_and_damaged_files_is_accepted(found, tried):
    _, _, numbers, loop = found
    rng, kinds = np.random.default_rng(3), set()
    for _ in range(tried):
        kind, file, other = forged(numbers, loop, rng)
        kinds.add(kind)
        assert isinstance(checked_of(file, other), str), kind
    assert len(kinds) == len(KINDS)
    for _ in range(tried):
        with pytest.raises(InvalidInput, match="certificate"):
            moves_claim(damaged(numbers, rng), pair_claim(loop), None)


@pytest.mark.ci("reads what the search shares with other tests")
def test_a_proof_that_says_more_of_moves_than_its_certificate_is_not_proved(found, monkeypatch):
    """Beside pairs that count as checked here."""
    _, _, numbers, loop = found
    pairs = CheckedPairs(*ENDS, *WIDE, 0.0, 0.0, 0.0, 0.0, 0.0, False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1)
    monkeypatch.setattr(proof, "check_pairs", lambda claim, every: pairs)
    checked = checked_of(numbers, loop)
    assert isinstance(checked, CheckedMoves)
    whole = {"pairs": loop, "proved": pairs._asdict(), "moves": numbers, "moving": checked._asdict()}
    whole["controller"] = proof.of_controller(estimates=False)
    verdict = proof.pair_verdict(json.loads(json.dumps(whole)))
    assert verdict.is_proved
    assert unnamed(pair_text(verdict), "Proved", at_least(checked.rate, 3), "Coriolis") == []
    faster = {**whole["moving"], "rate": checked.rate * (1.0 + 1e-15)}
    turning = {"speeds": [1.0, 1.0], "rate": 100.0}
    for changed in (
        {"moving": faster},
        {"moves": None},
        {"moves": {**numbers, "change": 1.5 * numbers["change"]}},
        {"moves": {**numbers, "turnings": [turning]}},
    ):
        verdict = proof.pair_verdict({**whole, **changed})
        assert not verdict.is_proved
        assert unnamed(pair_text(verdict), "Not proved", "moves") == []


@pytest.mark.ci("reads what the search shares with other tests")
@pytest.mark.parametrize(
    "changed", [{"change": 0.0}, {"change": 1.0}, {"turnings": [{"speeds": [1.0], "rate": 0.0}]}]
)
def test_numbers_at_the_open_ends_of_their_ranges_are_refused(found, changed):
    with refused_with(InvalidInput, "moves"):
        moves_claim({**found[2], **changed}, pair_claim(found[3]), None)
