"""The largest step between equilibria whose start lies in a level set of V."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.hinf.value_function import ValueFunction

_INTEGRAL = "_integral"
_STEPS = 200  # continuation steps up to the amplitude that the quadratic part predicts
_LONGEST = 50  # give up at this many times that amplitude
_DIFFERENCE = 1e-6


def step_amplitude(
    solution: ValueFunction,
    level: float,
    moved: str | Mapping[str, float] | None = None,
    integrals: Sequence[str] | None = None,
) -> float:
    """Largest a such that the equilibrium at −a, seen from the goal, lies in {V ≤ level}, connected to 0.

    Parameters
    ----------
    solution : ValueFunction
        About the goal.
    moved : str or mapping, optional
        The state that is commanded, or {state: share} for several. Default: those whose integral is a state
        (``NAME`` for a state ``NAME_integral``), in equal shares.
    integrals : sequence of str, optional
        Integral states: their start is the controller's choice, taken where V is smallest. Default: the
        states named ``…_integral``.

    Returns
    -------
    float
        In the unit of the moved state; infinite if the level is.

    Notes
    -----
    Followed by continuation from a = 0, because the minimum over the integrals can jump to another
    component of the level set. At an equilibrium every rate but the integrals' vanishes, with some constant input.
    """
    shares, free = step_roles(solution.state_names, moved, integrals)
    if not np.isfinite(level) or level <= 0:
        return float(max(level, 0.0))
    probe = 1e-3
    state = settled(solution, equilibrium_state(solution, -probe * shares, free), free)
    step = probe * float(np.sqrt(level / solution.value(state))) / _STEPS
    reached, state = 0.0, np.zeros(len(shares))
    for index in range(1, _LONGEST * _STEPS + 1):
        amplitude = index * step
        start = equilibrium_state(
            solution, -amplitude * shares, free, guess=state * amplitude / max(reached, step)
        )
        state = settled(solution, start, free)
        if solution.value(state) > level:
            return reached
        reached = amplitude
    return reached


def step_roles(
    names: tuple[str, ...], moved: str | Mapping[str, float] | None, integrals: Sequence[str] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Share of every state in the step, and which states are integrals."""
    if integrals is None:
        integrals = [name for name in names if name.endswith(_INTEGRAL)]
    if moved is None:
        moved = {name.removesuffix(_INTEGRAL): 1.0 for name in integrals}
    elif isinstance(moved, str):
        moved = {moved: 1.0}
    unknown = sorted({*moved, *integrals} - set(names))
    if unknown or not moved:
        raise InvalidInput(
            "The step does not say which state moves." if not unknown else "The step names unknown states.",
            f"expected names among {', '.join(names)}, got moved={moved!r}, integrals={list(integrals)!r}",
            "moved='link_position', integrals=['link_position_integral']",
        )
    shares = np.array([float(moved.get(name, 0.0)) for name in names])
    return shares, np.array([name in integrals for name in names])


def equilibrium_state(
    solution: ValueFunction, moved: np.ndarray, integral: np.ndarray, guess: np.ndarray | None = None
) -> np.ndarray:
    """Deviation (n,) at which every rate but the integrals' vanishes, given the moved states.

    Parameters
    ----------
    moved : ndarray, shape (n,)
        Deviation of the moved states, zero elsewhere.
    integral : ndarray of bool, shape (n,)
        Integral states; they keep the guess.
    guess : ndarray, shape (n,), optional

    Raises
    ------
    NumericalFailure
        No equilibrium was found there.
    """
    n, _, m, _ = solution.expansion.size
    given = integral | (moved != 0)
    x = np.where(moved != 0, moved, np.zeros(n) if guess is None else guess)
    unknown = np.flatnonzero(~given)
    u = np.zeros(m)

    def rates(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Those that vanish, and how the input moves them at the first point."""
        f, _, g2, _ = solution.exact_fields(points)
        return (f + np.einsum("aij,j->ai", g2, u))[:, ~integral], g2[0][~integral]

    for _ in range(30):
        size = len(unknown)
        points = np.repeat(x[None], 1 + 2 * size, axis=0)
        points[1 + np.arange(size), unknown] += _DIFFERENCE
        points[1 + size + np.arange(size), unknown] -= _DIFFERENCE
        values, by_input = rates(points)
        by_state = (values[1 : 1 + size] - values[1 + size :]).T / (2 * _DIFFERENCE)
        step = np.linalg.lstsq(np.hstack([by_state, by_input]), -values[0], rcond=None)[0]
        x[unknown] += step[:size]
        u += step[size:]
        if np.abs(step[:size]).max(initial=0.0) <= 1e-10 * max(1.0, float(np.abs(x).max())):
            break
    left = float(np.abs(rates(x[None])[0]).max())
    if not left <= 1e-6 * max(1.0, float(np.abs(solution.expansion.f_parts[1]).max())):
        raise NumericalFailure(
            "There is no equilibrium at the start of the step.",
            f"the rates are still {left:.3g} at {dict(zip(solution.state_names, x.tolist(), strict=True))}",
            "a step of states that some input can hold, or name the integral states",
        )
    return x


def settled(solution: ValueFunction, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The nearest minimum of V over the free states, by damped Newton steps."""
    index = np.flatnonzero(free)
    if len(index) == 0:
        return x
    x = x.copy()
    scale = np.sqrt(2 * max(float(solution.value(x)), 1e-300) / np.diag(solution.P)[index])
    difference = np.maximum(1e-5 * scale, 1e-12)
    count = len(index)
    for _ in range(20):
        around = np.repeat(x[None], 1 + 2 * count, axis=0)
        around[1 + np.arange(count), index] += difference
        around[1 + count + np.arange(count), index] -= difference
        values, gradients = solution.value_and_gradient(around)
        value, slope, slopes = values[0], gradients[0, index], gradients[1:, index]
        hessian = (slopes[:count] - slopes[count:]) / (2 * difference[:, None])
        hessian = (hessian + hessian.T) / 2
        if np.linalg.eigvalsh(hessian)[0] <= 0:
            hessian = solution.P[np.ix_(index, index)]
        step = -np.linalg.solve(hessian, slope)
        for _ in range(10):
            moved = x.copy()
            moved[index] += step
            if solution.value(moved) <= value:
                break
            step = step / 2
        else:
            break
        x = moved
        if np.abs(step / scale).max() < 1e-9:
            break
    return x
