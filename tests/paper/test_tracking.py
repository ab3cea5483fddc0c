"""The claim on the weight of x5, against a solver of differential equations."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flexhinf.paper.loop_setup import PaperSetup
from flexhinf.paper.responses import INTEGRAL_WEIGHTS, judge_weight

pytestmark = pytest.mark.paper


@pytest.mark.ci("solves six laws and integrates their loops by SciPy")
@pytest.mark.oracle
def test_the_time_of_rise_falls_with_the_weight_of_x5(setup: PaperSetup) -> None:
    found: Any = judge_weight(setup, "x5")
    assert found.verdict is True
    plant = setup.arm.plant()
    values = plant.parameters.named(plant.parameters.vector())
    for goal in (math.pi / 2, math.pi):
        rises = []
        for weight in INTEGRAL_WEIGHTS[::2]:
            law = setup.law(
                {
                    "link_position": 60.0,
                    "link_position_integral": weight,
                    "link_velocity": 0.0,
                    "motor_velocity": 0.0,
                }
            )

            def flow(t: float, x: np.ndarray, law=law, goal=goal) -> np.ndarray:
                moved = np.asarray(plant.flow(x[:4], law.law(x), np.zeros(2), values))
                return np.append(moved, x[0] - goal)

            run = solve_ivp(flow, (0.0, 3.0), np.zeros(5), rtol=1e-7, atol=1e-9, max_step=0.02)
            crossings = [run.t[np.argmax(run.y[0] >= level * goal)] for level in (0.1, 0.9)]
            rises.append(crossings[1] - crossings[0])
        assert rises[0] > rises[1] > rises[2]
        shown = list(found.table.rows)[::2]
        column = 3 if goal < 2.0 else 6
        assert rises == pytest.approx([row[column] for row in shown], abs=0.03)
