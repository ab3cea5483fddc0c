"""The smallest gain that sampling does not refuse, for a law on a level set, at all vertices of a box of parameters.

With s V as the storage function, s > 0, the dissipation inequality at x reads

    s A(x) + Z(x) + s² G(x)/γ² ≤ 0,    A = max over vertices of V_x (f + g2 k),  Z = ½ |z|²,  G = ½ |g1ᵀV_xᵀ|².

A, Z and G do not depend on s and γ, so one sample of points gives the smallest γ for every s. Points are random, and
the worst are followed by smaller and smaller random steps. It proves nothing: it says what is worth a proof.

What the loop does from the largest proved starts, without disturbance: runs of the proved equations.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.certify.box import parameter_groups
from flexhinf.certify.certificate import Certificate
from flexhinf.certify.claim import Claim
from flexhinf.certify.starts import path_states
from flexhinf.certify.terms import Polynomial, Start, Term
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


_RAYS, _SHARES = 1500, (1e-3, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
_ROUNDS, _KEPT, _TRIES = 8, 40, 12  # of the local search: each round halves its steps
_AGAIN = 3  # local searches: after each, s is chosen anew
_SCALES = np.geomspace(
    0.2, 8.0, 30
)  # of s, about the one at which the inputs of law and penalty cost the same


@dataclass(frozen=True)
class SampledGain:
    """γ (inf where no s does), and s."""

    gamma: float
    scale: float


def sampled_gain(statement: Certificate, level: float, about: float, seed: int = 0) -> SampledGain:
    """The smallest γ that no point of {V ≤ level} refuses.

    Parameters
    ----------
    statement : Certificate
        Its V is taken as it is, its γ and level do not count.
    about : float
        The s in the middle of those that are tried.
    """
    rng = np.random.default_rng(seed)
    fields = _Fields(statement)
    root = np.linalg.inv(np.linalg.cholesky(quadratic_part(statement.value, len(statement.states)))).T
    points = _points(fields.value, root, level, rng)
    parts = fields.parts(points)
    for _ in range(_AGAIN):
        gammas = [_gamma(parts, s) for s in about * _SCALES]
        best = int(np.argmin([values.max() for values in gammas]))
        scale, worst = float(about * _SCALES[best]), gammas[best]
        if not np.isfinite(worst.max()):
            break
        step, near = 0.3, points
        for _ in range(_ROUNDS):
            starts = near[np.argsort(worst)[-_KEPT:]]
            size = np.sqrt(np.sum(np.linalg.solve(root, starts.T) ** 2, axis=0))
            moves = rng.standard_normal((_TRIES, *starts.shape)) @ root.T
            moved = (starts + step * size[:, None] * moves / np.sqrt(starts.shape[1])).reshape(
                -1, starts.shape[1]
            )
            near = np.vstack([starts, moved[fields.value(moved) <= level]])
            found = fields.parts(near)
            worst, step = _gamma(found, scale), step / 2
            points = np.vstack([points, near])
            parts = np.hstack([parts, found])
    return SampledGain(float(_gamma(parts, scale).max()), scale)


def _gamma(found: np.ndarray, scale: float) -> np.ndarray:
    """The smallest γ at each point; inf where there is none."""
    a, z, g = found
    room = -scale * a - z
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(room > 0, np.sqrt(scale**2 * g / np.where(room > 0, room, 1.0)), np.inf)


def _points(
    value: Callable[[np.ndarray], np.ndarray], root: np.ndarray, level: float, rng: np.random.Generator
) -> np.ndarray:
    """Points on random rays, up to where V first passes the level, or to four times where its quadratic part does."""
    n = len(root)
    rays = rng.standard_normal((_RAYS, n))
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ root.T * np.sqrt(2.0 * level)
    grid = np.linspace(0.0, 4.0, 161)[1:]
    inside = np.stack([value(rays * r) <= level for r in grid]).cumprod(axis=0).sum(axis=0)
    reach = grid[np.maximum(inside - 1, 0)]
    return np.vstack([rays * (reach * share)[:, None] for share in _SHARES])


def linear_part(rows: Sequence[Polynomial], n: int) -> np.ndarray:
    """The linear part (rows, n) of polynomials."""
    found = np.zeros((len(rows), n))
    for k, row in enumerate(rows):
        for powers, coefficient in row:
            if sum(powers) == 1:
                found[k, powers.index(1)] += coefficient
    return found


def quadratic_part(value: Polynomial, n: int) -> np.ndarray:
    """P of V_2 = ½ xᵀPx."""
    p = np.zeros((n, n))
    for powers, coefficient in value:
        if sum(powers) == 2:
            i, j = (k for k, power in enumerate(powers) for _ in range(power))
            p[i, j] += coefficient
            p[j, i] += coefficient
    return p


def box_vertices(statement: Certificate) -> list[dict[str, float]]:
    """Values of all parameters at the corners of the box of their groups: what always stands as one product is one."""
    ranges = {p.name: (p.low, p.high) for p in statement.parameters}
    middle = {p.name: p.middle for p in statement.parameters}
    ends = []
    for group in parameter_groups(statement):
        every = itertools.product(*([{name: end} for end in ranges[name]] for name in group))
        merged = [{name: value for part in chosen for name, value in part.items()} for chosen in every]
        size = [np.prod([part[name] ** power for name, power in group.items()]) for part in merged]
        ends.append([merged[int(np.argmin(size))], merged[int(np.argmax(size))]])
    return [
        middle | {k: v for part in corner for k, v in part.items()} for corner in itertools.product(*ends)
    ]


def term_weight(term: Term, vertex: dict[str, float]) -> float:
    """The coefficient of a term for values of the parameters."""
    return float(term.coefficient * np.prod([vertex[name] ** power for name, power in term.parameters]))


class _Fields:
    """V, and the parts of the inequality, in doubles."""

    def __init__(self, statement: Certificate) -> None:
        self.statement = statement
        self.n = len(statement.states)
        self.vertices = box_vertices(statement)

    def value(self, x: np.ndarray) -> np.ndarray:
        """V (N,)."""
        return _polynomial(self.statement.value, x)

    def parts(self, x: np.ndarray) -> np.ndarray:
        """A, Z and G at points (N, n), (3, N)."""
        given = self.statement
        slope = [_polynomial(_derivative(given.value, i), x) for i in range(self.n)]
        law = [_polynomial(row, x) for row in given.law]
        columns, weights = [], []
        for i in range(self.n):
            rows = [(term, np.ones(len(x))) for term in given.drift[i]]
            rows += [(term, law[j]) for j, entry in enumerate(given.g2[i]) for term in entry]
            for term, factor in rows:
                columns.append(slope[i] * factor * self._monomial(term, x))
                weights.append([term_weight(term, vertex) for vertex in self.vertices])
        a = (np.array(weights).T @ np.array(columns)).max(axis=0)
        z = sum((0.5 * _polynomial(row, x) ** 2 for row in given.penalty), np.zeros(len(x)))
        for i, row in enumerate(given.r2):
            for j, price in enumerate(row):
                z = z + 0.5 * price * law[i] * law[j]
        g = np.zeros((len(self.vertices), len(x)))
        for column in zip(*given.g1):
            along = np.zeros((len(self.vertices), len(x)))
            for i, entry in enumerate(column):
                for term in entry:
                    weight = np.array([term_weight(term, vertex) for vertex in self.vertices])
                    along += weight[:, None] * (slope[i] * self._monomial(term, x))
            g += 0.5 * along**2
        return np.stack([a, z, g.max(axis=0)])

    def _monomial(self, term: Term, x: np.ndarray) -> np.ndarray:
        result = np.prod(x ** np.array(term.powers), axis=1)
        if term.function is None:
            return result
        function = self.statement.functions[term.function]
        o, phi = function.offset + function.pi_halves * np.pi / 2, getattr(np, function.name)
        return result * (phi(o + x @ np.array(function.slope)) - phi(o))


def _polynomial(polynomial: Polynomial, x: np.ndarray) -> np.ndarray:
    result = np.zeros(len(x))
    for powers, coefficient in polynomial:
        term = np.full(len(x), coefficient)
        for i, power in enumerate(powers):
            if power:
                term = term * x[:, i] ** power
        result += term
    return result


def _derivative(polynomial: Polynomial, i: int) -> Polynomial:
    return tuple(
        (tuple(e - (j == i) for j, e in enumerate(powers)), coefficient * powers[i])
        for powers, coefficient in polynomial
        if powers[i]
    )
