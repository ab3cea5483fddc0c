"""The circle criterion as linear matrix inequalities: a linear law, V quadratic and free, for every state.

V̇ + cost − gain |δ|² is affine in S and in each product of parameters. S(x1) lies between its smallest and its largest
value over all x1: so the inequality holds for all states and parameters if it holds at all ends. The smallest gain is
found over one V, and then a little more is proved exactly.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from flint import fmpq_mpoly

from benchmarks.certificates.identities import Identity, Program, Solver, Square, monomials, proved
from benchmarks.certificates.model import Model, model_of
from flexhinf.certify import Certificate, Function
from flexhinf.certify.box import parameter_groups

__all__ = ["GlobalGain", "global_gain", "slope_range"]

_FAR, _FINE = 60.0, 1e-4  # up to there S is looked at, rad; beyond, |S| ≤ 2/60
_ABOVE = 1.002  # share of the smallest γ at which the proof is made


@dataclass(frozen=True)
class GlobalGain:
    """What linear matrix inequalities prove for every start.

    Attributes
    ----------
    gamma : float
        The proved one; inf where none was found.
    exact : str
        Empty if rational arithmetic confirms it; else what fails.
    value : dict of exponents to float, or None
        V of the level one, in the model's coordinates.
    """

    gamma: float
    exact: str
    value: dict[tuple[int, ...], float] | None


def slope_range(function: Function) -> tuple[float, float]:
    """The smallest and the largest S over all x1, rounded outwards; |S′| ≤ ½."""
    x = np.arange(_FINE / 2, _FAR, _FINE)
    o = function.offset + function.pi_halves * np.pi / 2
    values = np.concatenate([(np.sin(o + sign * x) - np.sin(o)) / (sign * x) for sign in (1, -1)])
    return float(values.min()) - _FINE / 4 - 1e-9, float(values.max()) + _FINE / 4 + 1e-9


def global_gain(solver: Solver, claim: Certificate) -> GlobalGain:
    """The smallest gain that a quadratic V proves for a claim's linear law and its box of parameters."""
    models = [model_of(claim, corner) for corner in corners(claim)]
    first = solver.solve(_program(models, None))
    if first.y is None:
        return GlobalGain(float("inf"), first.status, None)
    gain = max(first.y["gain"], 0.0) * _ABOVE**2
    program = _program(models, gain)
    answer = solver.solve(program)
    value = None if answer.y is None else {_key(name): number for name, number in answer.y.items()}
    return GlobalGain(claim.gamma * gain**0.5, proved(program, answer), value)


def corners(claim: Certificate) -> list[dict[str, float]]:
    """Ends of every product of parameters that occurs as one variable."""
    ranges = {p.name: (p.low, p.high) for p in claim.parameters}
    ends = []
    for group in parameter_groups(claim):
        every = [dict(zip(group, chosen)) for chosen in itertools.product(*(ranges[name] for name in group))]
        sizes = [float(np.prod([chosen[name] ** power for name, power in group.items()])) for chosen in every]
        ends.append([every[int(np.argmin(sizes))], every[int(np.argmax(sizes))]])
    return [{k: v for part in chosen for k, v in part.items()} for chosen in itertools.product(*ends)]


def _program(models: list[Model], gain: float | None) -> Program:
    """−(V̇ + cost − gain |δ|²) ∈ Σ at all ends and V ∈ Σ; a gain that is not given is made small."""
    model = models[0]
    n, w = len(model.z), len(model.disturbances)
    ring = model.radius.context()
    terms = {f"{key}": ring.from_dict({key + (0,) * w: 1}) for key in monomials(n, 2, 2)}
    energy = sum((d * d for d in model.disturbances), model.number(0))
    positive = Square(model.number(1), [key + (0,) * w for key in monomials(n, 1, 1)])
    identities = [Identity(model.number(0), [positive], terms)]
    range_of_s = (0.0,) if model.function is None else slope_range(model.function)
    for one in models:
        basis = monomials(n + w, 1, 1)
        for s in range_of_s:
            quotient = one.number(s)
            slopes = {name: -_driven(one, term, quotient) for name, term in terms.items()}
            known = -one.cost
            if gain is None:
                slopes["gain"] = energy
            else:
                known += energy * model.number(gain)
            identities.append(Identity(known, [Square(one.number(1), basis)], slopes))
    return Program(identities, {"gain": 1.0} if gain is None else {})


def _driven(model: Model, value: fmpq_mpoly, quotient: fmpq_mpoly) -> fmpq_mpoly:
    """V̇ with disturbance."""
    driven = sum((a * d for a, d in zip(model.along(value), model.disturbances)), model.number(0))
    return model.derivative(value, quotient) + driven


def _key(name: str) -> tuple[int, ...]:
    return tuple(int(part) for part in name.strip("()").split(",") if part.strip())
