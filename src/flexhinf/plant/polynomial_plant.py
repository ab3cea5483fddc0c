"""A plant whose fields are polynomials: the result of every Taylor expansion, or stated by hand.

Taylor expansion of model code about a point: the code is run once on truncated polynomials.

Nothing is differenced and nothing is differentiated: the coefficients are those of the code, to rounding.
"""

# Not checked strictly: what users pass is checked.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypedDict, Unpack, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.notebook import Summarised, names_text
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import evaluate, monomials
from flexhinf.validation import checked_array, checked_names, distinct, read_only, real_array, value_text

_HIGHEST = 200  # degree of a monomial, as for the synthesis
_MOST = 200_000_000  # coefficients of one part, zeros included: 1.6 GB
#: What a problem and its expansion have in common.
OWN = ("r2", "state_names", "operating_point", "input_names", "operating_input")

_DRIFT = 1e-9  # |f(x*)| up to this, relative to its row of the Jacobian or to one, is rounding


class Sparse(Protocol):
    """A matrix of `scipy.sparse`."""

    def toarray(self) -> np.ndarray:
        """As an array."""
        ...


class PointNames(TypedDict, total=False):
    """Names and operating point of a `PolynomialPlant`, those that are stated."""

    state_names: Sequence[str]
    operating_point: ArrayLike
    input_names: Sequence[str]
    operating_input: ArrayLike


def checked_r2(r2: ArrayLike, rounding: float = 1e-12, atol: float = 0.0) -> np.ndarray:
    """R2 as a symmetric positive definite matrix (m, m).

    The asymmetry allowed is `rounding` of an entry and `atol` of the largest one.
    """
    original, r2 = r2, np.atleast_2d(real_array(r2))
    if r2.ndim != 2 or r2.shape[0] != r2.shape[1] or not r2.size or not np.isfinite(r2).all():
        raise InvalidInput(
            "R2 is not a finite square matrix.",
            f"expected real numbers of shape (m, m), m >= 1, got {value_text(original)}",
            "R2 = lᵀl > 0",
        )
    half = (r2 + r2.T) / 2
    eigenvalues, asymmetry = np.linalg.eigvalsh(half), np.abs(r2 - r2.T).max()
    if not np.allclose(r2, r2.T, rtol=rounding, atol=atol * np.abs(r2).max()) or eigenvalues[0] <= 0:
        raise InvalidInput(
            "R2, the effort penalty, is not symmetric positive definite.",
            f"eigenvalues of its symmetric part {eigenvalues.tolist()}, asymmetry {asymmetry:.3g}",
            "every input needs a positive price, for example effort=10",
        )
    return half


def parts_by_degree(
    name: str, coefficients: Mapping[tuple[int, ...], ArrayLike] | ArrayLike, n: int, axes: int
) -> dict[int, np.ndarray]:
    """Gather {exponents: coefficient} by degree; `axes` is the number of axes of one coefficient.

    Two axes are those of g1 and g2, which may also be a constant matrix (n, inputs).
    """
    if axes == 2 and not isinstance(coefficients, Mapping):
        matrix = real_array(coefficients)
        if matrix.ndim != 2:
            raise InvalidInput(
                f"{name} is not a matrix.",
                f"expected numbers of shape ({n}, inputs), got shape {matrix.shape}: {value_text(coefficients)}",
                f"a column per input: np.reshape({name}, ({n}, 1)) for one input",
            )
        return {0: matrix[:, :, None]}
    if not isinstance(coefficients, Mapping) or not coefficients:
        raise InvalidInput(
            f"{name} is not a mapping of monomials.",
            f"expected {{exponents: coefficients}} with at least one entry, got {type(coefficients).__name__}",
            "keys are tuples of exponents, one per state",
        )
    values = [real_array(value) for value in coefficients.values()]
    shape = values[0].shape
    parts: dict[int, np.ndarray] = {}
    for key, value in zip(coefficients, values, strict=True):
        whole = isinstance(key, tuple) and not any(isinstance(entry, bool) for entry in key)
        if not whole or len(key) != n or not all(isinstance(e, (int, np.integer)) and e >= 0 for e in key):
            raise InvalidInput(
                f"A key of {name} is not an exponent vector.",
                f"expected {n} integers ≥ 0, got {value_text(key)}",
                "(2, 0, 1) stands for x1² x3",
            )
        if value.shape != shape or value.ndim != axes:
            raise InvalidInput(
                f"The coefficients of {name} have different or wrong shapes.",
                f"expected numbers on {axes} axes, shape {shape} as in the first entry, got "
                f"shape {value.shape}: {value_text(coefficients[key], 60)} at {key}",
                f"one array per monomial, as many rows as {name} has",
            )
        degree = int(sum(key))
        if degree > _HIGHEST or basis.count(n, degree) * int(np.prod(shape)) > _MOST:
            raise InvalidInput(
                f"A monomial of {name} has too high a degree.",
                f"expected at most degree {_HIGHEST} and {_MOST:.0e} coefficients of one degree, got degree "
                f"{value_text(degree, 40)} in {n} {'state' if n == 1 else 'states'}",
                "a lower degree: V of degree d takes f through degree d − 1",
            )
        part = parts.setdefault(degree, np.zeros((*shape, basis.count(n, degree))))
        variables = np.repeat(np.arange(n), [int(exponent) for exponent in key])
        part[..., basis.rank(n, variables[None])[0]] = value
    return parts


