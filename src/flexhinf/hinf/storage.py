"""A solution in one file: compressed NumPy archive with a version, written beside and moved into place."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.files import read_arrays, write_arrays
from flexhinf.hinf.recursion import DegreeRecord
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.polynomial_plant import PolynomialPlant, Problem
from flexhinf.polynomial.basis import count
from flexhinf.validation import checked_path

_FORMAT, _VERSION = "flexhinf solution", 1
_FIELDS = ("f", "g1", "g2", "h")
_HIGHEST = 200  # degree that a file may claim, as for `solve_hji`


def write_solution(
    path: str | os.PathLike[str],
    solution: ValueFunction,
    records: Sequence[DegreeRecord],
    condition: float,
    memory: int,
) -> None:
    """Write a value function and the record of its solve (no suffix is added); the file is whole or not there.

    Raises
    ------
    InvalidInput
        The place cannot be written.
    """
    plant = solution.expansion
    header = {
        "format": _FORMAT,
        "version": _VERSION,
        "digest": "sha256",
        "gamma": repr(solution.gamma),
        "degree": solution.degree,
        "states": list(plant.state_names),
        "inputs": list(plant.input_names),
        "polynomial": isinstance(solution.problem, PolynomialPlant),
        "condition": repr(condition),
        "memory": memory,
        "records": [asdict(record) for record in records],
    }
    arrays = {"P": solution.P, "r2": plant.r2, "operating_point": plant.operating_point}
    arrays["operating_input"] = plant.operating_input
    arrays |= {f"V_{k}": part for k, part in solution.value_parts.items()}
    exact = solution.problem if isinstance(solution.problem, PolynomialPlant) else plant
    for name in _FIELDS:
        arrays |= {f"{name}_{k}": part for k, part in getattr(exact, f"{name}_parts").items()}
    write_arrays(path, "solution", {"header": np.array(json.dumps(header)), **arrays})


def read_solution(path: str | os.PathLike[str], problem: Problem | None) -> dict[str, Any]:
    """The fields of an `HJISolution` by name, from a file that `write_solution` wrote.

    Raises
    ------
    InvalidInput
        Not there, not such a file, damaged, or of a newer version.
    """
    path = checked_path("The solution's file", path)
    try:
        arrays, whole = read_arrays(path)
        return _assembled(arrays, whole, problem)
    except FlexhinfError as error:
        raise _unreadable(path, error.found or error.what) from error
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise _unreadable(path, f"damaged or not such a file ({type(error).__name__})") from error


def _unreadable(path: Path, found: str) -> InvalidInput:
    return InvalidInput(
        "The solution cannot be read.",
        f"expected a {_FORMAT} file, version {_VERSION}, got {path}: {found}",
        "solve again and save; files are written by HJISolution.save",
    )


def _assembled(arrays: dict[str, np.ndarray], whole: bool, problem: Problem | None) -> dict[str, Any]:
    header = json.loads(str(arrays.pop("header")))
    if header["format"] != _FORMAT or header["version"] != _VERSION:
        raise InvalidInput("Another format.", f"{header['format']!r}, version {header['version']!r}")
    if "digest" in header and not whole:
        raise InvalidInput("Damaged.", "damaged: the digest under it is missing")
    for name, part in arrays.items():
        if part.dtype != np.float64 or not np.isfinite(part).all():
            raise InvalidInput("Wrong numbers.", f"{name} is not made of finite float64 numbers")
    states, inputs, degree, gamma = (
        header["states"],
        header["inputs"],
        header["degree"],
        float(header["gamma"]),
    )
    records, memory = tuple(_record(record, degree) for record in header["records"]), header["memory"]
    names = (
        isinstance(states, list)
        and isinstance(inputs, list)
        and all(isinstance(x, str) for x in states + inputs)
    )
    if (
        not names
        or not _is_integer(degree, 2, _HIGHEST)
        or not gamma > 0
        or not _is_integer(memory, 0, 1 << 62)
    ):
        raise InvalidInput("Wrong header.", "names, degree, gamma or memory of the header make no sense")
    if arrays["P"].shape != (len(states), len(states)):
        raise InvalidInput("Wrong shapes.", f"P does not fit {len(states)} states")
    parts = {name: _gather(arrays, name, 0, _HIGHEST) for name in _FIELDS}
    exact = PolynomialPlant.from_parts(
        len(states),
        **parts,
        r2=arrays.pop("r2"),
        state_names=states,
        operating_point=arrays.pop("operating_point"),
        input_names=inputs,
        operating_input=arrays.pop("operating_input"),
    )
    p, value = arrays.pop("P"), _gather(arrays, "V", 2, degree)
    if arrays:
        raise InvalidInput("Foreign arrays.", f"{next(iter(arrays))[:50]!r} does not belong into it")
    _check_value(p, value, len(states))
    return {
        "gamma": gamma,
        "degree": degree,
        "P": p,
        "expansion": exact.expand(degree - 1),
        "problem": problem if problem is not None else (exact if header["polynomial"] is True else None),
        "value_parts": value,
        "records": records,
        "condition": float(header["condition"]),
        "memory": memory,
    }


def _is_integer(value: object, lowest: int, highest: int) -> bool:
    return type(value) is int and lowest <= value <= highest


def _check_value(p: np.ndarray, value: dict[int, np.ndarray], n: int) -> None:
    if any(part.shape != (count(n, k),) for k, part in value.items()):
        raise InvalidInput("Wrong shapes.", f"coefficients of V do not fit {n} states")
    rows, columns = np.triu_indices(n)
    quadratic = np.where(rows == columns, 0.5, 1.0) * p[rows, columns]
    if 2 not in value or not np.allclose(p, p.T, 1e-12, 0) or not np.allclose(value[2], quadratic, 1e-12, 0):
        raise InvalidInput("Wrong numbers.", "P is not symmetric, or V_2 is not half its quadratic form")


def _record(given: dict[str, Any], degree: int) -> DegreeRecord:
    for name in {"residual", "seconds", "error"} & given.keys():
        given[name] = float(given[name])
    record = DegreeRecord(**given)
    if not _is_integer(record.degree, 2, degree) or not isinstance(record.method, str):
        raise InvalidInput("Wrong header.", "a record of a degree makes no sense")
    return record


def _gather(arrays: dict[str, np.ndarray], name: str, lowest: int, highest: int) -> dict[int, np.ndarray]:
    """Take the parts `name`_k out of the arrays, by degree k."""
    found = {}
    for key in [key for key in arrays if key.startswith(f"{name}_")]:
        k = int(key[len(name) + 1 :])
        if key != f"{name}_{k}" or not lowest <= k <= highest:
            raise InvalidInput("Foreign arrays.", f"{key[:50]!r} does not belong into it")
        found[k] = arrays.pop(key)
    return found
