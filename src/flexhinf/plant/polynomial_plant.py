"""A plant whose fields are polynomials: what every expansion ends in, and what can be given by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.notebook import Summarised, names_text
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import evaluate, monomials
from flexhinf.polynomial.basis import from_kronecker
from flexhinf.validation import checked_array, checked_names, distinct, read_only, real_array, value_text

_HIGHEST = 200  # degree of a monomial, as for the synthesis
_MOST = 200_000_000  # coefficients of one part, zeros included: 1.6 GB
_REST = 1e-9  # |f(x*)| up to this, relative to its row of the Jacobian or to one, is rounding


def checked_r2(r2: Any, rounding: float = 1e-12, least: float = 0.0) -> np.ndarray:
    """R2 as a symmetric positive definite matrix (m, m).

    The asymmetry allowed is `rounding` of an entry and `least` of the largest one.
    """
    given, r2 = r2, np.atleast_2d(real_array(r2))
    if r2.ndim != 2 or r2.shape[0] != r2.shape[1] or not r2.size or not np.isfinite(r2).all():
        found = f"expected real numbers of shape (m, m), m >= 1, got {value_text(given)}"
        raise InvalidInput("R2 is not a finite square matrix.", found, "R2 = lᵀl > 0")
    half = (r2 + r2.T) / 2
    eigenvalues, asymmetry = np.linalg.eigvalsh(half), np.abs(r2 - r2.T).max()
    if not np.allclose(r2, r2.T, rtol=rounding, atol=least * np.abs(r2).max()) or eigenvalues[0] <= 0:
        raise InvalidInput(
            "R2, the effort penalty, is not symmetric positive definite.",
            f"eigenvalues of its symmetric part {eigenvalues.tolist()}, asymmetry {asymmetry:.3g}",
            "every input needs a positive price, for example effort=10",
        )
    return half


def _numbers(name: str, given: Any) -> np.ndarray:
    try:
        return real_array(given, strict=True)
    except ValueError:
        found = f"expected an array of real numbers, got {value_text(given)}"
        what = f"A coefficient of {name} is not made of numbers."
        raise InvalidInput(what, found, "rows of equal length") from None


def parts_from_input(name: str, given: Any, n: int) -> dict[int, np.ndarray]:
    """Parts of g1 or g2: a constant matrix (n, inputs), or a mapping {exponents: (n, inputs)}."""
    if isinstance(given, Mapping):
        return parts_from_mapping(name, given, n, 2)
    matrix = _numbers(name, given)
    if matrix.ndim != 2:
        raise InvalidInput(
            f"{name} is not a matrix.",
            f"expected shape ({n}, inputs), got {matrix.shape}",
            f"a column per input: np.reshape({name}, ({n}, 1)) for one input",
        )
    return {0: matrix[:, :, None]}


def parts_from_mapping(name: str, given: Any, n: int, axes: int) -> dict[int, np.ndarray]:
    """Gather {exponents: coefficient} by degree; `axes` is the number of axes of one coefficient."""
    if not isinstance(given, Mapping) or not given:
        raise InvalidInput(
            f"{name} is not a mapping of monomials.",
            f"expected {{exponents: coefficients}} with at least one entry, got {type(given).__name__}",
            "keys are tuples of exponents, one per state",
        )
    values = [_numbers(name, value) for value in given.values()]
    shape = values[0].shape
    by_degree: dict[int, tuple[list[list[int]], list[np.ndarray]]] = {}
    for key, value in zip(given, values, strict=True):
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
                f"expected {axes} axes, shape {shape} as in the first entry, got {value.shape} at {key}",
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
        tuples, coefficients = by_degree.setdefault(degree, ([], []))
        tuples.append([i for i, e in enumerate(key) for _ in range(int(e))])
        coefficients.append(value)
    parts = {}
    for degree, (tuples, coefficients) in by_degree.items():
        part = np.zeros((*shape, basis.count(n, degree)))
        ranks = basis.rank(n, np.array(tuples, dtype=np.int64).reshape(len(tuples), degree))
        part[..., ranks] = np.moveaxis(np.array(coefficients), 0, -1)
        parts[degree] = part
    return parts


def checked_parts(
    name: str, parts: dict[int, np.ndarray], n: int, shape: tuple[int | None, ...], lowest: int
) -> dict[int, np.ndarray]:
    """Shapes and finiteness; zero parts dropped; the lowest degree always present."""
    if not parts:
        raise InvalidInput(f"{name} has no coefficients.", "expected at least one degree", "give zeros")
    lead = np.shape(next(iter(parts.values())))[:-1]
    if n < 1:
        raise InvalidInput("The plant has no states.", "expected n >= 1, got 0", "one row of f per state")
    fits = len(lead) == len(shape) and all(want in (None, got) for want, got in zip(shape, lead, strict=True))
    checked: dict[int, np.ndarray] = {}
    for degree, given in sorted(parts.items()):
        part = np.ascontiguousarray(real_array(given))
        sizes = ("any" if size is None else size for size in (lead if fits else shape))
        expected = (*sizes, basis.count(n, degree))
        if not fits or part.shape != expected:
            raise InvalidInput(
                f"{name} does not fit the plant (n = {n} states).",
                f"expected shape {expected} at degree {degree}, got {part.shape}",
                "f has n rows; g1 and g2 have n rows and one column per input; R2 is (inputs, inputs)",
            )
        if not np.isfinite(part).all():
            what = f"{name} has a coefficient that is not finite."
            raise InvalidInput(what, f"at degree {degree}", "check the parameters")
        if degree == lowest or part.any():
            checked[degree] = part
    if lowest not in checked:
        checked[lowest] = np.zeros((*lead, basis.count(n, lowest)))
    return dict(sorted(checked.items()))


def check_rest(name: str, parts: dict[int, np.ndarray], rows: tuple[str, ...]) -> None:
    """f(x*) = 0 and h(x*) = 0 up to rounding; the constant part is then dropped."""
    constant = parts.pop(0, None)
    if constant is None:
        return
    offset = np.abs(constant[:, 0])
    excess = offset - _REST * np.maximum(1.0, np.abs(parts[1]).max(axis=1))
    worst = int(np.argmax(excess))
    if excess[worst] > 0:
        what = "The plant is not in equilibrium" if name == "f" else "The penalty does not vanish"
        raise InvalidInput(
            f"{what} at the operating point.",
            f"expected {name} = 0 there, got {constant[worst, 0]:.6g} in {rows[worst]}",
            "an operating point that is an equilibrium, and penalties measured from it",
        )


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
        first = next(iter(f), None) if isinstance(f, Mapping) else None
        n = max(1, len(first)) if isinstance(first, tuple) else 1
        made = PolynomialPlant.from_parts(
            n,
            parts_from_mapping("f", f, n, 1),
            parts_from_input("g1", g1, n),
            parts_from_input("g2", g2, n),
            parts_from_mapping("h", h, n, 1),
            r2,
            state_names,
            operating_point,
            input_names,
            operating_input,
        )
        vars(self).update(vars(made))

    @classmethod
    def from_parts(
        cls, n: int, f: Mapping[int, np.ndarray], g1: Mapping[int, np.ndarray], g2: Mapping[int, np.ndarray],
        h: Mapping[int, np.ndarray], r2: Any, state_names: Sequence[str] | None = None, operating_point: Any = None,
        input_names: Sequence[str] | None = None, operating_input: Any = None,
    ) -> PolynomialPlant:  # fmt: skip
        """The same from homogeneous parts: degree → monomial coefficients along the last axis.

        f and h are (n, count(n, degree)) and (s, count(n, degree)), g1 and g2 (n, md, count) and (n, m, count). A part
        of degree 0 of f and h is the value at the operating point; it must vanish up to rounding.
        """
        r2 = checked_r2(r2)
        signals = (
            ("state", "x", state_names, operating_point, n),
            ("input", "u", input_names, operating_input, len(r2)),
        )
        names, points = [], []
        for kind, letter, stated, point, count in signals:
            own = [f"{letter}{i + 1}" for i in range(count)]
            names.append(checked_names(f"The {kind}s", own if stated is None else stated))
            if len(names[-1]) != count:
                raise InvalidInput(
                    f"The number of {kind} names is not the number of {kind}s.",
                    f"expected {count} names, got {len(names[-1])}: {', '.join(names[-1])}",
                    f"one name per {kind}, in the order of {letter}",
                )
            distinct(f"The {kind}", names[-1])
            what, expected = (
                f"The operating point does not fit the plant's {kind}s.",
                f"{count} finite numbers",
            )
            point = np.zeros(count) if point is None else point
            points.append(checked_array(what, point, (count,), expected, "leave it out for the origin"))
        distinct("Of states and inputs, the name", (*names[0], *names[1]))
        parts = {
            "f_parts": checked_parts("f", dict(f), n, (n,), 1),
            "g1_parts": checked_parts("g1", dict(g1), n, (n, None), 0),
            "g2_parts": checked_parts("g2", dict(g2), n, (n, len(r2)), 0),
            "h_parts": checked_parts("h", dict(h), n, (None,), 1),
        }
        check_rest("f", parts["f_parts"], names[0])
        check_rest("h", parts["h_parts"], tuple(f"z{i + 1}" for i in range(parts["h_parts"][1].shape[0])))
        own_names = {"state_names": names[0], "input_names": names[1]}
        own_points = {"operating_point": points[0], "operating_input": points[1]}
        plant = cls.__new__(cls)
        plant.__setstate__({**parts, "r2": r2, **own_names, **own_points})
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
        names = ("f", "g1", "g2", "h")
        degrees = ", ".join(f"{name} {max(getattr(self, f'{name}_parts'))}" for name in names)
        return {
            "states": names_text(self.state_names),
            "inputs": names_text(self.input_names),
            "disturbances": str(disturbances),
            "penalised outputs": str(outputs),
            "degrees": degrees,
        }

    def expand(self, degree: int) -> PolynomialPlant:
        """The same plant with f and h truncated after `degree`, g1 and g2 after `degree` − 1."""
        last = {"f": degree, "g1": degree - 1, "g2": degree - 1, "h": degree}
        parts = {name: getattr(self, f"{name}_parts") for name in last}
        if all(max(parts[name]) <= highest for name, highest in last.items()):
            return self
        kept = {
            name: {k: part for k, part in parts[name].items() if k <= highest}
            for name, highest in last.items()
        }
        own = ("r2", "state_names", "operating_point", "input_names", "operating_input")
        named = {name: getattr(self, name) for name in own}
        return PolynomialPlant.from_parts(len(self.state_names), **kept, **named)

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
