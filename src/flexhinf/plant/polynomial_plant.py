"""A plant whose fields are polynomials: what every expansion ends in, and what can be given by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.notebook import Summarised, names_text
from flexhinf.plant.coefficients import (
    check_rest,
    checked_names,
    checked_parts,
    checked_point,
    checked_r2,
    parts_from_input,
    parts_from_mapping,
)
from flexhinf.polynomial.algebra import evaluate, monomials
from flexhinf.polynomial.kronecker import from_kronecker
from flexhinf.untrusted import distinct, read_only, real_array, value_text


@dataclass(frozen=True, init=False, eq=False, repr=False)
class PolynomialPlant(Summarised):
    """ẋ = f(x) + g1(x) d + g2(x) u, z = (h(x), l u), lᵀl = R2, with polynomial f, g1, g2 and h.

    Parameters
    ----------
    f : mapping {exponents: (n,)}
        Coefficients of ẋ by monomial, degree 1 included. Keys are tuples of n exponents.
    g1 : ndarray (n, md), or mapping {exponents: (n, md)}
        Where the disturbance enters; the constant term has the key (0, …, 0).
    g2 : ndarray (n, m), or mapping {exponents: (n, m)}
        Where the input enters.
    h : mapping {exponents: (s,)}
        Penalised outputs.
    r2 : array_like, shape (m, m)
        Weight of the input, symmetric positive definite.
    state_names : sequence of str, optional
        Defaults to x1 … xn.
    operating_point : array_like, shape (n,), optional
        The point the deviations are measured from (only kept, not used).
    input_names : sequence of str, optional
        Defaults to u1 … um.
    operating_input : array_like, shape (m,), optional
        The input at the operating point (only kept, not used).

    Attributes
    ----------
    f_parts, g1_parts, g2_parts, h_parts : dict degree → ndarray
        Monomial coefficients along the last axis, in the order of `polynomial.basis.indices`:
        (n, count), (n, md, count), (n, m, count), (s, count). Degrees whose part is zero are left out,
        except degree 1 of f and h and degree 0 of g1 and g2.

    Raises
    ------
    InvalidInput
        Wrong shapes, non-finite numbers, R2 not positive definite, f or h not zero at the operating point.
    """

    f_parts: dict[int, np.ndarray]
    g1_parts: dict[int, np.ndarray]
    g2_parts: dict[int, np.ndarray]
    h_parts: dict[int, np.ndarray]
    r2: np.ndarray
    state_names: tuple[str, ...]
    operating_point: np.ndarray
    input_names: tuple[str, ...]
    operating_input: np.ndarray

    def __init__(
        self,
        f: Mapping[tuple[int, ...], Any],
        g1: Any,
        g2: Any,
        h: Mapping[tuple[int, ...], Any],
        r2: Any,
        *,
        state_names: Sequence[str] | None = None,
        operating_point: Any = None,
        input_names: Sequence[str] | None = None,
        operating_input: Any = None,
    ) -> None:
        if not isinstance(f, Mapping) or not f:
            raise InvalidInput(
                "The plant's f is not a mapping of monomials.",
                f"expected {{exponents: (n,)}} with at least one entry, got {type(f).__name__}",
                "for example f={(1, 0): [0, -1], (0, 1): [1, 0]} for an oscillator",
            )
        first = next(iter(f))
        n = len(first) if isinstance(first, tuple) else 1
        if n == 0:
            raise InvalidInput(
                "The plant has no states.",
                "expected keys of one exponent per state, got ()",
                "f={(1,): [-1]}",
            )
        self._set(
            n,
            f=parts_from_mapping("f", f, n, 1),
            g1=parts_from_input("g1", g1, n),
            g2=parts_from_input("g2", g2, n),
            h=parts_from_mapping("h", h, n, 1),
            r2=r2,
            state_names=state_names,
            operating_point=operating_point,
            input_names=input_names,
            operating_input=operating_input,
        )

    @classmethod
    def from_parts(
        cls,
        n: int,
        f: Mapping[int, np.ndarray],
        g1: Mapping[int, np.ndarray],
        g2: Mapping[int, np.ndarray],
        h: Mapping[int, np.ndarray],
        r2: Any,
        *,
        state_names: Sequence[str] | None = None,
        operating_point: Any = None,
        input_names: Sequence[str] | None = None,
        operating_input: Any = None,
    ) -> PolynomialPlant:
        """The same from homogeneous parts: degree → monomial coefficients along the last axis.

        Parameters
        ----------
        n : int
            Number of states.
        f, h : mapping degree → ndarray, shapes (n, count(n, degree)) and (s, count(n, degree))
            A part of degree 0 is the value at the operating point; it must vanish up to rounding.
        g1, g2 : mapping degree → ndarray, shapes (n, md, count(n, degree)) and (n, m, count(n, degree))
        """
        plant = cls.__new__(cls)
        parts = {"f": dict(f), "g1": dict(g1), "g2": dict(g2), "h": dict(h)}
        plant._set(
            n,
            **parts,
            r2=r2,
            state_names=state_names,
            operating_point=operating_point,
            input_names=input_names,
            operating_input=operating_input,
        )
        return plant

    @classmethod
    def from_kronecker(
        cls, f: Sequence[Any], g1: Sequence[Any], g2: Sequence[Any], h: Sequence[Any], r2: Any, **named: Any
    ) -> PolynomialPlant:
        """The same from Kronecker coefficients, as PPR and NLbalancing have them.

        Parameters
        ----------
        f, h : sequence of array_like or sparse, shapes (n, n^k) and (s, n^k), k = 1, 2, …
            f(x) = f[0] x + f[1] (x ⊗ x) + …, and h(x) likewise.
        g1, g2 : sequence of array_like or sparse, shapes (n, n^k md) and (n, n^k m), k = 0, 1, …
            g2(x) u = g2[0] u + g2[1] (x ⊗ u) + g2[2] (x ⊗ x ⊗ u) + …, and g1(x) d likewise.
        r2, **named
            As in `PolynomialPlant`.

        Raises
        ------
        InvalidInput
            Wrong shapes, and as `PolynomialPlant`.
        """
        if not (len(f) and len(g1) and len(g2) and len(h)):
            raise InvalidInput(
                "A field has no Kronecker coefficients.",
                f"expected at least one matrix of each, got {len(f)}, {len(g1)}, {len(g2)}, {len(h)} of f, g1, g2, h",
                "f=[A, F2], g1=[B1], g2=[B2], h=[C]",
            )
        n = np.shape(f[0])[0] if np.ndim(f[0]) == 2 or hasattr(f[0], "tocoo") else 0
        if n == 0:
            raise InvalidInput(
                "f has no linear part.", f"expected f[0] of shape (n, n), got {value_text(f[0])}", "f=[A]"
            )

        def fields(matrices: Sequence[Any]) -> dict[int, np.ndarray]:
            columns = np.shape(matrices[0])[1] if len(np.shape(matrices[0])) == 2 else 1
            parts = {}
            for k, matrix in enumerate(matrices):
                full = matrix.toarray() if hasattr(matrix, "toarray") else np.atleast_2d(real_array(matrix))
                each = [from_kronecker(full[:, j::columns], n, k) for j in range(columns)]
                parts[k] = np.stack(each, axis=1)
            return parts

        flow, output = (
            {k: from_kronecker(matrix, n, k) for k, matrix in enumerate(matrices, 1)} for matrices in (f, h)
        )
        return cls.from_parts(n, flow, fields(g1), fields(g2), output, r2, **named)

    def _set(
        self,
        n: int,
        f: dict[int, np.ndarray],
        g1: dict[int, np.ndarray],
        g2: dict[int, np.ndarray],
        h: dict[int, np.ndarray],
        r2: Any,
        state_names: Sequence[str] | None,
        operating_point: Any,
        input_names: Sequence[str] | None,
        operating_input: Any,
    ) -> None:
        r2 = checked_r2(r2)
        names = checked_names("state", state_names, "x", n)
        inputs = checked_names("input", input_names, "u", len(r2))
        distinct("Of states and inputs, the name", (*names, *inputs))
        parts = {
            "f": checked_parts("f", f, n, (n,), 1),
            "g1": checked_parts("g1", g1, n, (n, None), 0),
            "g2": checked_parts("g2", g2, n, (n, len(r2)), 0),
            "h": checked_parts("h", h, n, (None,), 1),
        }
        check_rest("f", parts["f"], names)
        check_rest("h", parts["h"], tuple(f"z{i + 1}" for i in range(parts["h"][1].shape[0])))
        point = checked_point("state", operating_point, n)
        point_input = checked_point("input", operating_input, len(r2))
        named = {f"{name}_parts": value for name, value in parts.items()}
        points = {"operating_point": point, "operating_input": point_input}
        self.__setstate__({**named, "r2": r2, "state_names": names, "input_names": inputs, **points})

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over attributes; copies share their arrays, so nobody may write them."""
        vars(self).update(read_only(state))

    @property
    def size(self) -> tuple[int, int, int, int]:
        """Numbers of states, disturbances, inputs and penalised outputs (n, md, m, s)."""
        n, md, _ = self.g1_parts[0].shape
        return n, md, self.g2_parts[0].shape[1], self.h_parts[1].shape[0]

    def summary(self) -> dict[str, str]:
        """Sizes and highest degrees of the fields, for ``repr``."""
        _, disturbances, _, outputs = self.size
        degrees = ", ".join(
            f"{name} {max(getattr(self, f'{name}_parts'))}" for name in ("f", "g1", "g2", "h")
        )
        return {
            "states": names_text(self.state_names),
            "inputs": names_text(self.input_names),
            "disturbances": str(disturbances),
            "penalised outputs": str(outputs),
            "degrees": degrees,
        }

    def expand(self, degree: int) -> PolynomialPlant:
        """The same plant with f and h truncated after `degree`, g1 and g2 after `degree` − 1."""
        kept, last = {}, (("f", degree), ("g1", degree - 1), ("g2", degree - 1), ("h", degree))
        if all(max(getattr(self, f"{name}_parts")) <= highest for name, highest in last):
            return self
        for name, highest in last:
            parts = getattr(self, f"{name}_parts")
            kept[name] = {k: part for k, part in parts.items() if k <= highest}
        return PolynomialPlant.from_parts(
            len(self.state_names),
            **kept,
            r2=self.r2,
            state_names=self.state_names,
            operating_point=self.operating_point,
            input_names=self.input_names,
            operating_input=self.operating_input,
        )

    @property
    def input_matrix_is_constant(self) -> bool:
        """Whether g2 does not depend on the state."""
        return set(self.g2_parts) == {0}

    def input_matrix(self, x: Any) -> Any:
        """g2 (n, m) at one deviation x (n,), on any element."""
        powers = monomials(np.asarray(x)[None, :], tuple(self.g2_parts))
        return sum(part @ powers[k][0] for k, part in self.g2_parts.items())

    def fields(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """f (N, n), g1 (N, n, md), g2 (N, n, m) and h (N, s) at the deviations `x` (N, n)."""
        x = np.asarray(x, dtype=float)
        f, g1, g2, h = (evaluate(p, x) for p in (self.f_parts, self.g1_parts, self.g2_parts, self.h_parts))
        return f, g1, g2, h