def checked_parts(
    name: str,
    parts: dict[int, np.ndarray],
    n: int,
    shape: tuple[int | None, ...],
    lowest: int,
    rows: Sequence[str] = (),
) -> dict[int, np.ndarray]:
    """The parts with checked shapes and finite numbers, without zero parts of other degrees than the lowest.

    `lowest` is 1 for f and h, whose constant part must vanish up to rounding and is dropped. `rows`: names of f's rows.
    """
    refuse_if(not parts, f"{name} has no coefficients.", "expected at least one degree", "give zeros")
    lead = np.shape(next(iter(parts.values())))[:-1]
    refuse_if(n < 1, "The plant has no states.", "expected n >= 1, got 0", "one row of f per state")
    fits = len(lead) == len(shape) and all(want in (None, got) for want, got in zip(shape, lead, strict=True))
    checked: dict[int, np.ndarray] = {}
    for degree, stated in sorted({lowest: np.zeros((*lead, basis.count(n, lowest))), **parts}.items()):
        part = np.ascontiguousarray(real_array(stated))
        expected = (
            *("any" if size is None else size for size in (lead if fits else shape)),
            basis.count(n, degree),
        )
        refuse_if(
            not fits or part.shape != expected,
            f"{name} does not fit the plant (n = {n} states).",
            f"expected shape {expected} at degree {degree}, got {part.shape}",
            "f has n rows; g1 and g2 have n rows and one column per input; R2 is (inputs, inputs)",
        )
        refuse_if(
            not np.isfinite(part).all(),
            f"{name} has a coefficient that is not finite.",
            f"at degree {degree}",
            "check the parameters",
        )
        if degree == lowest or part.any():
            checked[degree] = part
    if lowest and 0 in checked:
        constant = checked.pop(0)[:, 0]
        excess = np.abs(constant) - _DRIFT * np.maximum(1.0, np.abs(checked[1]).max(axis=1))
        worst = int(np.argmax(excess))
        if excess[worst] > 0:
            what = "The plant is not in equilibrium" if rows else "The penalty does not vanish"
            raise InvalidInput(
                f"{what} at the operating point.",
                f"expected {name} = 0 there, got {constant[worst]:.6g} in "
                f"{rows[worst] if rows else f'z{worst + 1}'}",
                "an operating point that is an equilibrium, and penalties measured from it",
            )
    return checked


