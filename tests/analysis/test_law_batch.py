"""A law that depends on the reference is linearised about the reference, not about its own rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from flexhinf.analysis import EquilibriumLoop
from flexhinf.baselines import FeedbackLinearisation, GravityCompensatedLQR, MotorPD, TorqueFeedback
from flexhinf.loop import Controller, Loop
from flexhinf.robot import Robot

H = 1e-3
LAWS = {
    "pd": lambda problem: MotorPD.tuned(problem, 20.0, integral="link_position"),
    "torque": lambda problem: TorqueFeedback.tuned(problem, 20.0, integral="link_position"),
    "gravity": lambda problem: GravityCompensatedLQR.design(problem),
    "linearisation": lambda problem: FeedbackLinearisation.tuned(problem, 6.0, integral=True),
}

# Five loops that run once: 0.7 s instead of 1.8 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


def slope_at(law: Any, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """∂k/∂x about (x, u) by central differences, (m, n + k)."""
    if not law.depends_on_reference:
        return law.gain
    steps = 1e-5 * np.eye(len(law.state_names))
    data = law.law_data
    moved = [law.evaluate_about(e, x, u, data) - law.evaluate_about(-e, x, u, data) for e in steps]
    return np.column_stack(moved) / 2e-5


@pytest.mark.quick_cases(2)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", LAWS)
def test_the_multipliers_away_from_the_laws_rest_are_those_of_the_loop_by_hand(
    two_link: Robot, kind: str
) -> None:
    law: Any = LAWS[kind](two_link.problem())
    plant, (x, u) = two_link.plant(), two_link.operating_point([1.6, -0.9])
    a, b, _, _ = plant.linearise(x, u)
    held = expm(H * np.block([[a, b], [np.zeros((2, 10))]]))
    f, g = held[:8, :8], held[:8, 8:]
    gain = slope_at(law, x, u)
    kx, ke, pick, zero = gain[:, :8], gain[:, 8:], np.eye(2, 8), np.zeros
    # State, integral before the sample, tracked error of the last sample; e = e₋ + H/2 (s₋ + s).
    ux, us = kx + 0.5 * H * ke @ pick, 0.5 * H * ke
    step = np.block([
        [f + g @ ux, g @ ke, g @ us],
        [0.5 * H * pick, np.eye(2), 0.5 * H * np.eye(2)],
        [pick, zero((2, 2)), zero((2, 2))],
    ])  # fmt: skip
    expected = np.sort(np.abs(np.linalg.eigvals(step)))
    modes = EquilibriumLoop(law, None, plant, H, equilibrium=(x, u), moving=True).modes([{}])
    found = np.sort(np.abs(np.ravel(modes.multipliers)))
    np.testing.assert_allclose(found[-len(expected) :], expected, atol=2e-6)


def test_a_stable_loop_is_called_stable_and_is(two_link: Robot) -> None:
    law = FeedbackLinearisation.tuned(two_link.problem(), 6.0)
    plant, (x, u) = two_link.plant(), two_link.operating_point([1.6, -0.9])
    modes = EquilibriumLoop(law, None, plant, H, equilibrium=(x, u), moving=True).modes([{}])
    assert np.abs(modes.multipliers).max() < 1.0
    start = x + 1e-4 * np.array([1.0, -1.0, 0, 0, 1.0, -1.0, 0, 0])
    run = Loop(plant, Controller(law, None, H, moving=True)).run(
        np.concatenate([x, u]), duration=6.0, initial_state=start
    )
    assert np.abs(run.signals["state"][-1] - x).max() < 1e-7
