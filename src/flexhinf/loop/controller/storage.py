"""A controller in one file: a compressed NumPy archive with a version and without pickles.

What is saved is all that a step is made of: the laws (names, operating point, coefficients, and the formula as the
instructions of its traced function where it is no polynomial), the estimator with its settings and the model that it
believes in (the instructions of flow and output, and parameters), period, saturation and options. A loaded law is a
`StoredLaw`: it computes the same numbers, and knows nothing of how it was designed. docs/controller_file.md has the
format.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.files import read_arrays, write_arrays
from flexhinf.loop.controller.start import Windup
from flexhinf.loop.controller.step import Schedule, TableLaw
from flexhinf.plant import Estimator, Law, ParameterTable, Plant, StoredCode
from flexhinf.polynomial.algebra import PolynomialLaw
from flexhinf.scalars import apply, function_arrays, function_from_arrays, trace
from flexhinf.validation import checked_name, checked_path, distinct, value_text

FORMAT, VERSION = "flexhinf controller", 1

#: Estimators are made again by the public classes of this room only: a file cannot name, nor import, other code.
ESTIMATORS = "flexhinf.estimation"

#: Most states or inputs of a law that a file may claim.
MOST_SIGNALS = 1000

#: Options of a controller that are pairs of arrays, by the names of these, and others that are arrays.
PAIRS = {"saturation": ("lower", "upper"), "command_range": ("command_lower", "command_upper")}
ARRAYS = ("input_rate", "command_rate", "integral_dead_zone", "before_first")

NAMES = ("states", "inputs", "disturbances", "outputs")


class StoredLaw(Law):
    """A law from a file that is a traced function."""

    def __init__(
        self,
        names: Any,
        point: Any,
        input: Any,
        data: np.ndarray,
        kind: str,
        degree: int | None,
        arrays: Mapping[str, Any],
    ) -> None:
        (self.state_names, self.input_names), self.name, self.degree = names, kind, degree
        self.operating_point, self.operating_input, self._data = point, input, data
        self._arrays = arrays
        _check_sizes(self._law, [len(self.state_names), data.size], len(self.input_names))

    @property
    def kind(self) -> str:
        """The class that it was before it was stored."""
        return self.name

    @property
    def law_degree(self) -> int | None:
        """As of the law that it was."""
        return self.degree

    @property
    def law_data(self) -> np.ndarray:
        """Numbers, flat."""
        return self._data

    @cached_property
    def law_key(self) -> str:
        """A digest of the instructions."""
        digest = hashlib.sha256()
        for name in sorted(self._arrays):
            if name.startswith("law."):
                digest.update(name.encode() + self._arrays[name].tobytes())
        return f"stored {digest.hexdigest()}"

    @cached_property
    def _law(self) -> Any:
        return function_from_arrays(_below("law.", self._arrays), "law")

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), (m,)."""
        return apply(self._law, x, data)[0]


