"""The budget against fine integration by SciPy, and against the inequality that it is the right side of."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from tests.analysis.conftest import filter_of
from tests.builders import linear_law
from tests.refusals import refused_with
from tests.tiers import ci_and_night

from flexhinf.analysis import budget_terms, dissipation_budget
from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.loop import Constant, Controller, Loop, Sine, Step, Trajectory
from flexhinf.plant import GeneralisedPlant, Penalty
from flexhinf.robot import Robot

WEIGHTS = {"link_position": 75, "link_velocity": 27, "motor_position": 90, "motor_velocity": 27}

# A dozen loops that run once: 1.4 s instead of 2.2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


def about(arm: Robot, goal: float, **options: Any) -> GeneralisedPlant:
    return arm.problem(Penalty(WEIGHTS | {"link_position_integral": 330}, effort=10), pose=[goal], **options)


@pytest.fixture(scope="module")
def disturbed(arm: Robot) -> tuple[HJISolution, float]:
    """About 90° with torques at link and motor: the law, and the level of its sampled region."""
    problem = about(arm, math.pi / 2, command=None, disturbances=("link_torque", "motor_torque"))
    law = solve_hji(problem, gamma=1.5 * smallest_gamma(problem), degree=4)
    return law, law.sampled_region(rays=300).level


@pytest.fixture(scope="module")
def law(arm: Robot) -> HJISolution:
    """About 90°."""
    problem = about(arm, math.pi / 2)
    return solve_hji(problem, gamma=1.5 * smallest_gamma(problem), degree=4)


def start_at(arm: Robot, angle: float) -> np.ndarray:
    return arm.operating_point([angle])[0]


def finely(arm: Robot, law: HJISolution, run: Trajectory, applied: np.ndarray, integral: float) -> float:
    """½ ∫ vᵀ R2 v with v at every moment, the plant and the problem's integral integrated by SciPy."""
    plant, (x_goal, u_goal) = arm.plant(), arm.operating_point([math.pi / 2])
    period, z = run.time[1], np.concatenate([run.signals["state"][0], [integral, 0.0]])
    for k in range(len(run.time) - 1):

        def rate(_: float, z: np.ndarray, u: np.ndarray = applied[k]) -> np.ndarray:
            v = u - u_goal - law.law(np.concatenate([z[:4] - x_goal, z[4:5]]))
            return np.concatenate([plant.derivative(z[:4], u), [z[0] - x_goal[0], 0.5 * 10.0 * v @ v]])

        z = solve_ivp(rate, (0.0, period), z, rtol=1e-8, atol=1e-10, first_step=period).y[:, -1]
    return float(z[5])


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("late", "limit", "period"),
    ci_and_night("2,000 samples one by one", [(1, 25.0, 2e-3)], [(0, None, 1e-3), (2, None, 2e-3)]),
)
def test_spent_is_that_of_a_fine_integration(
    arm: Robot, law: HJISolution, late: int, limit: float | None, period: float
) -> None:
    loop = Loop(arm.plant(), Controller(law, None, period, limit), delay=late * period)
    run = loop.run(duration=4.0, initial_state=start_at(arm, 1.0))
    found = dissipation_budget(run, loop)
    applied = np.vstack([np.tile(law.operating_input, (late, 1)), run.signals["input"]])
    # At the end the goal is held and the controller's integral is zero: so it began at what came in since.
    error = run.signals["state"][:, 0] - math.pi / 2
    integral = -period * float(0.5 * (error[1:] + error[:-1]).sum())
    assert (abs(integral) > 1e-3) == (limit is not None)
    moved = run.signals["state"][0] - law.operating_point[:4]
    assert found.start == pytest.approx(float(law.value(np.append(moved, integral))), rel=1e-4)
    assert found.total == pytest.approx(finely(arm, law, run, applied, integral), rel=2e-3)
    assert found.total > 0.05
    assert np.all(np.diff(found.spent) >= 0.0)


def test_a_held_input_spends_with_the_square_of_the_period(arm: Robot, law: HJISolution) -> None:
    spent = []
    for period in (4e-3, 2e-3, 1e-3):
        loop = Loop(arm.plant(), Controller(law, None, period))
        spent.append(dissipation_budget(loop.run(duration=3.0, initial_state=start_at(arm, 1.2)), loop).total)
    ratios = np.array(spent[:-1]) / np.array(spent[1:])
    assert np.all((ratios > 3.5) & (ratios < 4.6))


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("who", ["torques", "estimator", "all"])
def test_the_level_never_rises_by_more_than_is_spent(
    arm: Robot, disturbed: tuple[HJISolution, float], who: str
) -> None:
    """V(x_k) ≤ V(x_0) + ½γ²∫|d|² + ½∫vᵀR2v inside the sampled region: with torques, or a wrong estimate, noise, delay
    and limit, or with all of it."""
    law, level = disturbed
    point, filter, limit, noise, torques = start_at(arm, math.pi / 2), None, None, None, None
    if who != "torques":
        wrong = point + np.array([0.05, 0.0, 0.1, 0.0])
        filter, limit, noise = filter_of(arm.plant(), wrong, "ukf", noise=(1e-8, 1e-8)), 30.0, 1e-4
    if who != "estimator":
        torques = {"link_torque": Step(1.5, at=1.0), "motor_torque": Sine(2.0, 1.5, at=0.5)}
    late = 0.0 if filter is None else 2e-3
    loop = Loop(arm.plant(), Controller(law, filter, 1e-3, limit), delay=late)
    found = dissipation_budget(loop.run(None, torques, noise, 4.0, initial_state=point), loop, level)
    assert found.value.max() < level
    room = found.start + found.spent + found.disturbance - found.value
    assert room.min() > -1e-9 * level
    assert found.left == pytest.approx(level - found.start - found.disturbance[-1] - found.total)
    assert found.kept == (found.left >= 0.0)
    # And the accounts are not idle: begun at rest, V is paid for by nothing else.
    assert found.value.max() > 1.0 > 1e-4 > found.start
    assert (found.disturbance[-1] > 0.0) == (who != "estimator")


