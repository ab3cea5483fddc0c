"""What a synthesis returns: the value function, its law, its worst disturbance, and its own residual."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.hinf.feedback import GradientLaw, input_matrix_of
from flexhinf.hinf.gamma import linear_smallest_gamma
from flexhinf.hinf.linear_part import LinearPart
from flexhinf.hinf.recursion import DegreeRecord
from flexhinf.notebook import Summarised, names_text, number_text
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.plant.problem import Problem
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import add_part, gradient, monomials, product
from flexhinf.polynomial.kronecker import to_kronecker
from flexhinf.polynomial.law import PolynomialLaw

if TYPE_CHECKING:
    from flexhinf.hinf.sampled import Penalty, SampledCheck

__all__ = ["HJISolution"]

_CHUNK = 2_000_000  # monomials evaluated at a time


@dataclass(frozen=True, eq=False, repr=False)
class HJISolution(Summarised):
    """V = V_2 + … + V_degree with V_x f + ½ hᵀh + ½ V_x (g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ) V_xᵀ = O(|x|^(degree+1)).

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
    records : tuple of DegreeRecord
        Method, residual and time by degree.
    condition : float
        Condition number of the closed loop's eigenvectors, in scaled coordinates (nan for degree 2).
    memory : int
        Estimate of the memory the solve needed, in bytes.
    """

    gamma: float
    degree: int
    P: np.ndarray
    expansion: PolynomialPlant
    problem: Problem | None
    value_parts: dict[int, np.ndarray]
    records: tuple[DegreeRecord, ...] = ()
    condition: float = float("nan")
    memory: int = 0

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return self.expansion.state_names

    @property
    def operating_point(self) -> np.ndarray:
        """The point x is measured from, shape (n,)."""
        return self.expansion.operating_point

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return self.expansion.input_names

    @property
    def operating_input(self) -> np.ndarray:
        """The input at the operating point, shape (m,)."""
        return self.expansion.operating_input

    @cached_property
    def gamma_star(self) -> float:
        """Smallest feasible attenuation level of the problem (computed when first asked for)."""
        return linear_smallest_gamma(LinearPart.of(self.expansion))

    @property
    def gain(self) -> np.ndarray:
        """The law's linear part, shape (m, n): u = K x + …, K = −R2⁻¹ g2(0)ᵀ P."""
        return -np.linalg.solve(self.expansion.r2, self.expansion.g2_parts[0][:, :, 0].T @ self.P)

    # The polynomial ----------------------------------------------------------------------------
    def coefficients(self, k: int) -> dict[tuple[int, ...], float]:
        """V_k in plain monomials, {exponents: coefficient}, every monomial of degree `k`."""
        keys = map(tuple, self.exponents(k).tolist())
        return dict(zip(keys, self.coefficient_array(k).tolist(), strict=True))

    def coefficient_array(self, k: int) -> np.ndarray:
        """The same as an array, shape (count(n, k),), in the order of `exponents(k)`."""
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
        if not isinstance(k, Integral) or not 2 <= k <= self.degree:
            raise InvalidInput(
                f"V has no part of degree {k}.",
                f"expected a degree from 2 to {self.degree}, got {k}",
                "solve_hji with a higher degree",
            )

    # The functions -----------------------------------------------------------------------------
    def value(self, x: np.ndarray) -> np.ndarray:
        """V(x): a scalar, or shape (N,)."""
        points, single = self._points(x)
        total = np.concatenate([self._value(chunk) for chunk in self._chunks(points)])
        return total[0] if single else total

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """V_x(x): shape (n,) or (N, n)."""
        points, single = self._points(x)
        slope = self._gradient(points)
        return slope[0] if single else slope

    def gradient_parts(self, x: np.ndarray) -> dict[int, np.ndarray]:
        """V_k,x by degree k of V, at deviations (N, n): shape (N, n) each; vanishing degrees are missing."""
        chunks = []
        for points in self._chunks(x):
            powers = monomials(points, [k - 1 for k in self._slopes])
            chunks.append({k: powers[k - 1] @ slope for k, slope in self._slopes.items()})
        return {k: np.concatenate([chunk[k] for chunk in chunks]) for k in self._slopes}

    def law(self, x: np.ndarray) -> np.ndarray:
        """u = −R2⁻¹ g2(x)ᵀ V_xᵀ, deviation of the input: shape (m,) or (N, m)."""
        points, single = self._points(x)
        _, _, g2, _ = self._fields(points, "g2")
        inputs = -np.linalg.solve(self.expansion.r2, np.einsum("ai,aij->ja", self._gradient(points), g2)).T
        return inputs[0] if single else inputs

    def worst_disturbance(self, x: np.ndarray) -> np.ndarray:
        """d = g1(x)ᵀ V_xᵀ / γ²: shape (md,) or (N, md); zero for γ = ∞."""
        points, single = self._points(x)
        _, g1, _, _ = self._fields(points, "g1")
        disturbance = np.einsum("ai,aij->aj", self._gradient(points), g1) / self.gamma**2
        return disturbance[0] if single else disturbance

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Left-hand side of Eq. (8) with the exact f, g1, g2 and h: a scalar, or shape (N,)."""
        points, single = self._points(x)
        f, g1, g2, h = self._fields(points, "residual")
        slope = self._gradient(points)
        w1 = np.einsum("ai,aij->aj", slope, g1) / self.gamma
        w2 = np.einsum("ai,aij->aj", slope, g2)
        priced = np.linalg.solve(self.expansion.r2, w2.T).T
        left = (slope * f).sum(1) + ((h * h).sum(1) + (w1 * w1).sum(1) - (w2 * priced).sum(1)) / 2
        return left[0] if single else left

    def exact_fields(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """f (N, n), g1 (N, n, md), g2 (N, n, m) and h (N, s) of the exact plant at deviations (N, n)."""
        return self._fields(x, "this")

    def sampled_region(
        self,
        gamma: float | None = None,
        penalty: Penalty | None = None,
        *,
        rays: int = 4000,
        seed: int = 0,
        largest: float = 1e3,
    ) -> SampledCheck:
        """Largest level set on which the dissipation inequality held at the points looked at; not a proof.

        Parameters
        ----------
        gamma : float, optional
            The attenuation level to check, not below the designed one. Default: 1.1 times the designed one.
        penalty : callable, mapping, sequence or matrix, optional
            The penalty to check, smaller than the designed one: h(x) from (N, n) to (N, s), {state: weight},
            one weight per state, or a matrix (s, n). Default: 0.9 times the designed h.
        rays : int
            Directions followed outwards, drawn on the ellipsoid xᵀPx = 1 with the given `seed`.
        seed : int
        largest : float
            Largest deviation in any state that is looked at.

        Returns
        -------
        SampledCheck
            See `flexhinf.hinf.sampled` for what is checked and why the checked pair must be the weaker one.
        """
        from flexhinf.hinf.sampled import sample_region

        return sample_region(self, gamma, penalty, rays=rays, seed=seed, largest=largest)

    def law_polynomial(self) -> PolynomialLaw:
        """The law as a table of monomials through degree − 1.

        With a constant g2 this is `law` itself; otherwise the product −R2⁻¹ g2(x)ᵀ V_xᵀ is truncated after
        degree − 1, the last degree that V determines.
        """
        n, _, m, _ = self.expansion.size
        parts: dict[int, np.ndarray] = {}
        for i, slope in self._slopes.items():
            for p, fields in self.expansion.g2_parts.items():
                if i - 1 + p <= self.degree - 1:
                    columns = [product(slope, fields[:, j], n, i - 1, p) for j in range(m)]
                    add_part(parts, i - 1 + p, -np.linalg.solve(self.expansion.r2, np.array(columns)))
        degrees = tuple(sorted(parts))
        return PolynomialLaw(n, degrees, np.concatenate([parts[k] for k in degrees], axis=1))

    # As a law of a closed loop (`flexhinf.plant.Law`) ----------------------------------------------
    @property
    def law_is_polynomial(self) -> bool:
        """Whether `law_polynomial` is the law itself: g2 is constant, and not only its expansion."""
        source = self.problem if hasattr(self.problem, "input_matrix_is_constant") else self.expansion
        return source.input_matrix_is_constant  # type: ignore[union-attr]

    @cached_property
    def _feedback(self) -> PolynomialLaw | GradientLaw:
        if self.law_is_polynomial:
            return self.law_polynomial()
        degrees = tuple(sorted(self._slopes))
        table = np.concatenate([self._slopes[k] for k in degrees]).T
        slopes = PolynomialLaw(len(self.P), tuple(k - 1 for k in degrees), table)
        matrix, name = input_matrix_of(self.problem, self.expansion)
        key = f"gradient {slopes.n} {slopes.degrees} {name}"
        return GradientLaw(slopes, matrix, np.linalg.inv(self.expansion.r2), key)

    @property
    def law_data(self) -> np.ndarray:
        """Coefficients of the law, flat: data of a kernel, so another γ compiles nothing."""
        return self._feedback.coefficients.ravel()

    @property
    def law_key(self) -> str:
        """What distinguishes this law's code from another's: its monomials, and g2 where it is not constant."""
        feedback = self._feedback
        if isinstance(feedback, GradientLaw):
            return feedback.key
        return f"polynomial {feedback.n} {feedback.degrees}"

    def evaluate_law(self, x: np.ndarray, data: np.ndarray) -> np.ndarray:
        """The law at one deviation x (n,) on any element, with its coefficients as an argument."""
        return self._feedback.evaluate(x, np.asarray(data).reshape(self._feedback.coefficients.shape))

    def summary(self) -> dict[str, str]:
        """γ, degree, states, inputs, coefficients and the largest residual of any degree, for ``repr``."""
        residuals = [record.residual for record in self.records if record.residual == record.residual]
        facts = {
            "gamma": number_text(self.gamma),
            "degree of V": str(self.degree),
            "states": names_text(self.state_names),
            "inputs": names_text(self.input_names),
            "coefficients": str(sum(len(part) for part in self.value_parts.values())),
        }
        if residuals:
            facts["largest relative residual"] = f"{max(residuals):.1e}"
        return facts

    # Report and file ---------------------------------------------------------------------------
    def report(self) -> str:
        """How each degree was found: method, measured residual, conditioning, time, memory."""
        from flexhinf.hinf.report import solution_report

        return solution_report(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to one file, atomically; see `load_solution`."""
        from flexhinf.hinf.storage import save_solution

        save_solution(self, path)

    # Inside ------------------------------------------------------------------------------------
    @cached_property
    def _slopes(self) -> dict[int, np.ndarray]:
        """Monomial coefficients of V_k,x by degree k of V, shape (count(n, k−1), n)."""
        n = len(self.P)
        return {k: gradient(part / basis.multiplicity(n, k), n, k) for k, part in self.value_parts.items()}

    def _points(self, x: np.ndarray) -> tuple[np.ndarray, bool]:
        n = len(self.P)
        try:
            points: np.ndarray = np.asarray(x, dtype=float)
        except (TypeError, ValueError):
            points = np.array(np.nan)
        if points.ndim not in (1, 2) or points.shape[-1] != n:
            raise InvalidInput(
                "The state does not fit the solution.",
                f"expected shape ({n},) or (N, {n}), got {points.shape if points.ndim else repr(x)}",
                f"deviations of {', '.join(self.state_names)} from the operating point",
            )
        return np.atleast_2d(points), points.ndim == 1

    def _chunks(self, points: np.ndarray) -> list[np.ndarray]:
        step = max(1, _CHUNK // basis.count(len(self.P), self.degree))
        return [points[begin : begin + step] for begin in range(0, max(len(points), 1), step)]

    def _value(self, points: np.ndarray) -> np.ndarray:
        powers = monomials(points, self.value_parts)
        return sum((powers[k] @ part for k, part in self.value_parts.items()), start=np.zeros(len(points)))

    def _gradient(self, points: np.ndarray) -> np.ndarray:
        return sum(self.gradient_parts(points).values(), start=np.zeros(points.shape))

    def _fields(self, points: np.ndarray, what: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Exact fields; without the plant the expansion's g1 where that is constant, and its g2."""
        if self.problem is not None:
            return self.problem.fields(points)
        constant = {"g1": self.expansion.g1_parts, "g2": self.expansion.g2_parts}.get(what, {})
        if set(constant) == {0} or what == "g2":
            return self.expansion.fields(points)
        raise InvalidInput(
            "The exact plant is not known to this solution.",
            f"{what} needs it; the file it was loaded from holds the expansion only",
            "load_solution(path, problem=…), or law_polynomial() for the law to the degree of V",
        )