class StoredPlacedLaw(StoredLaw):
    """A law from a file that depends on the reference that it acts about."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        sizes = [len(self.state_names), len(self.plant_states), len(self.input_names), self._data.size]
        _check_sizes(self._about, sizes, len(self.input_names))

    @cached_property
    def _about(self) -> Any:
        return function_from_arrays(_below("about.", self._arrays), "law_about")

    def evaluate_about(self, x: Any, state: Any, input: Any, data: Any) -> Any:
        """k(x), (m,), about a reference (state, input)."""
        return apply(self._about, x, state, input, data)[0]


def write_controller(
    path: str | os.PathLike[str],
    law: Law,
    estimator: Estimator | None,
    period: float,
    options: dict[str, Any],
) -> None:
    """Write what a controller is made of; `options` are its other arguments by name. See `Controller.save`."""
    laws = law.laws if isinstance(law, Schedule) else (law,)
    arrays: dict[str, np.ndarray] = {}
    plain: dict[str, Any] = {}
    for name, option in options.items():
        if name in PAIRS:
            arrays |= dict(zip(PAIRS[name], option))
        elif isinstance(option, Windup):
            arrays |= _prefixed(f"{name}.", vars(option))
        elif isinstance(option, np.ndarray):
            arrays[name] = option
        elif (name, option) != ("before_first", "hold"):
            plain[name] = option
    header = {
        "format": FORMAT, "version": VERSION, "period": period, "options": plain,
        "hysteresis": law.hysteresis if isinstance(law, Schedule) else None,
        "laws": [_store_law(one, f"laws.{k}.", arrays) for k, one in enumerate(laws)],
        "estimator": None if estimator is None else _store(estimator, "estimator.", arrays),
    }  # fmt: skip
    write_arrays(path, "controller", {"header": np.array(json.dumps(header)), **arrays})


def read_controller(path: str | os.PathLike[str], make: Callable[..., Any]) -> Any:
    """What `make`, the class `Controller`, makes of the arguments in a file; see `load_controller`."""
    place = checked_path("The controller's file", path)
    try:
        arrays, whole = read_arrays(place)
        if not whole:
            raise InvalidInput("Not whole.", "the digest at its end is missing, or that of another content")
        return make(**_arguments(json.loads(str(arrays.pop("header"))), arrays))
    except MemoryError:
        raise  # the file may be as it should
    except Exception as error:  # a file with a digest may still hold anything
        found = f"damaged or not such a file ({type(error).__name__})"
        if isinstance(error, FlexhinfError):
            found = " ".join(filter(None, (error.what, error.found)))
            if not os.path.exists(place):
                raise InvalidInput(
                    f"There is no controller's file {value_text(str(path), 120)}.",
                    "expected a file that Controller.save wrote, got a path where nothing is",
                    "the path of such a file, beginning at the working folder or at the root",
                ) from None
        raise InvalidInput(
            "The controller cannot be read.",
            f"expected a {FORMAT} file, version {VERSION}, got {place}: {found}",
            "save it again; files are written by Controller.save",
        ) from error


def _arguments(header: dict[str, Any], arrays: dict[str, Any]) -> dict[str, Any]:
    if header["format"] != FORMAT or header["version"] != VERSION:
        raise InvalidInput(
            "Another format.",
            f"{value_text(header['format'], 60)}, version {value_text(header['version'], 60)}",
        )
    laws = [_stored_law(part, _below(f"laws.{k}.", arrays)) for k, part in enumerate(header["laws"])]
    law = laws[0] if header["hysteresis"] is None else Schedule(laws, header["hysteresis"])
    estimator = None if header["estimator"] is None else _restore(header["estimator"], "estimator.", arrays)
    whole: dict[str, Any] = {"solution": law, "estimator": estimator, "period": header["period"]}
    whole |= {name: arrays[name] for name in ARRAYS if name in arrays}
    for name, ends in PAIRS.items():
        if ends[0] in arrays:
            whole[name] = tuple(arrays[end] for end in ends)
    if "windup.limit" in arrays:
        whole["windup"] = Windup(**_below("windup.", arrays))
    return {**whole, **header["options"]}


def _below(prefix: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    return {name[len(prefix) :]: array for name, array in arrays.items() if name.startswith(prefix)}


# Laws ---------------------------------------------------------------------------------------------
def _store_law(law: Law, prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    n, m, data = len(law.state_names), len(law.input_names), np.ravel(np.asarray(law.law_data, dtype=float))
    parts = {"data": data, "point": law.operating_point, "input": law.operating_input}
    table = None if law.depends_on_reference else law.law_table
    try:
        if table is None:
            parts |= _prefixed("law.", function_arrays(trace(law.evaluate_law, n, data.size, name="law")))
        if law.depends_on_reference:
            about = trace(law.evaluate_about, n, len(law.plant_states), m, data.size, name="law_about")
            parts |= _prefixed("about.", function_arrays(about))
    except Exception as error:  # a law's code may be anybody's
        raise InvalidInput(
            f"{type(law).__name__} cannot be saved.",
            f"expected a law whose formula runs on symbols, got {type(error).__name__}: {error}",
            "NumPy code with the pieces of flexhinf.scalars",
        ) from error
    arrays |= _prefixed(prefix, {name: np.asarray(part) for name, part in parts.items()})
    return {
        "name": law.kind, "degree": law.law_degree, "states": list(law.state_names), "inputs": list(law.input_names),
        "degrees": None if table is None else list(table.degrees), "placed": law.depends_on_reference,
    }  # fmt: skip


def _stored_law(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> Law:
    """Its functions are built now, so that arrays that are no functions of these states and inputs are refused when
    they are read: by an InvalidInput, ValueError, IndexError or KeyError."""
    every: list[tuple[str, ...]] = []
    for kind in ("states", "inputs"):
        given = header[kind]  # a text would be taken for a list of letters
        if not isinstance(given, list) or not 0 < len(given) <= MOST_SIGNALS:
            raise InvalidInput("A law's signals are not named.", f"got {value_text(given, 60)}")
        every.append(tuple(checked_name("a signal of a law", name, spaces=True) for name in given))
        distinct("The signal", every[-1])
    states, inputs = every
    for name, shape in {"point": (len(states),), "input": (len(inputs),), "data": None}.items():
        array = arrays[name]
        right = array.ndim == 1 if shape is None else array.shape == shape
        if array.dtype != np.float64 or not right or not np.isfinite(array).all():
            raise InvalidInput(
                "Wrong numbers.", f"{name} of a law is no vector of finite numbers that fits it"
            )
    numbers, kind = (arrays["point"], arrays["input"]), str(header["name"])
    if header["degrees"] is None:
        stored = StoredPlacedLaw if header["placed"] else StoredLaw
        return stored((states, inputs), *numbers, arrays["data"], kind, header["degree"], arrays)
    if header["placed"]:
        raise InvalidInput("Another law.", "expected no degrees of a law that depends on its reference")
    table = PolynomialLaw(len(states), tuple(header["degrees"]), arrays["data"].reshape(len(inputs), -1))
    law = TableLaw((states, inputs), *numbers, table, kind, header["degree"])
    law.evaluate_law(np.zeros(len(states)), arrays["data"])
    return law


def _check_sizes(function: Any, arguments: list[int], result: int) -> None:
    found = [function.size1_in(k) for k in range(function.n_in())]
    if found != arguments or function.n_out() != 1 or function.size1_out(0) != result:
        raise InvalidInput("Another law.", f"expected arguments of {arguments} numbers, got {found}")


def _prefixed(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {f"{prefix}{name}": array for name, array in arrays.items()}


# Estimators and their models ----------------------------------------------------------------------
def _store(value: Any, prefix: str, arrays: dict[str, np.ndarray]) -> Any:
    """What stands for a setting in the header; arrays go to `arrays`."""
    if isinstance(value, Estimator):
        kind = type(value)
        if getattr(import_module(ESTIMATORS), kind.__name__, None) is not kind:
            raise InvalidInput(
                f"{kind.__name__} cannot be saved.",
                "expected an estimator of flexhinf.estimation: a file names no other code",
                "a controller without it, or with one of these",
            )
        settings = {k: _store(part, f"{prefix}{k}.", arrays) for k, part in value.settings().items()}
        return {"estimator": [kind.__module__, kind.__qualname__], "settings": settings}
    if isinstance(value, Plant):
        parts = _prefixed("flow.", function_arrays(value.traced_flow))
        parts |= _prefixed("output.", function_arrays(value.traced_output))
        arrays |= _prefixed(prefix, parts | _prefixed("parameters.", value.parameters.values))
        named = {kind: list(getattr(value, kind)) for kind in NAMES}
        return {"plant": {
            **named, "parameters": list(value.parameters.names), "units": dict(value.units),
            "groups": {name: list(members) for name, members in value.groups.items()},
            "limits": {name: list(ends) for name, ends in value.limits.items()},
        }}  # fmt: skip
    if isinstance(value, np.ndarray):
        arrays[f"{prefix}array"] = value
        return {"array": True}
    return {"value": value}


def _restore(part: dict[str, Any], prefix: str, arrays: Mapping[str, np.ndarray]) -> Any:
    if "estimator" in part:
        _, name = part["estimator"]
        room = import_module(ESTIMATORS)
        kind = getattr(room, name) if name in room.__all__ else None
        if not (isinstance(kind, type) and issubclass(kind, Estimator)):
            raise InvalidInput("No estimator.", value_text(name, 60))
        return kind(**{k: _restore(one, f"{prefix}{k}.", arrays) for k, one in part["settings"].items()})
    if "plant" in part:  # whose flow and output are the stored functions
        header, arrays = part["plant"], _below(prefix, arrays)
        table = ParameterTable({name: arrays[f"parameters.{name}"] for name in header["parameters"]})
        flow, output = (StoredCode(_below(f"{name}.", arrays), table) for name in ("flow", "output"))
        return Plant(
            flow, output, header["states"], header["inputs"], header["disturbances"], table, header["outputs"],
            header["units"], header["groups"], {name: tuple(ends) for name, ends in header["limits"].items()},
        )  # fmt: skip
    return arrays[f"{prefix}array"] if "array" in part else part["value"]
