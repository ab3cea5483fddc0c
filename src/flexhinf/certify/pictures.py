"""Numbers of a certificate's pictures: V and r where steps start, and a step with the worst disturbance.

None of this is part of the theorem; it shows what is in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.certify.claim import Claim
from flexhinf.certify.starts import path_states
from flexhinf.certify.steps import longest_run, start_at
from flexhinf.certify.terms import Start
from flexhinf.hinf.margin import Penalty, checked_pair
from flexhinf.hinf.rays import Inequality
from flexhinf.hinf.value_function import ValueFunction

__all__ = ["StartSurface", "WorstStep", "start_surface", "worst_step"]

#: Points of a surface along each side, and its sides over where the proved region is expected to end.
POINTS, SIDES = 121, 1.25

#: A step that is shown with a disturbance has this share of the largest proved amplitude: the rest is for d.
SHARE = 0.8

#: Samples of the run with a disturbance.
SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class StartSurface:
    """V and r on the surface of equilibria at −a with an integrator at e: where steps from rest to rest start.

    Attributes
    ----------
    amplitude, integral : ndarray, shapes (A,) and (E,)
        a and e, in the units of the moved state and of the integrator.
    value, residual : ndarray, shape (E, A)
        V, and r.
    paths : tuple of ndarray, shape (N, 2)
        a and e of the proved starts, in the order of the certificate's.
    """

    amplitude: np.ndarray
    integral: np.ndarray
    value: np.ndarray
    residual: np.ndarray
    paths: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class WorstStep:
    """A step from rest with the disturbance that V says is worst, d = g1ᵀV_xᵀ/γ², for as long as the budget lasts.

    Attributes
    ----------
    rule : str
    amplitude : float
    time : ndarray, shape (N,)
        s.
    state, input, disturbance : ndarray, shapes (N, n), (N, m), (N, w)
        Deviations from the goal; the input itself.
    value, spent : ndarray, shape (N,)
        V, and ½γ²∫|d|² until then.
    """

    rule: str
    amplitude: float
    time: np.ndarray
    state: np.ndarray
    input: np.ndarray
    disturbance: np.ndarray
    value: np.ndarray
    spent: np.ndarray


def start_surface(
    solution: ValueFunction, certificate: Claim, penalty: Penalty | None = None
) -> StartSurface | None:
    """V and r where steps start; None without starts, or with other than one integrator."""
    chosen = [(start, [i for i, row in enumerate(start.table) if row]) for start in certificate.starts]
    if not chosen or any(len(free) != 1 for _, free in chosen):
        return None
    start, (integral,) = max(chosen, key=lambda pair: pair[0].amplitude)
    paths = tuple(np.column_stack([one.amplitudes, one.table[free[0]]]) for one, free in chosen)
    width = SIDES * max(start.amplitude, float(max(path[:, 0].max() for path in paths)))
    curvature = float(np.linalg.inv(solution.P)[integral, integral])
    height = SIDES * max(
        np.sqrt(2.0 * certificate.level * curvature), max(float(np.abs(p[:, 1]).max()) for p in paths)
    )
    a, e = np.linspace(-width, width, POINTS), np.linspace(-height, height, POINTS)
    rest = path_states(start.path, start.functions, _middle(certificate), a)
    points = np.repeat(rest[None], POINTS, axis=0)
    points[:, :, integral] = e[:, None]
    flat = points.reshape(-1, rest.shape[1])
    pair = checked_pair(solution, certificate.gamma, penalty)
    value, slope = solution.value_and_gradient(flat)
    residual = Inequality(solution, pair.gamma, pair.output).terms(flat, slope).sum(axis=0)
    shape = (POINTS, POINTS)
    return StartSurface(a, e, value.reshape(shape), residual.reshape(shape), paths)


def worst_step(solution: ValueFunction, certificate: Claim, start: Start) -> WorstStep:
    """The step of `SHARE` times the largest proved amplitude of a path, with the worst disturbance.

    Where the dissipation inequality is an equality, d = g1ᵀV_xᵀ/γ² maximises V̇ − ½γ²|d|². It acts from the
    beginning and ends where V(x0) + ½γ²∫|d|² reaches the proved level.
    """
    amplitude = SHARE * start.amplitude
    x = start_at(certificate, start, amplitude)
    duration = longest_run(solution) / 8.0
    h, gamma, level = duration / SAMPLES, certificate.gamma, certificate.level
    first = float(solution.value(x))

    def fields(x: np.ndarray, on: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        f, g1, g2, _ = solution.exact_fields(x[None])
        d = g1[0].T @ solution.gradient(x) / gamma**2 if on else np.zeros(g1.shape[2])
        u = solution.inputs(x[None])[0]
        return f[0] + g1[0] @ d + g2[0] @ u, u, d

    rows, spent, on = [], 0.0, True
    for k in range(SAMPLES + 1):
        rate, u, d = fields(x, on)
        on = on and first + spent + 0.5 * gamma**2 * h * float(d @ d) < level
        if not on and d.any():
            rate, u, d = fields(x, on)
        rows.append((k * h, x, solution.operating_input + u, d, float(solution.value(x)), spent))
        energy = float(d @ d)
        a, _, da = fields(x + 0.5 * h * rate, on)
        b, _, db = fields(x + 0.5 * h * a, on)
        c, _, dc = fields(x + h * b, on)
        x = x + h / 6.0 * (rate + 2.0 * a + 2.0 * b + c)
        spent += 0.5 * gamma**2 * h / 6.0 * float(energy + 2.0 * da @ da + 2.0 * db @ db + dc @ dc)
    time, states, inputs, ds, values, energies = (np.array(column) for column in zip(*rows))
    return WorstStep(start.rule, amplitude, time, states, inputs, ds, values, energies)


def _middle(claim: Claim) -> dict[str, float]:
    return {parameter.name: parameter.middle for parameter in claim.parameters}
