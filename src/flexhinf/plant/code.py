"""The code of a model as what was traced: kept in files, evaluated on numbers, pickled by name."""

from __future__ import annotations

import pickle
import re
import threading
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.plant.parameters import ParameterTable
from flexhinf.scalars import (
    Symbol,
    apply,
    function_from_arrays,
)


class StoredCode:
    """flow or output of a model as the instructions of its traced function: all that a file or a pickle can hold.

    It runs on numbers and symbols. The arrays are those of `flexhinf.scalars.function_arrays`; the table has the names,
    in the order of the parameter vector.
    """

    def __init__(self, arrays: Mapping[str, np.ndarray], table: ParameterTable) -> None:
        self.arrays, self.table = dict(arrays), table

    def __call__(self, *arguments: Any) -> Elements:
        """`flow` or `output`, called like them."""
        *vectors, p = arguments
        return apply(self._function, *vectors, self.table.flat(p))[0]

    @cached_property
    def _function(self) -> ca.Function:
        return function_from_arrays(self.arrays, "stored")


class TracedCode:
    """A traced function of one result, evaluated on numbers without a copy of them: a microsecond a call."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._sizes = [function.size1_in(k) for k in range(function.n_in())]
        self._rows = function.size1_out(0)
        # CasADi does not say that a buffer takes what exports memory.
        self._buffer, self._run = cast(Any, function).buffer()
        self._lock = threading.Lock()  # the buffer holds the arguments of one call

    def __reduce__(self) -> tuple[type[TracedCode], tuple[ca.Function]]:
        return TracedCode, (self.function,)

    def evaluate(self, *arrays: ArrayLike) -> np.ndarray | None:
        """The result for vectors of numbers or symbols of the traced sizes; None for any other element."""
        vectors = [np.asarray(array) for array in arrays]
        sizes = [vector.size for vector in vectors]
        if sizes != self._sizes:
            raise InvalidInput(
                f"The arguments of {self.function.name()} do not fit the model.",
                f"expected vectors of {self._sizes} elements, got {sizes}",
                "one element for each name",
            )
        if any(vector.dtype == object for vector in vectors):
            elements = [element for vector in vectors for element in vector.flat]
            if any(isinstance(element, Symbol) for element in elements):
                return apply(self.function, *vectors)[0]
            if not all(isinstance(element, (int, float)) for element in elements):
                return None
        elif any(vector.dtype.kind == "c" for vector in vectors):
            return None
        result = np.empty(self._rows)
        with self._lock:
            numbers: list[Any] = [np.ascontiguousarray(vector, dtype=float) for vector in vectors]
            for place, vector in enumerate(numbers):
                self._buffer.set_arg(place, memoryview(vector))
            self._buffer.set_res(0, memoryview(cast(Any, result)))
            self._run()
        return result


def has_a_name(function: Callable[..., Any]) -> bool:
    """Whether a pickle can hold a function: it is found by its name, and what it is bound to can be pickled."""
    try:
        pickle.dumps(function)
    except Exception:  # what it is bound to may be anybody's
        return False
    return True


def signals(what: str, model: Callable[[], Elements]) -> np.ndarray:
    """Result of the model's code on symbols, as a vector; exceptions of that code become `InvalidInput`."""
    try:
        signals = np.asarray(model(), dtype=object)
    except FlexhinfError:
        raise
    except Exception as error:
        lacking = re.search(r"no callable (\w+) method", str(error))
        raise InvalidInput(
            f"{what} does not run on symbols.",
            f"expected NumPy code for vectors of the named sizes, got {type(error).__name__}: {error}",
            "the names in states, inputs and disturbances, and NumPy functions on the elements"
            if lacking is None
            else f"a formula of other functions instead of np.{lacking[1]}, or an operation: see CONTRIBUTING.md",
        ) from error
    refuse_if(
        signals.ndim != 1,
        f"{what} does not return a vector.",
        f"expected one axis, got shape {signals.shape}",
        "np.array([...]) of the elements",
    )
    return signals
