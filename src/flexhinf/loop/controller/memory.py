"""What a controller remembers between steps and the numbers its step is made of: flat vectors with a layout."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.law_code import LawCode
from flexhinf.loop.controller.options import Limits, Mode
from flexhinf.loop.controller.transfer import inverse_slope
from flexhinf.plant import Estimator
from flexhinf.untrusted import real_array

Shape = tuple[int, ...]


@dataclass(frozen=True)
class Layout:
    """Shapes by name; a list of shapes for a part that is a tuple of arrays.

    Parameters
    ----------
    parts : mapping of str to shape or list of shapes
        In the order of the vector.
    """

    parts: Mapping[str, Shape | list[Shape]]

    @cached_property
    def size(self) -> int:
        """Length of the vector."""
        return sum(int(np.prod(shape, dtype=int)) for part in self.parts.values() for shape in _shapes(part))

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where each part lies in the vector."""
        places, start = {}, 0
        for name, part in self.parts.items():
            size = sum(int(np.prod(shape, dtype=int)) for shape in _shapes(part))
            places[name] = slice(start, start + size)
            start += size
        return places

    def named(self, vector: Any) -> SimpleNamespace:
        """The parts of a vector (size,) by name."""
        start, named = 0, {}
        for name, part in self.parts.items():
            arrays = []
            for shape in _shapes(part):
                length = int(np.prod(shape, dtype=int))
                arrays.append(vector[start : start + length].reshape(shape))
                start += length
            named[name] = tuple(arrays) if isinstance(part, list) else arrays[0]
        return SimpleNamespace(**named)

    def pairs(self, values: Mapping[str, Any]) -> list[tuple[Any, slice]]:
        """Every array of named parts, and its place in the vector."""
        pairs, start = [], 0
        for name, part in self.parts.items():
            arrays = values[name] if isinstance(part, list) else [values[name]]
            for shape, array in zip(_shapes(part), arrays, strict=True):
                size = int(np.prod(shape, dtype=int))
                pairs.append((array, slice(start, start + size)))
                start += size
        return pairs

    def flat(self, values: Mapping[str, Any]) -> np.ndarray:
        """The vector (size,) of named parts; a plain number fills its part.

        Raises
        ------
        InvalidInput
            If an array has another shape than its part.
        """
        flat = []
        for name, part in self.parts.items():
            arrays = values[name] if isinstance(part, list) else [values[name]]
            for shape, array in zip(_shapes(part), arrays, strict=True):
                if np.shape(array) not in ((), shape):
                    raise InvalidInput(
                        f"The array {name!r} has the wrong shape.",
                        f"expected {shape}, got {np.shape(array)}",
                        "one element for each place",
                    )
                flat.append(np.broadcast_to(np.asarray(array), shape).ravel())
        return np.concatenate(flat)


def _shapes(part: Any) -> list[Shape]:
    return part if isinstance(part, list) else [part]


def memory_layout(
    estimator: Estimator | None, mode: Mode, inputs: int, tracked: int, commanded: int
) -> Layout:
    """What is remembered from one step to the next."""
    k = tracked
    parts: dict[str, Any] = {}
    if estimator is not None:
        parts["belief"] = [np.shape(part) for part in estimator.initial]
    parts |= {"u": (inputs,), "integral": (k,), "position": (k,), "reference": (commanded,), "started": (1,)}
    if mode.takes_over:
        parts["bias"] = (inputs,)
    if mode.laws > 1:
        parts["active"] = (mode.laws,)
    if mode.limits_command:
        parts["command"] = (k,)
    return Layout(parts)


def data_layout(code: LawCode, estimator: Estimator | None, mode: Mode, tracked: int) -> Layout:
    """Numbers the step is made of: changing them compiles nothing; those of several laws in rows."""
    n, m, k = len(code.law.state_names), len(code.law.input_names), tracked
    several = (mode.laws,) if mode.laws > 1 else ()
    parts: dict[str, Any] = {"period": (1,), "law": (mode.laws * code.data.size,)}
    parts |= {"operating_point": (*several, n), "operating_input": (*several, m)}
    parts |= {"lower": (m,), "upper": (m,), "integral_gain": (*several, m, k)}
    if estimator is not None:
        size, p = estimator.plant.n, len(estimator.plant.outputs)
        parts |= {"parameters": (estimator.plant.parameters.size,)}
        parts |= {"process_noise": (size, size), "measurement_noise": (p, p)}
    if mode.takes_over:
        parts |= {"inverse_slope": (*several, k, m), "decay": (1,)}
    if mode.laws > 1:
        parts["closer"] = (1,)
    if mode.limits_input_rate:
        parts["input_rate"] = (m,)
    if mode.limits_command:
        parts |= {"command_lower": (k,), "command_upper": (k,), "command_rate": (k,)}
    if mode.has_dead_zone:
        parts["integral_dead_zone"] = (k,)
    if mode.bounds_windup:
        parts |= {"windup_line": (*several, m, k), "windup_spread": (*several, m, k), "windup_limit": (m,)}
    return Layout(parts)


def data_values(
    codes: list[LawCode],
    estimator: Estimator | None,
    mode: Mode,
    tracked: int,
    limits: Limits,
    command: Limits,
) -> dict[str, Any]:
    """The numbers of laws, limits and estimator by name."""

    def rows(parts: list[Any]) -> Any:
        return np.stack(parts) if mode.laws > 1 else parts[0]

    gains = [code.slope[:, len(code.law.state_names) - tracked :] for code in codes]
    values: dict[str, Any] = {
        "law": np.concatenate([code.data for code in codes]),
        "operating_point": rows([code.law.operating_point for code in codes]),
        "operating_input": rows([code.law.operating_input for code in codes]),
        "lower": limits.lower, "upper": limits.upper, "input_rate": limits.rate,
        "command_lower": command.lower, "command_upper": command.upper, "command_rate": command.rate,
        "integral_gain": rows(gains),
    }  # fmt: skip
    if mode.takes_over:
        values["inverse_slope"] = rows([inverse_slope(gain) for gain in gains])
    if estimator is not None:
        values["parameters"] = estimator.plant.parameters.vector()
        values["process_noise"] = estimator.process_noise
        values["measurement_noise"] = estimator.measurement_noise
    return values


def filler(buffer: np.ndarray) -> Callable[[Any], None]:
    """How to copy a value of exactly this size: on the real-time path, so a plain number goes straight in."""
    memory: Any = memoryview(buffer)  # type: ignore[arg-type]
    shape, array_type = buffer.shape, np.ndarray

    def fill_one(value: Any) -> None:
        if type(value) is array_type:
            memory[0] = value.item()
        elif isinstance(value, float):
            memory[0] = value
        else:
            memory[0] = real_array(value, strict=True).item()

    def fill(value: Any) -> None:
        if type(value) is array_type and value.shape == shape and value.dtype == buffer.dtype:
            buffer[:] = value
            return
        array = real_array(value, strict=True)
        if array.shape != shape:
            raise ValueError(array.shape)
        buffer[:] = array

    return fill_one if buffer.size == 1 else fill
