"""The corners of the tolerances: counts, an independent linear loop, and what another seed changes."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import fsolve

from flexhinf.analysis import ALL_STATES, FORMS, VELOCITIES
from flexhinf.paper import tolerances
from flexhinf.paper.loop_setup import GOALS, PaperSettings, PaperSetup
from flexhinf.paper.tolerances import ToleranceStudy, unstable_of

pytestmark = pytest.mark.paper

STIFF = "stiffness +12 %"


@pytest.fixture(scope="module")
def study(setup: PaperSetup) -> ToleranceStudy:
    return ToleranceStudy(setup, setup.nonlinear)


@pytest.mark.ci("loops at 2048 corners, two goals and every form of noise")
def test_all_2048_corners_are_counted_by_goal_and_form(study: ToleranceStudy) -> None:
    assert study.count("corner") == 2048
    counts = {goal: unstable_of(study.chosen[goal], "corner") for goal in GOALS}
    assert counts == {math.pi / 2: 0, math.pi: 466}  # R^v = q I: the report's default
    worst = {
        form: max(unstable_of(rates, "corner") for rates in study.of_form(form, math.pi / 2))
        for form in dict.fromkeys(r.noise.form for r in study.swept[math.pi / 2] if r.noise)
    }
    assert worst == {
        "all states": 0,
        "velocities only": 1024,
        "link velocities only": 1492,
        "motor velocities only": 1024,
    }


@pytest.mark.ci("shares the loops at all corners")
def test_one_tolerance_alone_suffices_with_noise_on_the_velocities(study: ToleranceStudy) -> None:
    goal = math.pi / 2
    assert study.sufficient_alone(study.of_form(VELOCITIES, goal)) == [STIFF]
    assert study.sufficient_alone(study.of_form(ALL_STATES, goal)) == []


def test_another_seed_samples_other_plants_and_the_same_corners(setup: PaperSetup) -> None:
    other = PaperSetup(PaperSettings(seed=5)).population
    sampled = setup.population.kinds == "draw"
    assert np.array_equal(setup.population.signs[~sampled], other.signs[~sampled])
    assert setup.population.values[0] != other.values[0]


def test_the_population_is_within_the_tolerances(setup: PaperSetup) -> None:
    population = setup.population
    kinds = [int((population.kinds == k).sum()) for k in ("draw", "corner", "single", "nominal")]
    assert kinds == [100, 2048, 22, 1]
    for p in setup.arm.uncertain:
        low, high = p.interval
        values = np.array([v[p.name] for v in population.values])
        assert (values.min(), values.max()) == pytest.approx((low, high))
        sampled = values[population.kinds == "draw"]
        assert np.all((sampled > low) & (sampled < high))
        assert np.ptp(sampled) > 0.8 * (high - low)
    assert population.describe(len(population) - 1) == "nominal"


# An independent linear loop -----------------------------------------------------------------------------
def flow(x: np.ndarray, volts: float, p: dict[str, float]) -> np.ndarray:
    """Sec. 6 with the coil of Table 2; without it where x has four states."""
    torque = p["stiffness"] * (x[0] - x[2])
    speed = p["back_emf_constant"] * x[3]
    current = x[4] if len(x) == 5 else (volts - speed) / p["resistance"]
    link = (-torque - p["mass"] * p["gravity"] * p["length"] * math.sin(x[0])) / p["link_inertia"]
    motor = (torque - p["friction"] * x[3] + p["torque_constant"] * current) / p["motor_inertia"]
    found = [x[1], link, x[3], motor]
    if len(x) == 5:
        found.append((volts - p["resistance"] * x[4] - speed) / p["inductance"])
    return np.array(found)


def slopes(function: Any, x: np.ndarray) -> np.ndarray:
    steps = 1e-6 * np.eye(len(x))
    columns = [(np.atleast_1d(function(x + h)) - np.atleast_1d(function(x - h))) / 2e-6 for h in steps]
    return np.array(columns).T


def sampled(p: dict[str, float], x: np.ndarray, volts: float, period: float) -> tuple[np.ndarray, np.ndarray]:
    n = len(x)
    whole = slopes(lambda z: flow(z[:n], z[n], p), np.append(x, volts))
    block = expm(period * np.vstack([whole, np.zeros((1, n + 1))]))
    return block[:n, :n], block[:n, n]


def growth_by_hand(setup: PaperSetup, p: dict[str, float], goal: float) -> float:
    """log of the largest multiplier per period: plant, Kalman filter at its stationary gain, integral and law."""
    nominal, s = setup.arm.nominal, setup.settings

    def at_rest(values: dict[str, float]) -> tuple[np.ndarray, float]:
        twist = values["mass"] * values["gravity"] * values["length"] * math.sin(goal) / values["stiffness"]
        current = values["stiffness"] * twist / values["torque_constant"]
        return np.array([goal, 0.0, goal + twist, 0.0, current]), values["resistance"] * current

    x, volts = at_rest(p)
    believed, believed_volts = at_rest(nominal)
    a_m, _ = sampled(nominal, believed[:4], believed_volts, s.period)
    c = np.array([[1.0, 0.0, 0.0, 0.0]])
    prior = solve_discrete_are(a_m.T, c.T, s.process_noise * np.eye(4), np.array([[s.measurement_noise]]))
    gain = (prior @ c.T / (c @ prior @ c.T + s.measurement_noise))[:, 0]

    def residual(z: np.ndarray) -> np.ndarray:  # estimate after the correction that reproduces itself, and x5
        before = z[:4] + s.period * flow(
            z[:4], volts, nominal
        )  # near rest one Euler step is the map's fixed point
        corrected = before + gain * (goal - before[0])
        return np.append(corrected - z[:4], 1e-2 * (setup.nonlinear.law(z)[0] - volts))

    start = np.append(believed[:4], 0.0)
    start[4] = fsolve(lambda q: setup.nonlinear.law(np.append(start[:4], q))[0] - volts, 0.0)[0]
    rest = np.asarray(fsolve(residual, start, xtol=1e-12))
    k = slopes(setup.nonlinear.law, rest)[0]
    a, b = sampled(p, x, volts, s.period)
    a_m, b_m = sampled(nominal, rest[:4], volts, s.period)
    # ζ = (x, prediction, x5 before, y before); the correction and the trapezoidal integral come first in a period.
    y = np.concatenate([[1.0], np.zeros(10)])
    predicted = np.hstack([np.zeros((4, 5)), np.eye(4), np.zeros((4, 2))])
    corrected = predicted + np.outer(gain, y - predicted[0])
    integral = np.eye(11)[9] + 0.5 * s.period * (y + np.eye(11)[10])
    u = k[:4] @ corrected + k[4] * integral
    moved = np.hstack([a, np.zeros((5, 6))]) + np.outer(b, u)
    whole = np.vstack([moved, a_m @ corrected + np.outer(b_m, u), integral, y])
    return float(np.log(np.abs(np.linalg.eigvals(whole)).max()) / s.period)


@pytest.mark.ci("shares the loops at all corners")
@pytest.mark.oracle
def test_growth_rates_by_a_loop_made_by_hand(setup: PaperSetup, study: ToleranceStudy) -> None:
    corners = np.flatnonzero(setup.population.kinds == "corner")
    for goal in GOALS:
        rates = study.chosen[goal].rates
        near = corners[np.argsort(np.abs(rates[corners]))[:3]]  # these decide the count
        chosen = [*corners[::256], *near, study.chosen[goal].worst]
        by_hand = [growth_by_hand(setup, dict(setup.population.values[k]), goal) for k in chosen]
        assert by_hand == pytest.approx([rates[k] for k in chosen], abs=1e-4)


# What is made of them -----------------------------------------------------------------------------------
def rates(corners: int, draws: int, fastest: float) -> Any:
    """Of four corners and four sampled plants, so many unstable."""
    unstable = [
        *range(4, 4 - corners, -1),
        *[-1] * (4 - corners),
        *range(4, 4 - draws, -1),
        *[-1] * (4 - draws),
    ]
    return SimpleNamespace(
        rates=np.array(unstable, dtype=float), kinds=np.array(["corner"] * 4 + ["draw"] * 4), fastest=fastest
    )


def test_the_table_has_a_row_for_each_goal_and_form_with_its_range() -> None:
    swept = [rates(1, 2, 0.3), rates(3, 0, math.inf)]
    study: Any = SimpleNamespace(
        true_state=dict.fromkeys(GOALS, rates(0, 0, -0.5)), chosen=dict.fromkeys(GOALS, rates(2, 1, 0.25)),
        estimated=True, process_noise=1e-7, of_form=lambda form, goal: swept, count=lambda kind: 4,
        sufficient_alone=lambda group: [STIFF] if len(group) > 1 else [],
    )  # fmt: skip
    rows = tolerances._tolerance_table(study).rows
    assert [row[0] for row in rows] == [name for name in ("90°", "180°") for _ in range(2 + len(FORMS))]
    assert [row[2:] for row in rows[:2]] == [(0, 0, 0, -0.5, "none"), (2, 2, 1, 0.25, "none")]
    assert {row[2:] for row in rows[2 : 2 + len(FORMS)]} == {(1, 3, 2, None, STIFF)}


@pytest.mark.parametrize(
    ("overshoot", "settling", "growth", "holds"),
    [
        (5.4, 1.05, -0.5, True), (6.2, 1.05, -0.5, False), (5.4, 1.2, -0.5, False), (5.4, 1.05, 0.0, False),
        (4.6, 0.95, -0.5, True), (math.nan, 1.0, -0.5, False),
    ],
)  # fmt: skip
def test_a_coil_may_change_a_step_a_little_and_no_loop_may_grow(
    overshoot: float, settling: float, growth: float, holds: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1 % of the step, and a tenth of the settling time, from 5 % and 1 s without the coil."""
    modes = SimpleNamespace(slowest=lambda count: [np.array([complex(growth, 2.0)])])
    loop = SimpleNamespace(modes=lambda robots: modes)
    monkeypatch.setattr(tolerances, "EquilibriumLoop", lambda *_, **__: loop)

    def run(*_: Any, inductance: bool, **__: Any) -> Any:
        values = (overshoot, settling, 30.0) if inductance else (5.0, 1.0, 30.0)
        keys = ("overshoot_percent", "settling_time_s", "peak_input")
        return SimpleNamespace(metrics=lambda: dict(zip(keys, values)))

    setup: Any = SimpleNamespace(
        nonlinear=None, settings=SimpleNamespace(estimator="ekf", period=1e-3), true_plants={False: None, True: None},
        estimator=lambda kind: None, run=run, arm=SimpleNamespace(nominal={}),
    )  # fmt: skip
    found = tolerances._coil_is_negligible(setup)
    assert found.verdict is holds
    if math.isfinite(overshoot):
        assert found.numbers["largest_overshoot_change_percent"] == pytest.approx(abs(overshoot - 5.0))
