"""Unlike motors in the search for a proof of pairs: the limit of alike ones, numbers, programs, and what is covered."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.workspace import masses
from benchmarks.workspace.robots import ROBOTS
from scipy.optimize import minimize

from flexhinf.designs import Specification
from flexhinf.designs.workspace.proof import motors_apart, sampled_pairs
from flexhinf.designs.workspace.search import RANDOM
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.modal import motor_multipliers as search, pair_gains
from flexhinf.modal.multipliers import popov_tolerance
from flexhinf.modal.pair_errors import NONE, ChannelWeights, Errors, FilterWeights, Multipliers, Sector
from flexhinf.modal.pair_period import worst_period
from flexhinf.modal.popov import gain_peak
from flexhinf.modal.sampled_pairs import Motors, SampledPairs
from flexhinf.robot.workspace import workspace_of

PERIOD, ENDS = 1e-3, (100.0**2, 300.0**2)
UNLIKE = Motors(0.3, 0.5, 2.0, 3.0)


@pytest.fixture(scope="module")
def pairs() -> SampledPairs:
    return SampledPairs(pair_gains(ENDS, 110.0**2, 12.0, PERIOD), 1, motors=UNLIKE)


@pytest.mark.parametrize(("latency", "watched"), [(0, None), (1, None), (0, [0, 2]), (1, [2])])
def test_without_errors_a_loop_with_unlike_motors_is_that_of_alike_ones(
    pairs: SampledPairs, latency: int, watched: list[int] | None
) -> None:
    """The prediction is a state, and no input waits: the modes are the same but for some at 0."""
    filter: Any = None
    if watched is not None:
        table = 0.05 * np.random.default_rng(2).normal(size=(3, 4 * len(watched)))
        filter = SimpleNamespace(pair=(np.eye(4)[watched], table, (8.0, 14.0)))
    loop, link = replace(pairs, latency=latency, filter=filter), 150.0**2
    numbers = search._Numbers(loop, Multipliers(2.0), 0.0)
    multipliers = numbers.multipliers(next(numbers.starts())).without_gain
    none = worst_period(loop.with_alike_motors, link, NONE, multipliers).a
    alike = worst_period(loop.alike, link, NONE, Multipliers(0.0)).a
    behind = [np.exp(-one.pole) for one in multipliers.every_filter for _ in range(2)]
    moduli = [
        np.sort(np.abs(np.r_[np.linalg.eigvals(a), more]))[::-1] for a, more in ((none, []), (alike, behind))
    ]
    count = min(map(len, moduli))
    np.testing.assert_allclose(moduli[0][:count], moduli[1][:count], atol=1e-6)
    assert moduli[0][count:].max(initial=0.0) < 1e-6
    assert loop.decay(link) == loop.alike.decay(link)


def test_all_numbers_of_a_search_are_multipliers_of_an_inequality_that_holds(pairs: SampledPairs) -> None:
    """Sectors with weights Π that are positive, other weights too, and a damped spring within what stands with τ."""
    rng, damping = np.random.default_rng(0), 2e-3
    alike = Multipliers(
        0.4,
        ChannelWeights(0.01, 0.02, 0.3),
        damping=ChannelWeights(0.0, 0.1, 0.2),
        filters=(FilterWeights(0.3, -0.1),),
    )
    numbers = search._Numbers(pairs, alike, damping)
    limited = 0
    for _ in range(200):
        found = numbers.multipliers(rng.normal(scale=1.5, size=len(next(numbers.starts()))))
        assert found.motors is not None
        assert np.linalg.eigvalsh(found.motors.matrix)[0] > 0.0
        assert min(*found.motors.friction, *found.springs[1:3], *found.damping[1:3]) > 0.0
        assert min(one.pole for one in found.every_filter) > 0.0
        assert found.damping.rate * damping / PERIOD <= 2.0 * found.masses
        limited += found.damping.rate * damping / PERIOD > 1.99 * found.masses
    assert limited > 0


@pytest.mark.oracle
def test_a_program_finds_the_least_within_its_bounds() -> None:
    """By another solver; and says so where there is nothing within them."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        root, rows, ends = rng.normal(size=(5, 5)), rng.normal(size=(7, 5)), rng.uniform(-0.2, 1.0, 7)
        bent = root @ root.T + 0.3 * np.eye(5)
        found, weights = search._bounded(bent, rows, ends)
        expected = minimize(
            lambda x, bent=bent: 0.5 * x @ bent @ x - x[-1],
            np.zeros(5),
            jac=lambda x, bent=bent: bent @ x - np.eye(5)[-1],
            constraints={"type": "ineq", "fun": lambda x, rows=rows, ends=ends: ends - rows @ x},
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        np.testing.assert_allclose(found, expected.x, atol=1e-5)
        np.testing.assert_allclose(bent @ found - np.eye(5)[-1] + weights @ rows, 0.0, atol=1e-9)
    apart = np.array([[1.0, 0.0], [-1.0, 0.0]])
    assert search._bounded(np.eye(2), apart, np.array([-1.0, -1.0]))[0].tolist() == [0.0, 0.0]


@pytest.mark.ci("searches one tolerance, by programs")
def test_most_of_what_alike_motors_tolerate_is_covered_with_unlike_ones(pairs: SampledPairs) -> None:
    """At λ that the search has not seen; and not twice as much."""
    shape = Errors(Sector(0.5, 0.5), Sector(1.0, 1.0))
    alike = popov_tolerance(pairs, shape, 12)
    found = search.motor_tolerance(pairs, alike, shape)
    assert 0.5 * alike.share < found.share <= alike.share
    assert found.errors.springs.lower == pytest.approx(found.share)
    for factor, covered in ((0.98, True), (1.5, False)):
        errors = NONE.and_share(factor, found.errors)
        peaks = [
            gain_peak(worst_period(pairs, float(link), errors, found.multipliers))
            for link in pairs.gains.links(31)
        ]
        assert (max(peaks) < 1.0) == covered
    none = search.motor_tolerance(pairs, alike._replace(share=0.0), shape)
    assert none.share == 0.0


def test_a_proof_may_hold_unlike_motors_of_torque_drives_with_a_known_delay() -> None:
    """Sectors hold all joints; what is not treated has alike motors."""
    robot = ROBOTS["planar-two-link"].robot()
    law, _ = masses.pairs_of(robot)
    setup = WorkspaceSetup(robot, Specification(), workspace_of(robot), law, RANDOM[0])
    motors, joints = sampled_pairs(setup).motors, law.joints
    assert motors is not None
    twists = joints.stiffness / joints.motor_inertia / law.gains.motor - 1.0
    speeds = joints.motor_damping / joints.motor_inertia - law.gains.damping
    assert -motors.slower < twists.min() < 0.0 < twists.max() < motors.faster
    assert -motors.less_friction < speeds.min() < 0.0 < speeds.max() < motors.more_friction
    assert [*motors_apart(setup)] == ["K/J", "B/J"]
    for s in (Specification(latency=2), Specification(unknown_delay=1e-3)):
        assert sampled_pairs(replace(setup, specification=s)).motors is None
    assert sampled_pairs(setup).alike.motors is None