@runtime_checkable
class Problem(Protocol):
    """A generalised plant, Eq. (3), in deviations from an operating point.

    ẋ = f(x) + g1(x) d + g2(x) u,   z = (h(x), l(x) u),   lᵀl = R2,   f(0) = 0, h(0) = 0::

            d ──►┌───────┐──► z
                 │ plant │
            u ──►└───────┘──► x
             ▲                │
             └──── law ◄──────┘

    """

    @property
    def state_names(self) -> tuple[str, ...]:
        """One name per state."""
        ...

    @property
    def operating_point(self) -> np.ndarray:
        """The point deviations are measured from, shape (n,)."""
        ...

    @property
    def r2(self) -> np.ndarray:
        """Weight of the input, shape (m, m)."""
        ...

    def expand(self, degree: int) -> PolynomialPlant:
        """Taylor expansion: f and h through `degree`, g1 and g2 through `degree` − 1."""
        ...

    def fields(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Exact f (N, n), g1 (N, n, md), g2 (N, n, m) and h (N, s) at deviations `x` (N, n)."""
        ...


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
    input_names : sequence of str, optional
        Defaults to u1 … um.
    operating_point, operating_input : array_like, shapes (n,) and (m,), optional
        The point the deviations are measured from, and the input there (only kept, not used).

    Attributes
    ----------
    f_parts, g1_parts, g2_parts, h_parts : dict degree → ndarray
        Monomial coefficients along the last axis, in the order of `polynomial.basis.indices`:
        (n, count), (n, md, count), (n, m, count), (s, count). Degrees whose part is zero are left out,
        except degree 1 of f and h and degree 0 of g1 and g2.

    Raises InvalidInput: wrong shapes, non-finite numbers, R2 not positive definite, f or h not zero at the
    operating point.

    Examples
    --------
    Van der Pol's oscillator, ẍ = (1 − x²)ẋ − x + u + d:

    >>> import flexhinf as fh
    >>> f = {(0, 1): (1.0, 1.0), (1, 0): (0.0, -1.0), (2, 1): (0.0, -1.0)}
    >>> column = [[0.0], [1.0]]
    >>> plant = fh.PolynomialPlant(f, column, column, {(1, 0): (1.0,)}, 1.0)
    >>> fh.smallest_gamma(plant) > 1.0
    True
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
        f: Mapping[tuple[int, ...], ArrayLike],
        g1: Mapping[tuple[int, ...], ArrayLike] | ArrayLike,
        g2: Mapping[tuple[int, ...], ArrayLike] | ArrayLike,
        h: Mapping[tuple[int, ...], ArrayLike],
        r2: ArrayLike,
        *,
        state_names: Sequence[str] | None = None,
        operating_point: ArrayLike | None = None,
        input_names: Sequence[str] | None = None,
        operating_input: ArrayLike | None = None,
    ) -> None:
        first = next(iter(f), None) if isinstance(f, Mapping) else None
        n = max(1, len(first)) if isinstance(first, tuple) else 1
        plant = PolynomialPlant.from_parts(
            n,
            parts_by_degree("f", f, n, 1),
            parts_by_degree("g1", g1, n, 2),
            parts_by_degree("g2", g2, n, 2),
            parts_by_degree("h", h, n, 1),
            r2,
            state_names,
            operating_point,
            input_names,
            operating_input,
        )
        vars(self).update(vars(plant))

    @classmethod
    def from_parts(
        cls,
        n: int,
        f: Mapping[int, np.ndarray],
        g1: Mapping[int, np.ndarray],
        g2: Mapping[int, np.ndarray],
        h: Mapping[int, np.ndarray],
        r2: ArrayLike,
        state_names: Sequence[str] | None = None,
        operating_point: ArrayLike | None = None,
        input_names: Sequence[str] | None = None,
        operating_input: ArrayLike | None = None,
    ) -> PolynomialPlant:
        """A polynomial plant from homogeneous parts: degree → monomial coefficients along the last axis.

        f and h are (n, count(n, degree)) and (s, count(n, degree)), g1 and g2 (n, md, count) and (n, m, count). A part
        of degree 0 of f and h is the value at the operating point; it must vanish up to rounding.
        """
        r2 = checked_r2(r2)
        names: list[tuple[str, ...]] = []
        points: list[np.ndarray] = []
        for kind, letter, stated, point, count in (
            ("state", "x", state_names, operating_point, n),
            ("input", "u", input_names, operating_input, len(r2)),
        ):
            own = [f"{letter}{i + 1}" for i in range(count)]
            names.append(checked_names(f"The {kind}s", own if stated is None else stated))
            if len(names[-1]) != count:
                raise InvalidInput(
                    f"The number of {kind} names is not the number of {kind}s.",
                    f"expected {count} names, got {len(names[-1])}: {', '.join(names[-1])}",
                    f"one name per {kind}, in the order of {letter}",
                )
            distinct(f"The {kind}", names[-1])
            what = f"The operating point does not fit the plant's {kind}s."
            point = np.zeros(count) if point is None else point
            points.append(checked_array(what, point, (count,), f"{count} finite numbers", "none: the origin"))
        distinct("Of states and inputs, the name", (*names[0], *names[1]))
        parts = {
            "f_parts": checked_parts("f", dict(f), n, (n,), 1, names[0]),
            "g1_parts": checked_parts("g1", dict(g1), n, (n, None), 0),
            "g2_parts": checked_parts("g2", dict(g2), n, (n, len(r2)), 0),
            "h_parts": checked_parts("h", dict(h), n, (None,), 1),
        }
        own = ("state_names", "input_names", "operating_point", "operating_input")
        plant = cls.__new__(cls)
        plant.__setstate__({**parts, "r2": r2, **dict(zip(own, (*names, *points)))})
        return plant

    @classmethod
    def from_kronecker(
        cls,
        f: Sequence[ArrayLike | Sparse],
        g1: Sequence[ArrayLike | Sparse],
        g2: Sequence[ArrayLike | Sparse],
        h: Sequence[ArrayLike | Sparse],
        r2: ArrayLike,
        **named: Unpack[PointNames],
    ) -> PolynomialPlant:
        """A polynomial plant from Kronecker coefficients, in the form of PPR and NLbalancing.

        Parameters
        ----------
        f, h : sequence of array_like or sparse, shapes (n, n^k) and (s, n^k), k = 1, 2, …
            f(x) = f[0] x + f[1] (x ⊗ x) + …, and h(x) likewise.
        g1, g2 : sequence of array_like or sparse, shapes (n, n^k md) and (n, n^k m), k = 0, 1, …
            g2(x) u = g2[0] u + g2[1] (x ⊗ u) + g2[2] (x ⊗ x ⊗ u) + …, and g1(x) d likewise.
        r2, **named
            As in `PolynomialPlant`.

        Raises InvalidInput: wrong shapes, and as `PolynomialPlant`.
        """
        return cls._from_kronecker(f, g1, g2, h, r2, named)

    @classmethod
    def _from_kronecker(
        cls, f: Any, g1: Any, g2: Any, h: Any, r2: ArrayLike, named: PointNames
    ) -> PolynomialPlant:  # dense matrices or sparse ones, of which NumPy has no types
        refuse_if(
            not (len(f) and len(g1) and len(g2) and len(h)),
            "A field has no Kronecker coefficients.",
            f"expected at least one matrix of each, got {len(f)}, {len(g1)}, {len(g2)}, {len(h)} of f, g1, g2, h",
            "f=[A, F2], g1=[B1], g2=[B2], h=[C]",
        )
        n = np.shape(f[0])[0] if np.ndim(f[0]) == 2 or hasattr(f[0], "tocoo") else 0
        if n == 0:
            raise InvalidInput(
                "f has no linear part.", f"expected f[0] of shape (n, n), got {value_text(f[0])}", "f=[A]"
            )

        def fields(matrices: Any) -> dict[int, np.ndarray]:
            columns = np.shape(matrices[0])[1] if len(np.shape(matrices[0])) == 2 else 1
            parts: dict[int, np.ndarray] = {}
            for k, matrix in enumerate(matrices):
                full = matrix.toarray() if hasattr(matrix, "toarray") else np.atleast_2d(real_array(matrix))
                parts[k] = np.stack(
                    [basis.from_kronecker(full[:, j::columns], n, k) for j in range(columns)], 1
                )
            return parts

        flow, output = ({k: basis.from_kronecker(m, n, k) for k, m in enumerate(rows, 1)} for rows in (f, h))
        return cls.from_parts(n, flow, fields(g1), fields(g2), output, r2, **named)

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(read_only(state))  # copies share their arrays

    @property
    def size(self) -> tuple[int, int, int, int]:
        """Numbers of states, disturbances, inputs and penalised outputs (n, md, m, s)."""
        n, md, _ = self.g1_parts[0].shape
        return n, md, self.g2_parts[0].shape[1], self.h_parts[1].shape[0]

    def summary(self) -> dict[str, str]:
        """Sizes and highest degrees of the fields, for ``repr``."""
        return {
            "states": names_text(self.state_names),
            "inputs": names_text(self.input_names),
            "disturbances": str(self.size[1]),
            "penalised outputs": str(self.size[3]),
            "degrees": ", ".join(
                f"{name} {max(getattr(self, f'{name}_parts'))}" for name in ("f", "g1", "g2", "h")
            ),
        }

    def expand(self, degree: int) -> PolynomialPlant:
        """The same plant with f and h truncated after `degree`, g1 and g2 after `degree` − 1."""
        last = {"f": degree, "g1": degree - 1, "g2": degree - 1, "h": degree}
        parts = {name: getattr(self, f"{name}_parts") for name in last}
        if all(max(parts[name]) <= highest for name, highest in last.items()):
            return self
        kept = {name: {k: part for k, part in parts[name].items() if k <= top} for name, top in last.items()}
        return PolynomialPlant.from_parts(self.size[0], **kept, **{name: getattr(self, name) for name in OWN})

    @property
    def input_matrix_is_constant(self) -> bool:
        """Whether g2 does not depend on the state."""
        return set(self.g2_parts) == {0}

    def input_matrix(self, x: Elements) -> Elements:
        """g2 (n, m) at one deviation x (n,), on any element."""
        powers = monomials(np.asarray(x)[None, :], tuple(self.g2_parts))
        return np.asarray(sum(part @ powers[k][0] for k, part in self.g2_parts.items()))

    def fields(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """f (N, n), g1 (N, n, md), g2 (N, n, m) and h (N, s) at the deviations `x` (N, n)."""
        x = np.asarray(x, dtype=float)
        f, g1, g2, h = (evaluate(p, x) for p in (self.f_parts, self.g1_parts, self.g2_parts, self.h_parts))
        return f, g1, g2, h
