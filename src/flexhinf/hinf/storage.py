"""A solution in one file: compressed NumPy archive with a version, written beside and moved into place."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.files import write_arrays
from flexhinf.hinf.recursion import DegreeRecord
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.plant.problem import Problem
from flexhinf.polynomial.basis import count

__all__ = ["read_solution", "write_solution"]

_FORMAT, _VERSION = "flexhinf solution", 1
_FIELDS = ("f", "g1", "g2", "h")


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
    path = Path(path)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays: dict[str, Any] = {name: archive[name] for name in archive.files}
        return _assembled(arrays, problem)
    except FlexhinfError as error:
        raise _unreadable(path, error.found or error.what) from error
    except FileNotFoundError as error:
        raise _unreadable(path, "no such file") from error
    except (
        OSError,
        EOFError,
        zipfile.BadZipFile,
        zlib.error,
        KeyError,
        ValueError,
        TypeError,
        AttributeError,
    ) as error:
        raise _unreadable(path, f"damaged or not such a file ({type(error).__name__})") from error


def _unreadable(path: Path, found: str) -> InvalidInput:
    return InvalidInput(
        "The solution cannot be read.",
        f"expected a {_FORMAT} file, version {_VERSION}, got {path}: {found}",
        "solve again and save; files are written by HJISolution.save",
    )


def _assembled(arrays: dict[str, Any], problem: Problem | None) -> dict[str, Any]:
    header = json.loads(str(arrays["header"]))
    if header["format"] != _FORMAT or header["version"] != _VERSION:
        raise InvalidInput("Another format.", f"{header['format']!r}, version {header['version']!r}")
    n, degree = len(header["states"]), int(header["degree"])
    parts = {name: _gather(arrays, name) for name in _FIELDS}
    exact = PolynomialPlant.from_parts(
        n,
        **parts,
        r2=arrays["r2"],
        state_names=header["states"],
        operating_point=arrays["operating_point"],
        input_names=header["inputs"],
        operating_input=arrays["operating_input"],
    )
    value = _gather(arrays, "V")
    if 2 not in value or any(k > degree or part.shape != (count(n, k),) for k, part in value.items()):
        raise InvalidInput("Wrong shapes.", f"coefficients of V do not fit {n} states and degree {degree}")
    if arrays["P"].shape != (n, n) or not all(
        np.isfinite(part).all() for part in (arrays["P"], *value.values())
    ):
        raise InvalidInput("Wrong numbers.", "P or V has the wrong shape or is not finite")
    return {
        "gamma": float(header["gamma"]),
        "degree": degree,
        "P": arrays["P"],
        "expansion": exact.expand(degree - 1),
        "problem": problem if problem is not None else (exact if header["polynomial"] else None),
        "value_parts": value,
        "records": tuple(DegreeRecord(**record) for record in header["records"]),
        "condition": float(header["condition"]),
        "memory": int(header["memory"]),
    }


def _gather(arrays: dict[str, Any], name: str) -> dict[int, np.ndarray]:
    prefix = f"{name}_"
    return {int(key[len(prefix) :]): part for key, part in arrays.items() if key.startswith(prefix)}
