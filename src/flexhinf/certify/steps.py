"""What the loop does from the largest proved starts, without disturbance: runs of the proved equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.certify.claim import Claim
from flexhinf.certify.starts import path_states
from flexhinf.certify.terms import Start
from flexhinf.errors import NumericalFailure
from flexhinf.hinf.value_function import ValueFunction

_SETTLED = 1e-6  # the run ends where V is below this share of its first value
_STEPS = 20_000  # of a run at least, if it took all that time
_LONGEST = 100.0  # time constants of the slowest mode of the linear loop


@dataclass(frozen=True, eq=False)
class ProvedStep:
    """The rest-to-rest step of the largest proved amplitude, for one rule of the integrators' start.

    Attributes
    ----------
    amplitude : float
        In the unit of the moved state.
    overshoot_percent : float
        Of the step, in its direction.
    first_input, peak_input : ndarray, shape (m,)
        The input at the start and its largest magnitude, absolute values in the unit of the input.
    time, state : ndarray, shapes (N,) and (N, n)
        Deviations from the goal.
    """

    rule: str
    amplitude: float
    overshoot_percent: float
    first_input: np.ndarray
    peak_input: np.ndarray
    time: np.ndarray
    state: np.ndarray


def proved_steps(solution: ValueFunction, certificate: Claim) -> tuple[ProvedStep, ...]:
    """A run from the last start of each path of a certificate.

    Raises
    ------
    NumericalFailure
        A run that does not settle.
    """
    longest = longest_run(solution)
    return tuple(_step(solution, certificate, start, longest) for start in certificate.starts)


def longest_run(solution: ValueFunction) -> float:
    """s: so many time constants of the slowest mode of the linear loop that a run has settled long before."""
    plant = solution.expansion
    b = plant.g2_parts[0][:, :, 0]
    closed = plant.f_parts[1] - b @ np.linalg.solve(plant.r2, b.T @ solution.P)
    return _LONGEST / float(-np.linalg.eigvals(closed).real.max())


def _step(solution: ValueFunction, certificate: Claim, start: Start, longest: float) -> ProvedStep:
    from scipy.integrate import solve_ivp

    def rates(_: float, x: np.ndarray) -> np.ndarray:
        f, _g1, g2, _h = solution.exact_fields(x[None])
        return f[0] + g2[0] @ solution.inputs(x[None])[0]

    def settled(_: float, x: np.ndarray) -> float:
        return float(solution.value(x)) - end

    settled.terminal = True  # type: ignore[attr-defined]
    first = start_at(certificate, start, start.amplitude)
    end = _SETTLED * float(solution.value(first))
    fine: dict[str, Any] = {"rtol": 1e-8, "atol": 1e-10, "max_step": longest / _STEPS}
    run = solve_ivp(rates, (0.0, longest), first, "LSODA", events=settled, **fine)
    if run.status != 1:
        raise NumericalFailure(
            "The run from the largest proved start does not settle.",
            f"V is {float(solution.value(run.y[:, -1])):.3g} after {run.t[-1]:.3g} s",
            "a smaller level",
        )
    state = run.y.T
    inputs = solution.operating_input + solution.inputs(state)
    moved = [i for i, value in enumerate(first) if abs(value) == start.amplitude]
    beyond = float(np.max(-state[:, moved] / first[moved], initial=0.0))
    return ProvedStep(
        start.rule,
        start.amplitude,
        100.0 * max(beyond, 0.0),
        inputs[0],
        np.abs(inputs).max(axis=0),
        run.t,
        state,
    )


def start_at(claim: Claim, start: Start, amplitude: float) -> np.ndarray:
    """The start of one amplitude on a path at the middle of the parameters, deviation from the goal (n,)."""
    middle = {parameter.name: parameter.middle for parameter in claim.parameters}
    x = path_states(start.path, start.functions, middle, np.array([amplitude]))[0]
    for i, row in enumerate(start.table):
        x[i] += np.interp(amplitude, start.amplitudes, row) if row else 0.0
    return x
