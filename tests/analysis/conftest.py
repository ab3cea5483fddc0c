"""Robots, laws and filters that the tests of campaigns share."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from flexhinf.analysis import DiscreteSystem, EquilibriumLoop, LinearLoop
from flexhinf.analysis.linear_loop import exponential
from flexhinf.estimation import ExtendedKalmanFilter, OutputInjectionObserver, UnscentedKalmanFilter
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.loop.simulation.program import measure_function, rk4_function
from flexhinf.plant import Plant
from flexhinf.robot import Robot, load_robot, paper_arm

PERIOD = 1e-3


def designed(robot: Robot, degree: int = 4, ratio: float = 1.5, **options: Any) -> HJISolution:
    problem = robot.problem(**options)
    return solve_hji(problem, gamma=ratio * smallest_gamma(problem), degree=degree)


def filter_of(
    plant: Plant, mean: Any, kind: str = "ekf", noise: Any = (1e-8, 1e-8), period: float = PERIOD
) -> Any:
    build = {"ekf": ExtendedKalmanFilter, "ukf": UnscentedKalmanFilter}.get(kind)
    if build is None:
        poles = -np.array([60.0, 70.0, 80.0, 90.0])
        return OutputInjectionObserver(plant, period, *noise, mean, poles=poles)
    return build(plant, period, *noise, mean, 1e-6)


def whole_jacobian(
    loop: EquilibriumLoop, z: np.ndarray, values: dict[str, Any] | None = None
) -> tuple[Any, Any]:
    """(state one period later, Jacobian) at the rest z, by the text that loops run: one trace, one Jacobian."""
    plant, step, controller = loop.plant, loop.step, loop.step.controller
    n, place, memory = plant.n, step.places, controller.memory
    x, u, belief = z[:n], z[n:][place["u"]], []
    reference = np.concatenate(loop.model_equilibrium) if loop.moving else loop.command
    parts: dict[str, Any] = {"u": u, "integral": z[n:][place["integral"]], "position": loop.command}
    if loop.filter is not None:
        moving_belief = z[n:][place["belief"]].reshape(len(step.parts), -1)
        belief = list(step.estimator.initial)
        for row, k in enumerate(step.parts):
            belief[k] = moving_belief[row]
        if "moved" in step.estimator.initial._fields:
            belief[step.estimator.initial._fields.index("moved")] = np.ones(1)
        parts["belief"] = belief
    flat = memory.flat(parts | {"reference": reference, "started": 1.0})
    named = vars(memory.named(np.arange(flat.size)))
    moving = [named["belief"][k] for k in step.parts] if belief else []
    moving = [int(i) for part in (*moving, named["u"], named["integral"], named["position"]) for i in part]
    state, p = ca.SX.sym("state", n), ca.DM(plant.parameters.replaced(values or {}).vector())
    remembered, inputs = ca.SX.sym("remembered", len(moving)), ca.SX(ca.DM(flat))
    inputs[moving] = remembered
    y = measure_function(plant, controller)(
        state, inputs[named["u"].tolist()], ca.SX.zeros(len(controller.measured)), ca.vertcat(0.0, p)
    )
    u_now, _, after = controller.traced()(y, ca.DM(reference), inputs, ca.DM(controller.data_vector))
    later, held = state, ca.vertcat(loop.period / loop.sub_steps, p)
    moved = rk4_function(plant)
    for _ in range(loop.sub_steps):
        later = moved(later, u_now, ca.SX.zeros(3 * len(plant.disturbances)), held)
    both, end = ca.vertcat(state, remembered), ca.vertcat(later, after[moving])
    function = ca.Function("period", [both], [end, ca.densify(ca.jacobian(end, both))])
    value, slope = function(np.concatenate([x, flat[moving]]))
    return np.asarray(value)[:, 0], np.asarray(slope)


def dense_system(loop: LinearLoop, delay: float | None = None) -> DiscreteSystem:
    """`LinearLoop.system` with a state for each input that waits: plant, inputs (newest first), memory."""
    (n, m), p, s, q = loop.b.shape, len(loop.c), len(loop.memory), len(loop.positions)
    k = loop.g.shape[1]
    j, phi, old, new = loop.sampled_plant(delay)
    size = n + (j + 1) * m + s
    past, memory = slice(n, n + (j + 1) * m), slice(n + (j + 1) * m, size)
    oldest = slice(past.stop - m, past.stop)
    width = size + m + p + q + k
    commands = slice(size + m + p, size + m + p + q)
    y = np.zeros((p, width))
    y[:, :n], y[:, oldest], y[:, size + m : size + m + p] = loop.c, loop.d, np.eye(p)
    u, after = (block[:, s:] @ y for block in (loop.law, loop.memory))
    for rows, block, command in (
        (u, loop.law, loop.commanded_law),
        (after, loop.memory, loop.commanded_memory),
    ):
        rows[:, memory] += block[:, :s]
        rows[:, commands] += command
    total = u.copy()
    total[:, size : size + m] += np.eye(m)
    unit = np.eye(width)
    newest = total if j == 0 else unit[past.start + (j - 1) * m : past.start + j * m]
    state = phi @ unit[:n] + old @ unit[oldest] + new @ newest
    state[:, commands.stop :] += exponential(loop.a, loop.g, loop.period)[1]
    later = np.vstack([state, total, unit[past.start : oldest.start], after])
    seen = np.vstack([total, u, loop.positions @ unit[:n]])
    return DiscreteSystem(later[:, :size], later[:, size:], seen[:, :size], seen[:, size:], loop.period)


def dense_opened(loop: LinearLoop, delay: float | None = None) -> DiscreteSystem:
    """`LinearLoop.opened` with a state for each input that waits."""
    (n, m), p, s = loop.b.shape, len(loop.c), len(loop.memory)
    j, phi, old, new = loop.sampled_plant(delay)
    size = n + (j + 1) * m + s
    memory, unit = slice(size - s, size), np.eye(size + m)
    oldest, given = slice(size - s - m, size - s), unit[size:]
    y = np.zeros((p, size + m))
    y[:, :n], y[:, oldest] = loop.c, loop.d
    u, after = (block[:, s:] @ y + block[:, :s] @ unit[memory] for block in (loop.law, loop.memory))
    newest = given if j == 0 else unit[n + (j - 1) * m : n + j * m]
    later = np.vstack([
        phi @ unit[:n] + old @ unit[oldest] + new @ newest, given, unit[n : oldest.start], after,
    ])  # fmt: skip
    return DiscreteSystem(later[:, :size], later[:, size:], u[:, :size], u[:, size:], loop.period)


@pytest.fixture(scope="session")
def arm() -> Robot:
    return paper_arm()


@pytest.fixture(scope="session")
def cubic(arm: Robot) -> HJISolution:
    """The paper's law."""
    return designed(arm, ratio=2.0)


@pytest.fixture(scope="session")
def two_link() -> Robot:
    return load_robot("planar-two-link")


@pytest.fixture(scope="session")
def two_link_law(two_link: Robot) -> HJISolution:
    return designed(two_link)