def test_what_a_limit_withholds_from_the_integral_is_no_lasting_expense(arm: Robot, law: HJISolution) -> None:
    loop = Loop(arm.plant(), Controller(law, None, 1e-3, 15.0))
    run = loop.run(duration=6.0, initial_state=start_at(arm, 0.4))
    assert np.abs(run.signals["input"]).max() == 15.0
    found = dissipation_budget(run, loop)
    assert found.spent[-1] == pytest.approx(found.spent[4000], rel=1e-6)
    assert found.spent[-1] > 10.0


@pytest.mark.ci("seven loops of two links")
def test_the_table_adds_up(two_link: Robot, two_link_law: HJISolution) -> None:
    x = two_link.operating_point()[0]
    start = two_link.operating_point(x[:2] + np.array([0.1, -0.1]))[0]
    filter = filter_of(two_link.plant(), start)
    rows = budget_terms(
        two_link_law, two_link.plant(), 1e-3, 1e5, latency=0, delay=1e-3, estimator=filter, saturation=30.0,
        initial_state=start, duration=3.0, noise=1e-5, seed=3,
    )  # fmt: skip
    assert [row.name for row in rows] == ["sampling", "delay", "estimator", "saturation"]
    totals = [row.budget.total for row in rows]
    assert np.allclose(np.cumsum([row.added for row in rows]), totals)
    assert totals[0] < 0.1 * totals[1]  # a whole period late, against half of one on average
    for parts, row in zip(
        ({"delay": 0.0}, {"delay": 1e-3}, {"delay": 1e-3, "filter": filter}), rows, strict=False
    ):
        loop = Loop(
            two_link.plant(),
            Controller(two_link_law, parts.get("filter"), 1e-3, latency=0),
            delay=parts["delay"],
        )
        noise = 1e-5 if "filter" in parts else None
        run = loop.run(noise=noise, duration=3.0, initial_state=start, seed=3)
        assert row.budget.total == dissipation_budget(run, loop).total
    assert len(budget_terms(two_link_law, two_link.plant(), initial_state=start, duration=0.1)) == 1


def test_a_bumpless_start_has_an_integral_from_the_first_sample(arm: Robot, law: HJISolution) -> None:
    start, u = arm.operating_point([1.2])
    controller = Controller(law, None, 1e-3, start="bumpless")
    loop = Loop(arm.plant(), controller)
    found = dissipation_budget(
        loop.run(duration=4.0, initial_state=start, initial_input=u), loop, initial_input=u
    )
    moved = start - law.operating_point[:4]
    asked = lambda e: float((law.law(np.append(moved, e)) + law.operating_input - u)[0])  # noqa: E731
    given = brentq(asked, -1.0, 1.0)
    assert found.start == pytest.approx(float(law.value(np.append(moved, given))), rel=1e-3)


def test_a_run_that_diverges_has_spent_everything(arm: Robot) -> None:
    problem = arm.problem()
    law = solve_hji(problem, gamma=1.05 * smallest_gamma(problem), degree=4)
    (row,) = budget_terms(
        law, arm.plant(), 0.02, 1e4, initial_state=np.array([40.0, 0, 40.0, 0]), duration=5.0
    )
    assert math.isinf(row.budget.total)
    assert not row.budget.kept


def test_misuse_is_refused(arm: Robot, law: HJISolution) -> None:
    plain = linear_law(arm.plant(), np.ones(4))
    loop = Loop(arm.plant(), Controller(plain, None))
    with refused_with(InvalidInput, "value", "LinearLaw"):
        dissipation_budget(loop.run(duration=0.01), loop)
    loop = Loop(arm.plant(), Controller(law, None))
    with pytest.raises(InvalidInput, match="link_torque"):
        dissipation_budget(loop.run(None, {"link_torque": Constant(1.0)}, duration=0.01), loop)
    moving = Loop(arm.plant(), Controller(law, None, moving=True))
    with refused_with(InvalidInput, "reference", 1.27):
        dissipation_budget(moving.run({"link_position": Constant(0.3)}, duration=0.01), moving)
    still = dissipation_budget(moving.run(duration=0.01), moving)
    assert still.total < 1e-12
