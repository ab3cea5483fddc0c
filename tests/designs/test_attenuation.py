"""γ from above, attained from below, and what the controller's parts spend of the region."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.analysis import dissipation_budget
from flexhinf.designs import PoseEvidence, Specification, design
from flexhinf.designs.certification import searches_disturbance

pytestmark = pytest.mark.ci("a whole design")

TORQUES = ("link_torque", "motor_torque")


@pytest.fixture(scope="module")
def made() -> PoseEvidence:
    """About 90°, torques at link and motor as disturbances, a step that starts inside the region."""
    asked = Specification(
        pose=[np.pi / 2], start=[np.pi / 2 - 0.3], preset="damped", disturbances=TORQUES, degrees=(4,), rays=500,
        draws=0, saturation=40.0, unknown_delay=1e-3,
    )  # fmt: skip
    return design(fh.paper_arm(), asked).evidence


def test_no_disturbance_found_attains_more_than_gamma(made: PoseEvidence) -> None:
    found = made.attenuation.attained
    assert found is not None
    assert found.largest_value <= made.chosen.level
    assert 0.9 * made.gamma_star < found.gain < made.solution.gamma
    d, state = found.disturbance, found.trajectory.signals["state"]
    assert d.shape[1] == 2
    assert np.abs(state[:, 0] - np.pi / 2).max() > 1e-3  # it moves


def test_the_parts_spend_one_after_the_other(made: PoseEvidence) -> None:
    rows = made.attenuation.budget
    assert [row.name for row in rows] == ["sampling", "delay", "estimator", "saturation"]
    assert all(row.budget.level == made.chosen.level for row in rows)
    totals = [row.budget.total for row in rows]
    np.testing.assert_allclose(np.cumsum([row.added for row in rows]), totals, rtol=1e-9, atol=1e-12)
    assert 0.0 < totals[0] < totals[1]
    assert made.inside
    assert rows[-1].budget.kept


def test_the_last_row_is_the_step_of_the_report_without_extras(made: PoseEvidence) -> None:
    setup = made.setup
    loop = setup.loop(setup.controller(setup.start))
    x, u = setup.equilibrium(setup.start)
    run = loop.run(
        noise=setup.noise,
        duration=made.scenario.step_duration,
        initial_state=x,
        initial_input=u,
        seed=setup.specification.seed,
    )
    np.testing.assert_array_equal(run.signals["state"], made.evaluation.step.run.signals["state"])
    spent = dissipation_budget(run, loop, made.chosen.level, u).total
    assert spent == pytest.approx(made.attenuation.budget[-1].budget.total, rel=1e-9)


@pytest.mark.ci("a whole design")
def test_nothing_is_searched_without_a_region_or_with_many_states() -> None:
    assert searches_disturbance(5, 500)
    assert not searches_disturbance(5, 0)
    assert not searches_disturbance(35, 50)
    asked = Specification(pose="home", preset="damped", degrees=(2,), rays=0, draws=0)
    found = design(fh.load_robot("quanser-rotflex"), asked).evidence.attenuation
    assert found.attained is None
    assert [row.name for row in found.budget] == ["sampling", "delay", "estimator"]
    assert all(np.isinf(row.budget.level) for row in found.budget)
