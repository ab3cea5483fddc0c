"""Coefficients given by hand: gathered into homogeneous parts, or refused with what is wrong."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.polynomial import basis
from flexhinf.untrusted import distinct, real_array, value_text

_HIGHEST = 200  # degree of a monomial, as for the synthesis
_MOST = 200_000_000  # coefficients of one part, zeros included: 1.6 GB
_REST = 1e-9  # |f(x*)| up to this, relative to its row of the Jacobian or to one, is rounding


def checked_names(kind: str, given: Sequence[str] | None, letter: str, count: int) -> tuple[str, ...]:
    """One name per signal, all distinct; numbered letters by default."""
    if given is None:
        return tuple(f"{letter}{i + 1}" for i in range(count))
    names: tuple[Any, ...] = (
        tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (given,)
    )
    if not all(isinstance(name, str) for name in names):
        raise InvalidInput(
            f"A {kind} name is not a text.",
            f"expected {count} texts, got {value_text(given)}",
            f"'{letter}1'",
        )
    if len(names) != count:
        raise InvalidInput(
            f"The number of {kind} names is not the number of {kind}s.",
            f"expected {count} names, got {len(names)}: {', '.join(names)}",
            f"one name per {kind}, in the order of {letter}",
        )
    distinct(f"The {kind}", names)
    return names


def checked_point(kind: str, given: Any, count: int) -> np.ndarray:
    """Finite coordinates (count,); the origin by default."""
    point = np.zeros(count) if given is None else real_array(given)
    if point.shape != (count,) or not np.isfinite(point).all():
        raise InvalidInput(
            f"The operating point does not fit the plant's {kind}s.",
            f"expected {count} finite numbers, got {value_text(given)}",
            "leave it out for the origin",
        )
    return point


def checked_r2(r2: Any) -> np.ndarray:
    """R2 as a symmetric positive definite matrix (m, m)."""
    given, r2 = r2, np.atleast_2d(real_array(r2))
    if r2.ndim != 2 or r2.shape[0] != r2.shape[1] or not r2.size or not np.isfinite(r2).all():
        raise InvalidInput(
            "R2 is not a finite square matrix.",
            f"expected real numbers of shape (m, m), m >= 1, got {value_text(given)}",
            "R2 = lᵀl > 0",
        )
    if not np.allclose(r2, r2.T, rtol=1e-12, atol=0) or np.linalg.eigvalsh(r2)[0] <= 0:
        raise InvalidInput(
            "R2 is not symmetric positive definite.",
            f"eigenvalues of its symmetric part {np.linalg.eigvalsh((r2 + r2.T) / 2).tolist()}, "
            f"asymmetry {np.abs(r2 - r2.T).max():.3g}",
            "every input needs a positive price",
        )
    return (r2 + r2.T) / 2


def _numbers(name: str, given: Any) -> np.ndarray:
    try:
        return real_array(given, strict=True)
    except ValueError:
        raise InvalidInput(
            f"A coefficient of {name} is not made of numbers.",
            f"expected an array of real numbers, got {value_text(given)}",
            "rows of equal length",
        ) from None


def _is_exponent(given: Any) -> bool:
    return isinstance(given, (int, np.integer)) and not isinstance(given, bool) and bool(given >= 0)


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
        if not isinstance(key, tuple) or len(key) != n or not all(map(_is_exponent, key)):
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
        _check_degree(name, key, shape)
        tuples, coefficients = by_degree.setdefault(int(sum(key)), ([], []))
        tuples.append([i for i, e in enumerate(key) for _ in range(int(e))])
        coefficients.append(value)
    parts = {}
    for degree, (tuples, coefficients) in by_degree.items():
        part = np.zeros((*shape, basis.count(n, degree)))
        ranks = basis.rank(n, np.array(tuples, dtype=np.int64).reshape(len(tuples), degree))
        part[..., ranks] = np.moveaxis(np.array(coefficients), 0, -1)
        parts[degree] = part
    return parts


def _check_degree(name: str, key: tuple[int, ...], shape: tuple[int, ...]) -> None:
    n, degree = len(key), int(sum(key))
    if degree > _HIGHEST or basis.count(n, degree) * int(np.prod(shape)) > _MOST:
        raise InvalidInput(
            f"A monomial of {name} has too high a degree.",
            f"expected at most degree {_HIGHEST} and {_MOST:.0e} coefficients of one degree, got degree "
            f"{value_text(degree, 40)} in {n} {'state' if n == 1 else 'states'}",
            "a lower degree: V of degree d takes f through degree d − 1",
        )


def checked_parts(
    name: str, parts: dict[int, np.ndarray], n: int, shape: tuple[int | None, ...], lowest: int
) -> dict[int, np.ndarray]:
    """Shapes and finiteness; zero parts dropped; the lowest degree always present."""
    if not parts:
        raise InvalidInput(
            f"{name} has no coefficients.", "expected at least one degree, got none", "give zeros"
        )
    lead = np.shape(next(iter(parts.values())))[:-1]
    if n < 1:
        raise InvalidInput("The plant has no states.", "expected n >= 1, got 0", "one row of f per state")
    fits = len(lead) == len(shape) and all(want in (None, got) for want, got in zip(shape, lead, strict=True))
    checked: dict[int, np.ndarray] = {}
    for degree, given in sorted(parts.items()):
        part = np.ascontiguousarray(real_array(given))
        expected = (
            *("any" if s is None else s for s in (shape if not fits else lead)),
            basis.count(n, degree),
        )
        if not fits or part.shape != expected:
            raise InvalidInput(
                f"{name} does not fit the plant (n = {n} states).",
                f"expected shape {expected} at degree {degree}, got {part.shape}",
                "f has n rows; g1 and g2 have n rows and one column per input; R2 is (inputs, inputs)",
            )
        if not np.isfinite(part).all():
            raise InvalidInput(
                f"{name} has a coefficient that is not finite.", f"at degree {degree}", "check the parameters"
            )
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
