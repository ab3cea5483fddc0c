"""Sums of squares for the dissipation inequality: V given, or V free in turns with its multiplier.

On the ball |z| ≤ ρ, for both polynomials in the place of S:

    −r = σ₀ + σ₁ (β − V) + σ₂ (ρ² − z1²) + σ₃ (ρ² − |z|²),        V − β = σ₄ − ν (ρ² − |z|²),

σ sums of squares and ν free. The first says r ≤ 0 where V ≤ β inside the ball, the second that V ≥ β on its surface: so
the component of {V ≤ β} that holds 0 is inside. For V of degree two the ball is the level set, and σ₃ and ν are not
needed. With V free, −(V̇ + cost − |δ|²) in (z, δ) stands for −r, because it is affine in V; only σ₁ is then fixed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import fmpq_mpoly

from benchmarks.certificates.identities import (
    Answer,
    Identity,
    Program,
    Solver,
    Square,
    monomials,
    newton_basis,
    proved,
)
from benchmarks.certificates.model import Model
from flexhinf.certify.problem_to_claim import rational

__all__ = ["FreeStorage", "closing", "inside", "proved_inside"]

_INFINITE = float("inf")
_SMALLEST = 1e-4  # V ≥ this times |z|², in units of the level


def proved_inside(
    solver: Solver, model: Model, quotients: Sequence[fmpq_mpoly], reach: float, degree: int
) -> str:
    """Empty if V as it is proves its level one, exactly; else why not."""
    local = model.value.total_degree() > 2
    programs = [Program([inside(model, q, reach, reach if local else _INFINITE, degree)]) for q in quotients]
    programs.append(Program([closing(model, reach) if local else _narrow(model, reach)]))
    for program in programs:
        reason = proved(program, solver.solve(program))
        if reason:
            return reason
    return ""


def inside(model: Model, quotient: fmpq_mpoly, width: float, reach: float, degree: int) -> Identity:
    """−r = σ₀ + …: σ₁ and σ₃ of degree 2·`degree`, σ₂ of degree V's times what the quotient needs in z1."""
    known = -model.residual(model.value, quotient)
    factor = _padded(model, monomials(len(model.z), 1, degree))
    squares = [Square(model.number(1) - model.value, factor)]
    squares += _around(model, quotient, width, reach, degree, model.value.total_degree())
    return Identity(known, [Square(model.number(1), _basis([known], squares)), *squares])


def closing(model: Model, reach: float) -> Identity:
    """V − 1 = σ₄ − ν (reach² − |z|²)."""
    known = model.value - model.number(1)
    slopes = _free_products(model, model.number(reach**2) - model.radius, known.total_degree() - 2)
    return Identity(known, [Square(model.number(1), _basis([known, *slopes.values()], []))], slopes)


def _narrow(model: Model, width: float) -> Identity:
    """width² − z1² = σ + λ (1 − V), λ ≥ 0: |z1| ≤ width where V ≤ 1."""
    known, none = model.number(width**2) - model.z[0] ** 2, [0] * (len(model.z) + len(model.disturbances))
    squares = [Square(model.number(1) - model.value, [tuple(none)])]
    return Identity(known, [Square(model.number(1), _basis([known, model.value], squares)), *squares])


