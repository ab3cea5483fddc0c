"""Integration between two samples: Runge–Kutta steps, as many as the fastest mode needs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant.parameters import ParameterTable
from flexhinf.scalars.run import Run
from flexhinf.validation import real_array


class Linearisable(Protocol):
    """A plant whose modes are looked at: see `flexhinf.plant.Plant`."""

    @property
    def states(self) -> Sequence[str]:
        """Names of x."""
        ...

    @property
    def inputs(self) -> Sequence[str]:
        """Names of u."""
        ...

    @property
    def disturbances(self) -> Sequence[str]:
        """Names of d."""
        ...

    @property
    def parameters(self) -> ParameterTable:
        """Nominal values."""
        ...

    @property
    def sampled(self) -> bool:
        """Whether it is a map."""
        ...

    @property
    def engaged(self) -> Callable[..., Elements] | None:
        """``engaged(x, p)`` → a point near x at which everything in the flow acts."""
        ...

    def trace_jacobians(self) -> ca.Function:
        """∂flow/∂x and the others, as a CasADi function of (x, u, d, parameter vector)."""
        ...


#: Largest step times fastest mode for simulation: RK4 then errs by (hλ)⁴/120 < 1e-10 per radian of a mode's phase,
#: so that a vibration with little damping is right to 1e-9 for some periods.
SIMULATION_STEP = 0.01

#: More sub-steps per sample than this are a mistake in the parameters rather than a plant.
MOST_SUB_STEPS = 100_000


def rk4_step(
    flow: Callable[[Elements, Elements], Elements],
    x: Elements,
    inputs: Sequence[Elements],
    step: float,
) -> Elements:
    """One Runge–Kutta step of order four for ẋ = flow(x, v), v at the start, the middle and the end of the step, s."""
    start, middle, end = inputs
    k1 = flow(x, start)
    k2 = flow(_Stage((step / 2,))(x, k1), middle)
    k3 = flow(_Stage((step / 2,))(x, k2), middle)
    return _RungeKutta(step)(x, k1, k2, k3, flow(_Stage((step,))(x, k3), end))


def rk4_stages(
    run: Run, flow: Callable[..., Elements], x: Elements, step: float, *held: Elements
) -> Elements:
    """`rk4_step` of ẋ = flow(x, *held), x (n,), over a step in s, the flow called four times by a run."""
    k1 = run.call(flow, x, *held)
    k2 = run.call(flow, run.call(_Stage((step / 2,)), x, k1), *held)
    k3 = run.call(flow, run.call(_Stage((step / 2,)), x, k2), *held)
    return run.call(_RungeKutta(step), x, k1, k2, k3, run.call(flow, run.call(_Stage((step,)), x, k3), *held))


#: Nodes c₁ … c₈ of `eight_stages`, and weights of its stages 1, 6 and 8.
NODES = (
    0.0,
    1.0 / 6.0,
    0.25,
    0.32799268872952653,
    0.35062799005040396,
    0.4190949281722331,
    0.5636789500221959,
    0.8910685143630453,
)
WEIGHTS = (0.13842542148568749, 0.567239327629405, 0.29433525088490745)


def eight_stages(
    run: Run, flow: Callable[..., Elements], x: Elements, step: float, *held: Elements
) -> Elements:
    """One Runge–Kutta step of order four, and of order eight where the flow is linear; arguments as of `rk4_stages`.

    A stage is reached from the first one and from the one before it,

        k₁ = flow(x),    k₂ = flow(x + h c₂ k₁),    kᵢ = flow(x + h (cᵢ − aᵢ) k₁ + h aᵢ kᵢ₋₁),    aᵢ = cᵢ² / (2 cᵢ₋₁),

    so that Σⱼ aᵢⱼ cⱼ = cᵢ²/2 from the third on. Because b₂ = 0 and Σᵢ bᵢ aᵢ₂ = 0, the conditions of order four are then
    Σᵢ bᵢ cᵢᵏ = 1/(k + 1), k = 0 … 3, and Σᵢⱼ bᵢ aᵢⱼ cⱼ² = 1/12 [hairer1993]; those of a linear flow are
    bᵀAᵏ1 = 1/(k + 1)!, k = 4 … 7. A vibration errs by (h|λ|)⁸/9! of its phase, and does not grow up to h|λ| = 3.39.
    """
    first = run.call(flow, x, *held)
    stages = [first, run.call(flow, run.call(_Stage((step * NODES[1],)), x, first), *held)]
    for before, node in pairwise(NODES[1:]):
        part = node**2 / (2.0 * before)
        stages.append(
            run.call(
                flow,
                run.call(_Stage((step * (node - part), step * part)), x, first, stages[-1]),
                *held,
            )
        )
    return run.call(_Stage(tuple(step * weight for weight in WEIGHTS)), x, first, stages[5], stages[7])


@dataclass(frozen=True)
class _Stage:  # equal ones are one function; generated C has its name
    steps: tuple[float, ...]

    def __call__(self, x: Elements, *rates: Elements) -> Elements:
        """x + Σ hᵢ kᵢ: a stage of Runge-Kutta."""
        for step, rate in zip(self.steps, rates):
            x = x + step * np.asarray(rate)
        return x


@dataclass(frozen=True)
class _RungeKutta:
    step: float

    def __call__(self, x: Elements, k1: Elements, k2: Elements, k3: Elements, k4: Elements) -> Elements:
        """x + h/6 (k1 + 2 k2 + 2 k3 + k4): a step of Runge-Kutta."""
        return x + self.step / 6 * (np.asarray(k1) + 2 * (np.asarray(k2) + np.asarray(k3)) + np.asarray(k4))


def sub_steps(period: float, fastest_mode: float, largest: float = SIMULATION_STEP) -> int:
    """How many steps of at most `largest` / |λ| make one period, s; |λ| is the fastest mode, rad/s."""
    wanted = period * fastest_mode / largest - 1e-9
    refuse_if(
        not wanted <= MOST_SUB_STEPS,
        "The plant is too fast for this period and an explicit method.",
        f"expected at most {MOST_SUB_STEPS} sub-steps per period of {period:g} s, got a fastest mode of "
        f"{fastest_mode:.4g} rad/s, which needs {wanted:.4g}",
        "check the units of the parameters; leave out a mode that is far faster than the control",
    )
    return max(1, math.ceil(wanted))


def fastest_modes(
    plant: Linearisable, parameters: np.ndarray, x: ArrayLike | None = None, u: ArrayLike | None = None
) -> np.ndarray:
    """`fastest_mode` of a `Plant` with each of some parameters, (N, P), all at one point: (N,), rad/s; 0 of a map."""
    if plant.sampled:
        return np.zeros(len(parameters))
    point = np.zeros(len(plant.states)) if x is None else real_array(x)
    held = np.zeros(len(plant.inputs)) if u is None else real_array(u)
    points = [np.broadcast_to(point, (len(parameters), len(plant.states)))]
    if plant.engaged is not None and len(parameters):
        points.append(np.array([plant.engaged(point, plant.parameters.named(row)) for row in parameters]))
    (count, n), fastest = points[0].shape, np.zeros(len(parameters))
    constant = [np.tile(row[:, None], count) for row in (held, np.zeros(len(plant.disturbances)))]
    for rows in points if count else ():
        jacobians = np.asarray(plant.trace_jacobians()(rows.T, *constant, parameters.T)[0], dtype=float)
        jacobians = jacobians.reshape(n, count, n).swapaxes(0, 1)
        bad = np.argwhere(~np.isfinite(jacobians))
        if len(bad):
            k, row, column = bad[0].tolist()
            raise InvalidInput(
                "The plant has no linearisation at this point.",
                f"expected finite derivatives, got d({plant.states[row]}')/d({plant.states[column]}) = "
                f"{jacobians[k, row, column]} at x = {rows[k].tolist()}",
                "a point where the model is smooth",
            )
        fastest = np.maximum(fastest, np.abs(np.linalg.eigvals(jacobians)).max(axis=1))
    return fastest
