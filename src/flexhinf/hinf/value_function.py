"""The value function V of a synthesis: its polynomial, its law, and Eq. (8) with the exact fields of the plant."""

# Not checked strictly: parts of arrays have no type.
# pyright: reportUnknownArgumentType=false, reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from operator import attrgetter
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.hinf.linear_part import LinearPart, linear_smallest_gamma
from flexhinf.plant.polynomial_plant import PolynomialPlant, Problem
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import gradient, monomials
from flexhinf.polynomial.basis import to_kronecker
from flexhinf.validation import read_only, real_array, value_text

_CHUNK = 2_000_000  # monomials evaluated at a time


@dataclass(frozen=True, eq=False, repr=False)
class ValueFunction:
    """V = V_2 + … + V_degree of Eq. (8) for one problem and one γ, and all that follows from V alone.

    All states are deviations x from the operating point, shape (n,) or (N, n); results follow.

    Attributes
    ----------
    gamma : float
        Attenuation level; infinite for the Hamilton–Jacobi–Bellman equation.
    degree : int
        Degree of V; the law has one less.
    P : ndarray, shape (n, n)
        V_2 = ½ xᵀPx.
    expansion : PolynomialPlant
        The Taylor expansion that was used.
    problem : Problem or None
        The exact plant. None after loading a file when the plant was not a polynomial one.
    value_parts : dict degree → ndarray, shape (count(n, degree),)
        Monomial coefficients of V; vanishing degrees are missing.
    state_names, input_names : tuple of str
        In order.
    operating_point, operating_input : ndarray, shapes (n,) and (m,)
        The point x is measured from, and the input there.
    """

    gamma: float
    degree: int
    P: np.ndarray
    expansion: PolynomialPlant
    problem: Problem | None
    value_parts: dict[int, np.ndarray]

    def __post_init__(self) -> None:
        self.__setstate__({"P": self.P, "value_parts": self.value_parts})

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over attributes; copies share their arrays, so nobody may write them."""
        vars(self).update(read_only(state))

    state_names = property(attrgetter("expansion.state_names"))
    input_names = property(attrgetter("expansion.input_names"))
    operating_point = property(attrgetter("expansion.operating_point"))
    operating_input = property(attrgetter("expansion.operating_input"))

    @cached_property
    def gamma_star(self) -> float:
        """Smallest feasible attenuation level of the problem (computed at the first access)."""
        return linear_smallest_gamma(LinearPart.of(self.expansion))

    @cached_property
    def input_price(self) -> np.ndarray:
        """R2⁻¹, (m, m)."""
        return np.linalg.inv(self.expansion.r2)

    # The polynomial ----------------------------------------------------------------------------
    def coefficients(self, k: int) -> dict[tuple[int, ...], float]:
        """V_k in plain monomials, {exponents: coefficient}, every monomial of degree `k`."""
        return dict(
            zip(map(tuple, self.exponents(k).tolist()), self.coefficient_array(k).tolist(), strict=True)
        )

    def coefficient_array(self, k: int) -> np.ndarray:
        """`coefficients` as an array, shape (count(n, k),), in the order of `exponents(k)`."""
        self._check_degree(k)
        part = self.value_parts.get(k)
        return np.zeros(basis.count(len(self.P), k)) if part is None else part.copy()

    def kronecker(self, k: int) -> np.ndarray:
        """v_k of V = ½ Σ v_kᵀ (x ⊗ … ⊗ x), symmetric, shape (n^k,): the form of PPR and NLbalancing."""
        return 2 * to_kronecker(self.coefficient_array(k), len(self.P), k)

    def exponents(self, k: int) -> np.ndarray:
        """Exponent vectors of the monomials of degree `k`, shape (count(n, k), n)."""
        self._check_degree(k)
        return basis.exponents(len(self.P), k)

    def _check_degree(self, k: int) -> None:
        refuse_if(
            not isinstance(k, Integral) or not 2 <= k <= self.degree,
            f"V has no part of degree {value_text(k)}.",
            f"expected a degree from 2 to {self.degree}, got {value_text(k)}",
            "solve_hji with a higher degree",
        )

    # The functions -----------------------------------------------------------------------------
    # Each at one deviation (n,) or several (N, n). One that is not finite raises InvalidInput, one so large that the
    # result leaves the finite numbers NumericalFailure; the functions of (N, n) alone return what comes out.
    def value(self, x: np.ndarray) -> np.ndarray:
        """V(x): a scalar, or shape (N,)."""

        def value(points: np.ndarray) -> np.ndarray:
            powers, start = monomials(points, self.value_parts), np.zeros(len(points))
            return sum((powers[k] @ part for k, part in self.value_parts.items()), start=start)

        return self._at(x, lambda points: np.concatenate([*map(value, self._chunks(points))]))

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """V_x(x): shape (n,) or (N, n)."""
        return self._at(x, self._gradient)

    def gradient_parts(self, x: np.ndarray) -> dict[int, np.ndarray]:
        """V_k,x by degree k of V, at deviations (N, n): shape (N, n) each; vanishing degrees are missing."""
        chunks: list[dict[int, np.ndarray]] = []
        for points in self._chunks(x):
            powers = monomials(points, [k - 1 for k in self.slope_parts])
            chunks.append({k: powers[k - 1] @ slope for k, slope in self.slope_parts.items()})
        return {k: np.concatenate([chunk[k] for chunk in chunks]) for k in self.slope_parts}

    def value_and_gradient(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """V (N,) and V_x (N, n) at deviations (N, n), from one evaluation: V_k = V_k,x x / k, by Euler."""
        parts = self.gradient_parts(x)
        value = sum(((part * x).sum(1) / k for k, part in parts.items()), start=np.zeros(len(x)))
        return value, sum(parts.values(), start=np.zeros(x.shape))

    def law(self, x: np.ndarray) -> np.ndarray:
        """u = −R2⁻¹ g2(x)ᵀ V_xᵀ, deviation of the input: shape (m,) or (N, m)."""
        return self._at(x, self.inputs)

    def inputs(self, x: np.ndarray) -> np.ndarray:
        """`law` at deviations (N, n), shape (N, m)."""
        _, _, g2, _ = self.exact_fields(x, "g2")
        return -np.linalg.solve(self.expansion.r2, np.einsum("ai,aij->ja", self._gradient(x), g2)).T

    def worst_disturbance(self, x: np.ndarray) -> np.ndarray:
        """d = g1(x)ᵀ V_xᵀ / γ²: shape (md,) or (N, md); zero for γ = ∞."""

        def disturbance(points: np.ndarray) -> np.ndarray:
            _, g1, _, _ = self.exact_fields(points, "g1")
            return np.einsum("ai,aij->aj", self._gradient(points), g1) / self.gamma**2

        return self._at(x, disturbance)

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Left-hand side of Eq. (8) with the exact f, g1, g2 and h: a scalar, or shape (N,)."""

        def left(points: np.ndarray) -> np.ndarray:
            return self.hamiltonian_terms(
                self._gradient(points), self.exact_fields(points, "residual"), self.gamma
            ).sum(axis=0)

        return self._at(x, left)

    def hamiltonian_terms(self, slope: np.ndarray, fields: Sequence[np.ndarray], gamma: float) -> np.ndarray:
        """V_x f, ½ hᵀh, ½ |g1ᵀ V_xᵀ|²/γ² and −½ V_x g2 R2⁻¹ g2ᵀ V_xᵀ, the terms of Eq. (8), shape (4, N).

        Parameters
        ----------
        slope : ndarray, shape (N, n)
            V_x.
        fields : tuple of ndarray
            f, g1, g2 and h at the same points, as `exact_fields` returns them.
        """
        f, g1, g2, h = fields
        w1 = np.einsum("ai,aij->aj", slope, g1) / gamma
        w2 = np.einsum("ai,aij->aj", slope, g2)
        priced = w2 @ self.input_price
        return np.stack(
            [(slope * f).sum(1), (h * h).sum(1) / 2, (w1 * w1).sum(1) / 2, -(w2 * priced).sum(1) / 2]
        )

    def exact_fields(
        self, x: np.ndarray, what: str = "this"
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """f (N, n), g1 (N, n, md), g2 (N, n, m) and h (N, s) of the exact plant at deviations (N, n).

        `what`: For errors, what needs them. Without the plant "g1" is the expansion's where that is constant, and "g2"
        always.
        """
        if self.problem is not None:
            return self.problem.fields(x)
        constant = {"g1": self.expansion.g1_parts, "g2": self.expansion.g2_parts}.get(what, {})
        if set(constant) == {0} or what == "g2":
            return self.expansion.fields(x)
        raise InvalidInput(
            "The exact plant is not known to this solution.",
            f"{what} needs it; the file it was loaded from holds the expansion only",
            "load_solution(path, problem=…), or law_polynomial() for the law to the degree of V",
        )

    # Inside ------------------------------------------------------------------------------------
    @cached_property
    def slope_parts(self) -> dict[int, np.ndarray]:
        """Monomial coefficients of V_k,x by degree k of V, shape (count(n, k−1), n)."""
        n = len(self.P)
        return read_only(
            {k: gradient(part / basis.multiplicity(n, k), n, k) for k, part in self.value_parts.items()}
        )

    def _at(self, x: np.ndarray, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """A function of points (N, n) at one deviation or several, all numbers finite."""
        n, points = len(self.P), real_array(x)
        if points.ndim not in (1, 2) or points.shape[-1] != n or not np.isfinite(points).all():
            raise InvalidInput(
                "The state does not fit the solution.",
                f"expected finite numbers of shape ({n},) or (N, {n}), got "
                f"{points.shape if points.ndim and np.isfinite(points).all() else value_text(x)}",
                f"deviations of {', '.join(self.state_names)} from the operating point",
            )
        points, single = np.atleast_2d(points), points.ndim == 1
        with np.errstate(all="ignore"):
            values = function(points)
        lost = np.flatnonzero(~np.isfinite(values).all(axis=tuple(range(1, values.ndim))))
        if lost.size:
            raise NumericalFailure(
                "A state is so far away that V leaves the finite numbers there.",
                f"expected deviations of about the size that the solution is for, got {points[lost[0]].tolist()}",
                f"deviations of {', '.join(self.state_names)} in the units of the model",
            )
        return values[0] if single else values

    def _chunks(self, points: np.ndarray) -> list[np.ndarray]:
        step = max(1, _CHUNK // basis.count(len(self.P), self.degree))
        return [points[begin : begin + step] for begin in range(0, max(len(points), 1), step)]

    def _gradient(self, points: np.ndarray) -> np.ndarray:
        return sum(self.gradient_parts(points).values(), start=np.zeros(points.shape))