def _around(
    model: Model, quotient: fmpq_mpoly, width: float, reach: float, degree: int, of_value: int
) -> list[Square]:
    """σ₂ (width² − z1²) where there is a function, and σ₃ (reach² − |z|²) where the reach is finite."""
    squares = []
    if model.function is not None:
        along = monomials(len(model.z), 1, of_value // 2)
        powers = range(max(1, quotient.total_degree() // 2))
        ridge = sorted({(key[0] + k, *key[1:]) for k in powers for key in along})
        squares.append(Square(model.number(width**2) - model.z[0] ** 2, _padded(model, ridge)))
    if reach < _INFINITE:
        factor = _padded(model, monomials(len(model.z), 1, degree + of_value // 2 - 1))
        squares.append(Square(model.number(reach**2) - model.radius, factor))
    return squares


def _free_products(model: Model, weight: fmpq_mpoly, highest: int) -> dict[str, fmpq_mpoly]:
    """A free even polynomial times a weight."""
    ring = weight.context()
    keys = [key for key in monomials(len(model.z), 0, highest) if sum(key) % 2 == 0]
    return {f"nu{key}": ring.from_dict({_padded(model, [key])[0]: 1}) * weight for key in keys}


def _padded(model: Model, keys: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """Exponents of z as exponents of z and δ."""
    return [key + (0,) * len(model.disturbances) for key in keys]


def _basis(polynomials: Sequence[fmpq_mpoly], others: Sequence[Square]) -> list[tuple[int, ...]]:
    """Monomials of σ₀ where the other squares are as they are."""
    ring = polynomials[0].context()
    products = [
        square.weight * ring.from_dict({tuple(2 * e for e in key): rational(1.0)})
        for square in others
        for key in square.basis
    ]
    return newton_basis([*polynomials, *products])


# V free -------------------------------------------------------------------------------------------------------
@dataclass(eq=False)
class FreeStorage:
    """V of a degree in turns with σ₁, from a V that is known to work at some level.

    Attributes
    ----------
    solver : Solver
    model : Model
        In units of a level at which its V is proved.
    quotients : list of polynomials
        Between which S lies on |z1| ≤ reach.
    reach : float
        ρ, or inf: then V is a sum of squares everywhere, and there is no function.
    highest, degree : int
        Of V, and half that of σ₁.
    start : ndarray, (n,), or None
        z that is to be well inside: β − V there is made large; None: β is.
    """

    solver: Solver
    model: Model
    quotients: Sequence[fmpq_mpoly]
    reach: float
    highest: int
    degree: int
    start: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.value, self.level = self.model.value, 1.0
        parities = (0,) if self._even() else (0, 1)
        ring = self.value.context()
        keys = [key for key in monomials(len(self.model.z), 2, self.highest) if sum(key) % 2 in parities]
        self.terms = {f"V{key}": ring.from_dict({_padded(self.model, [key])[0]: 1}) for key in keys}

    def _even(self) -> bool:
        return (
            all(sum(map(int, key)) % 2 == 0 for key in self.value.to_dict())
            and self.model.function is not None
        )

    def multipliers(self) -> list[fmpq_mpoly] | None:
        """σ₁ for each quotient at V and β, those that leave most room; None where there are none."""
        found = []
        for quotient in self.quotients:
            known = -self.model.supply(self.value, quotient)
            weight = self.model.number(self.level) - self.value
            squares = [Square(weight, _padded(self.model, monomials(len(self.model.z), 1, self.degree)))]
            squares += _around(self.model, quotient, self.reach, self.reach, self.degree, self.highest)
            identity = self._identity(known, squares, {"room": -self._energy()})
            answer = self.solver.solve(Program([identity], {"room": -1.0}))
            if answer.y is None or answer.matrices is None or answer.y["room"] < -1e-7:
                return None
            found.append(self._sum(identity, answer, weight))
        return found

    def _energy(self) -> fmpq_mpoly:
        return sum((d * d for d in self.model.disturbances), self.model.radius)

    def _identity(self, known: fmpq_mpoly, squares: list[Square], slopes: dict[str, fmpq_mpoly]) -> Identity:
        basis = _basis([known, *slopes.values()], squares)
        return Identity(known, [Square(self.model.number(1), basis), *squares], slopes)

    @staticmethod
    def _sum(identity: Identity, answer: Answer, weight: fmpq_mpoly) -> fmpq_mpoly:
        """The sum of squares that multiplies `weight`."""
        assert answer.matrices is not None
        total: dict[tuple[int, ...], float] = {}
        for square, matrix in zip(identity.parts(), answer.matrices):
            if square.weight is weight:
                for i, first in enumerate(square.basis):
                    for j, second in enumerate(square.basis):
                        key = tuple(map(sum, zip(first, second)))
                        total[key] = total.get(key, 0.0) + float(matrix[i, j] + matrix[j, i]) / 2
        return weight.context().from_dict({key: rational(value) for key, value in total.items()})

    def program(self, multipliers: list[fmpq_mpoly], level: float | None) -> Program:
        """All conditions in V, with β free or given."""
        model, zero = self.model, self.model.number(0)
        identities = []
        for quotient, multiplier in zip(self.quotients, multipliers):
            nothing = model.supply(zero, quotient)
            slopes = {
                name: nothing - model.supply(term, quotient) + multiplier * term
                for name, term in self.terms.items()
            }
            squares = _around(model, quotient, self.reach, self.reach, self.degree, self.highest)
            identities.append(self._identity(*self._at(-nothing, slopes, -multiplier, level, squares)))
        ball = []
        if self.reach < _INFINITE:
            keys = _padded(model, monomials(len(model.z), 1, self.highest // 2 - 1))
            ball = [Square(model.number(self.reach**2) - model.radius, keys)]
        identities.append(self._identity(-model.radius * model.number(_SMALLEST), ball, dict(self.terms)))
        if self.reach < _INFINITE:
            free = _free_products(model, model.number(self.reach**2) - model.radius, self.highest - 2)
            identities.append(self._identity(*self._at(zero, self.terms | free, model.number(-1), level, [])))
        objective = {"level": -1.0} if level is None else {}
        if self.start is not None and level is None:
            for name, term in self.terms.items():
                objective[name] = float(np.prod(self.start ** np.array(_first(term)[: len(self.start)])))
        return Program(identities, objective)

    @staticmethod
    def _at(
        known: fmpq_mpoly,
        slopes: dict[str, fmpq_mpoly],
        of_level: fmpq_mpoly,
        level: float | None,
        squares: list[Square],
    ) -> tuple[fmpq_mpoly, list[Square], dict[str, fmpq_mpoly]]:
        """With the level as a free number, or at a given one."""
        if level is None:
            return known, squares, slopes | {"level": of_level}
        return known + of_level * rational(level), squares, slopes

    def improve(self, turns: int) -> str:
        """Raise β in turns; empty if at the end all conditions hold exactly, a little below it."""
        reason = "no multiplier at the first level"
        for _ in range(turns):
            multipliers = self.multipliers()
            if multipliers is None:
                break
            best = self.solver.solve(self.program(multipliers, None))
            if best.y is None:
                reason = best.status
                break
            level = best.y["level"]
            level -= 2e-3 * abs(level)
            program = self.program(multipliers, level)
            answer = self.solver.solve(program)
            reason = proved(program, answer)
            if answer.y is None:
                break
            ring = self.value.context()
            self.value = sum(
                (term * rational(answer.y[name]) for name, term in self.terms.items()), ring.constant(0)
            )
            self.level = level
        return reason


def _first(term: fmpq_mpoly) -> tuple[int, ...]:
    (key,) = term.to_dict()
    return tuple(map(int, key))
