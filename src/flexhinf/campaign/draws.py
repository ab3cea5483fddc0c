"""Draws: sample i has the same plant and circumstances in any batch, order and worker, and after any interruption.

A sample's numbers depend on the seed of the campaign and on the sample's index alone, not on a stream: they come from
the counter-based generator of `flexhinf.codegen.noise`, a scrambled Sobol sequence or a Latin hypercube.

A campaign must continue with the draw and the metrics with which it began. A function's name does not identify it, as
its body may change. So its compiled code is hashed, with constants, defaults, closures, globals that it reads, and
functions and classes of the same package that it calls. Comments, line numbers and the docstring do not matter; another
minor version of Python does. Code and objects of other packages, including flexhinf, are identified by name: the first
sample shows their effect on a draw.
"""

# Code and what it reads may hold objects of any type.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

import dis
import functools
import hashlib
import json
import math
import re
import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache
from typing import Protocol, TypeAlias, cast, overload, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Vector
from flexhinf.campaign.samples import (
    Columns,
    NumberedParameters,
    Sample,
    SampleColumns,
    UniformColumns,
    index_array,
)
from flexhinf.codegen.noise import ARRAYS, philox, seed_key
from flexhinf.errors import FlexhinfError, refuse_if
from flexhinf.notebook import StatedRepr
from flexhinf.validation import checked_kind, checked_text, distinct, is_real, one_of, value_text

#: Significant digits of computed numbers (of a short run, or read by a function): last bits may differ between
#: machines.
DIGITS, READ_DIGITS = 6, 12


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def is_library_code(function: object) -> bool:
    """Whether a function is part of flexhinf, so that the version of flexhinf identifies its code."""
    return _package(_base(function)) == "flexhinf"


def fingerprint(function: object) -> str:
    """Name of a function, and a digest of its code and of the values that it reads."""
    base = _base(function)
    return f"{_name(base)}, code {_hash(_Reader(_package(base)).text(function))[:16]}"


def number_hash(numbers: np.ndarray) -> str:
    """Hash of numbers, rounded to `DIGITS` digits: the same on machines whose last bits differ."""
    return _hash(" ".join(f"{value:.{DIGITS}g}" for value in np.ravel(np.asarray(numbers, dtype=float))))[:16]


def campaign_digest(
    settings: Mapping[str, str], columns: Sequence[Sequence[str]], time: Sequence[float]
) -> str:
    """Digest of a campaign's settings, its columns (name, kind, unit) and the instants (T,), s, at which signals are
    kept: files with the same digest are parts of one table."""
    return _hash(
        json.dumps([dict(settings), [list(column) for column in columns], list(time)], sort_keys=True)
    )


def option_text(value: object) -> str:
    """An option of a run as text: a signal by its name, a user's function by its fingerprint."""
    match value:
        case Mapping():
            return ", ".join(f"{name}: {option_text(part)}" for name, part in value.items())
        case np.ndarray():
            return ", ".join(repr(entry) for entry in value.ravel().tolist())
        case types.FunctionType() | types.MethodType() | functools.partial() if not is_library_code(value):
            return fingerprint(value)
        case StatedRepr() if not getattr(value, "name", ""):
            return f"{type(value).__qualname__} {fingerprint(value)}"
        case _:
            pass
    text = str(getattr(value, "name", "") or getattr(value, "__qualname__", None) or repr(value))
    return str(type(value).__qualname__) if " at 0x" in text else text


def _base(function: object) -> object:
    while isinstance(function, (functools.partial, types.MethodType)):
        function = function.func if isinstance(function, functools.partial) else function.__func__
    return function if hasattr(function, "__qualname__") else type(function)


def _name(value: object) -> str:
    return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__qualname__)}"


def _package(value: object) -> str:
    return str(getattr(value, "__module__", None) or "").partition(".")[0]


@dataclass
class _Reader:
    """Converts values to text that is equal for equal values and equal code."""

    package: str
    known: dict[int, str] = field(default_factory=dict[int, str])
    kept: list[object] = field(default_factory=list[object])  # alive, so that no identity is used again

    def text(self, value: object) -> str:
        match value:
            case None | bool() | int() | str() | bytes() | types.EllipsisType():
                return repr(value)
            case float() | complex():
                return f"{value:.{READ_DIGITS}g}"
            case np.generic():
                return self.text(value.item())
            case _:
                pass
        if id(value) not in self.known:
            self.kept.append(value)
            self.known[id(value)] = f"inside {_name(type(value))}"  # for an object that contains itself
            self.known[id(value)] = _hash(self._part(value))
        return self.known[id(value)]

    def _part(self, value: object) -> str:
        match value:
            case set() | frozenset():
                return f"set {sorted(map(self.text, value))}"
            case np.ndarray():
                return f"array {value.shape} {[self.text(part) for part in value.ravel().tolist()]}"
            case list() | tuple():
                return f"{type(value).__name__} {[self.text(part) for part in value]}"
            case Mapping():
                return f"map {[(self.text(key), self.text(part)) for key, part in value.items()]}"
            case types.ModuleType():
                return f"module {value.__name__}"
            case types.MethodType():
                return f"method {self.text(value.__func__)} of {self.text(value.__self__)}"
            case functools.partial():
                return f"partial {[self.text(part) for part in (value.func, value.args, value.keywords)]}"
            case types.CodeType():
                return self._compiled(value)
            case types.BuiltinFunctionType():
                return f"built in {_name(value)}"
            case types.FunctionType() | type():
                return self._function(value)
            case _:
                return self._object(value)

    def _object(self, value: object) -> str:
        """The class and its attributes, without cached properties. Objects of other packages may hold anything,
        addresses and rounding among it: they go by their class."""
        kind = type(value)
        content: dict[str, object] = {}
        if _package(kind) == self.package != "flexhinf":
            parts = [part for base in kind.__mro__ for part in vars(base).items()]
            cached = {name for name, part in parts if isinstance(part, functools.cached_property)}
            stated = fields(value) if is_dataclass(value) else ()
            names = [entry.name for entry in stated] or [
                name for name in getattr(value, "__dict__", {}) if name not in cached
            ]
            content = {name: getattr(value, name, None) for name in names}
        return f"{self.text(kind)} {self.text(content)}"

    def _function(self, value: types.FunctionType | type) -> str:
        if _package(value) != self.package or self.package == "flexhinf":
            return f"code {_name(value)}"
        if isinstance(value, type):
            own = {
                name: getattr(item, "__func__", getattr(item, "fget", getattr(item, "func", item)))
                for name, item in vars(value).items()
                if not (name.startswith("__") and name.endswith("__")) or isinstance(item, types.FunctionType)
            }
            return f"class {_name(value)} {[self.text(part) for part in (value.__bases__, own)]}"
        code, known = value.__code__, value.__globals__
        cells = [cell.cell_contents for cell in value.__closure__ or () if cell != types.CellType()]
        read = {name: known[name] for name in _globals(code) if name in known}
        parts = value.__defaults__, value.__kwdefaults__, cells, read
        return f"function {self._compiled(code, value.__doc__)} {[self.text(part) for part in parts]}"

    def _compiled(self, code: types.CodeType, docstring: str | None = None) -> str:
        constants = [None if docstring and constant == docstring else constant for constant in code.co_consts]
        names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
        return f"{code.co_code.hex()} {names} {[self.text(constant) for constant in constants]}"


def _globals(code: types.CodeType) -> list[str]:
    names = {op.argval for op in dis.get_instructions(code) if op.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
    inner = (_globals(constant) for constant in code.co_consts if isinstance(constant, types.CodeType))
    return sorted(names.union(*inner))


#: Distributions of a number in its interval.
DISTRIBUTIONS = ("uniform", "normal", "truncated-normal", "corners")

#: Sampling methods for all numbers together.
METHODS = ("random", "latin-hypercube", "sobol")

#: Half an interval in standard deviations of a normal distribution.
SIGMAS = 3.0

#: Largest normal number that 53 bits give, in standard deviations.
FARTHEST = 8.3

#: Last word of the generator's counter; that of noise is 0.
_NUMBERS, _SEEDS, _FUNCTIONS = 1, 2, 3

#: Binary digits of a Sobol sequence, and largest number of values of a Latin hypercube (0.4 GB).
_SOBOL_BITS, _MOST_LATIN = 30, 50_000_000


@dataclass(frozen=True)
class Variable:
    """A number that differs from sample to sample.

    Raises InvalidInput: for an interval that is empty or not finite, an unknown distribution, or a normal one that may
    leave the sign of the interval.
    """

    name: str
    # low, high: Its interval
    low: float
    high: float
    # One of `DISTRIBUTIONS`. Normal: about the middle, the interval is ±`SIGMAS` standard deviations; truncated: and
    # cut off at its ends. Corners: one end or the other, each as often
    distribution: str = "uniform"
    unit: str = ""

    def __post_init__(self) -> None:
        checked_text("the name of a variable", self.name)
        one_of("There is no such distribution.", self.distribution, DISTRIBUTIONS)
        ends = (self.low, self.high)
        refuse_if(
            not all(is_real(end) and math.isfinite(end) for end in ends) or self.low > self.high,
            f"The interval of {self.name!r} is not usable.",
            f"expected finite low <= high, got {value_text(ends)}",
            "its smallest and its largest value",
        )
        lowest, highest = self.normal(-FARTHEST), self.normal(FARTHEST)
        refuse_if(
            self.distribution == "normal" and self.low * self.high > 0.0 >= lowest * highest,
            f"A normal distribution of {self.name!r} may change its sign.",
            f"expected an interval of at most ±{100 * SIGMAS / FARTHEST:.3g} % about its middle, got "
            f"[{self.low:g}, {self.high:g}], which is ±{SIGMAS:g} standard deviations",
            "the distribution truncated-normal",
        )

    @overload
    def normal(self, deviations: float) -> float: ...
    @overload
    def normal(self, deviations: Vector) -> Vector: ...
    def normal(self, deviations: float | Vector) -> float | Vector:
        """The number so many standard deviations above the middle of the interval."""
        return 0.5 * (self.low + self.high) + 0.5 * (self.high - self.low) / SIGMAS * deviations

    def values(self, u: np.ndarray) -> np.ndarray:
        """Quantiles (N,) of the distribution at probabilities u (N,) in (0, 1)."""
        if self.distribution == "corners":
            return np.where(u < 0.5, self.low, self.high)
        if self.distribution == "uniform":
            return np.clip((1.0 - u) * self.low + u * self.high, self.low, self.high)
        from scipy.special import ndtr, ndtri

        if self.distribution == "normal":
            return self.normal(ndtri(u))
        inside = ndtri(ndtr(-SIGMAS) + u * (ndtr(SIGMAS) - ndtr(-SIGMAS)))
        return np.clip(self.normal(inside), self.low, self.high)

    def text(self) -> str:
        """The variable as one line, with every digit of its interval."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.distribution} in [{self.low!r}, {self.high!r}]{unit}"

    @staticmethod
    def read(name: str, text: str) -> Variable | None:
        """Parse the text that `Variable.text` writes; None for another text."""
        match = _VARIABLE.fullmatch(text)
        try:
            low, high = map(float, match.group(2, 3)) if match else (math.nan, math.nan)
        except ValueError:
            return None
        return match and Variable(name, low, high, match[1], match[4] or "")


_VARIABLE = re.compile(rf"({'|'.join(DISTRIBUTIONS)}) in \[([^\s,]+), ([^\s\]]+)\](?: (.+))?", re.DOTALL)


class Draw(ABC):
    """Interface of a draw, which returns the samples of a campaign by their indices."""

    @abstractmethod
    def samples(self, indices: Sequence[int], count: int, seed: int) -> Sequence[Sample]:
        """Samples of these indices, of `count` in all; a sample does not depend on the other indices."""

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the numbers in a row, where they are known."""
        return {}

    @property
    @abstractmethod
    def settings(self) -> Mapping[str, str]:
        """Settings of the draw besides count and seed, as text by name; they are compared when a campaign continues."""


#: Generator → parameters by name, or a `Sample`.
DrawFunction: TypeAlias = Callable[[np.random.Generator], Mapping[str, ArrayLike] | Sample]


@dataclass(frozen=True, eq=False)
class FunctionDraw(Draw):
    """Samples that a function draws with a random generator, such as `flexhinf.Robot.draw`."""

    function: DrawFunction

    def samples(self, indices: Sequence[int], count: int, seed: int) -> Sequence[Sample]:
        """Draw each sample with a generator of its own (Philox 4×64, the number of the sample in its counter).

        A draw of flexhinf, such as `flexhinf.Robot.draw`, takes all generators at once.
        """
        if is_library_code(self.function):
            generators = cast("np.random.Generator", UniformColumns(seed, _FUNCTIONS, indices))
            columns = self.function(generators)
            assert isinstance(columns, NumberedParameters)  # of N robots at once: each value is an array
            return SampleColumns(cast("Columns", columns.numbers), cast("Columns", columns))
        bit_generators = (np.random.Philox(key=[seed, _FUNCTIONS], counter=[0, 0, 0, k]) for k in indices)
        values = [self.function(np.random.Generator(bits)) for bits in bit_generators]
        for value in values:
            checked_kind(
                "The draw gives no parameters.",
                value,
                (Sample, Mapping),
                "a mapping by name or a Sample",
                "{'stiffness': rng.uniform(0.9, 1.1)}",
            )
        return [value if isinstance(value, Sample) else Sample(value) for value in values]

    @property
    def settings(self) -> Mapping[str, str]:
        """The name of the function and the digest of its code."""
        return {"draw": fingerprint(self.function)}


@runtime_checkable
class BuiltTogether(Protocol):
    """A `Tolerances.build` that makes many samples at once too, each with the same bits."""

    def columns(self, numbers: Columns) -> SampleColumns:
        """Samples with these values (N,) of the variables, by name; a `FlexhinfError` where one of them fails."""
        ...


@dataclass(frozen=True, eq=False)
class Tolerances(Draw):
    """Draw of independent numbers in their intervals.

    Raises InvalidInput: for an unknown method, no variable, or two of one name.
    """

    variables: Sequence[Variable]
    # One of `METHODS`. Random: independent samples. Latin hypercube: each number by itself is evenly spread. Sobol: all
    # numbers together are, and a longer campaign begins with the same samples
    method: str = "random"
    # Numbers by name → `Sample`; by default parameters of the true plant. A `FlexhinfError` becomes the sample's
    # failure
    build: Callable[[Mapping[str, float]], Sample] | None = None

    def __post_init__(self) -> None:
        one_of("There is no such method.", self.method, METHODS)
        refuse_if(
            not self.variables,
            "Nothing differs from sample to sample.",
            "expected at least one variable, got none",
            "Variable('stiffness', 0.9, 1.1)",
        )
        distinct("variables", [variable.name for variable in self.variables])

    def samples(self, indices: Sequence[int], count: int, seed: int) -> Sequence[Sample]:
        """Samples of these indices: quantiles of each variable at the points of the method."""
        columns = self.numbers(indices, count, seed)
        if (together := self.columns(columns)) is not None:
            return together
        values = {name: column.tolist() for name, column in columns.items()}
        rows = ({name: column[k] for name, column in values.items()} for k in range(len(indices)))
        return [self.built(numbers, int(index)) for numbers, index in zip(rows, indices)]

    def numbers(self, indices: Sequence[int], count: int, seed: int) -> dict[str, np.ndarray]:
        """Values (N,) of each variable for these samples, by its name."""
        points = _points(self.method, index_array(indices), len(self.variables), count, seed)
        return {variable.name: variable.values(points[:, k]) for k, variable in enumerate(self.variables)}

    def columns(self, numbers: Columns) -> SampleColumns | None:
        """All samples with these values (N,) of the variables at once; None where they are built one by one."""
        if self.build is None:
            return SampleColumns(numbers, numbers)
        if isinstance(self.build, BuiltTogether):
            with suppress(FlexhinfError):  # some of them fail: which ones, and why, is found one by one
                return self.build.columns(numbers)
        return None

    @staticmethod
    def stated(settings: Mapping[str, str], names: Sequence[str]) -> Tolerances | None:
        """Make the draw again from a campaign's settings; its variables have these names, in this order.

        None for a user's function, which settings do not contain; InvalidInput for wrong settings.
        """
        variables = [Variable.read(name, settings.get(f"variable {name}", "")) for name in names]
        known = [variable for variable in variables if variable is not None]
        whole = known and len(known) == len(names) and "build" not in settings and "method" in settings
        return Tolerances(known, settings["method"]) if whole else None

    def built(self, numbers: Mapping[str, float], index: int = 0) -> Sample:
        """The sample with these values of the variables, by name, and with what else the sample of an index has."""
        if self.build is None:
            return Sample(numbers, numbers=numbers)
        try:
            return self.build(numbers)
        except FlexhinfError as error:
            return Sample(numbers=numbers, failure=" ".join(str(error).split()))

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the variables, by name."""
        return {variable.name: variable.unit for variable in self.variables}

    @property
    def settings(self) -> Mapping[str, str]:
        """The method, every variable, and the fingerprint of a user's `build`."""
        own = {} if self.build is None or is_library_code(self.build) else {"build": fingerprint(self.build)}
        return {"method": self.method, **{f"variable {v.name}": v.text() for v in self.variables}, **own}


def sample_seed(seed: int, index: int) -> int:
    """The seed of a sample's measurement noise, for `Loop.run`."""
    return int(sample_seeds(seed, [index])[0])


def sample_seeds(seed: int, indices: Sequence[int]) -> np.ndarray:
    """Seeds of the measurement noise of several samples, (N,) of 64 bits."""
    bits = philox(ARRAYS, (0, 0, index_array(indices), _SEEDS), seed_key(seed))
    return bits[0] << np.uint64(32) | bits[1]


def _points(method: str, indices: np.ndarray, dimensions: int, count: int, seed: int) -> np.ndarray:
    if method == "random":
        random = philox(
            ARRAYS, (indices[:, None], np.arange(dimensions)[None, :], 0, _NUMBERS), seed_key(seed)
        )
        bits = (random[0] << np.uint64(21)) ^ (random[1] >> np.uint64(11))
        return np.minimum((bits.astype(float) + 0.5) * 2.0**-53, 1.0 - 2.0**-53)
    if method == "latin-hypercube":
        return np.maximum(_latin_hypercube(dimensions, count, seed)[indices], 2.0**-54)
    return _sobol(indices, dimensions, seed) + 2.0 ** -(_SOBOL_BITS + 1)


@lru_cache(2)
def _latin_hypercube(dimensions: int, count: int, seed: int) -> np.ndarray:
    """All points (count, dimensions) of a Latin hypercube; each depends on `count`."""
    from scipy.stats import qmc

    refuse_if(
        count * dimensions > _MOST_LATIN,
        "A Latin hypercube of this size does not fit into memory.",
        f"expected at most {_MOST_LATIN} numbers, got {count} samples of {dimensions}",
        "the method sobol, which is evenly spread too",
    )
    points = qmc.LatinHypercube(dimensions, rng=seed).random(count)
    points.setflags(write=False)
    return points


def _sobol(indices: np.ndarray, dimensions: int, seed: int) -> np.ndarray:
    """Points (N, dimensions) of the scrambled sequence: each run of successive numbers at once."""
    from scipy.stats import qmc

    points = np.empty((len(indices), dimensions))
    for run in np.split(np.arange(len(indices)), np.flatnonzero(np.diff(indices) != 1) + 1):
        if len(run):
            sequence = qmc.Sobol(dimensions, rng=seed, bits=_SOBOL_BITS)
            if indices[run[0]]:
                sequence.fast_forward(int(indices[run[0]]))
            # SciPy warns unless the first run is a power of 2
            points[run] = sequence.random(1 << (len(run) - 1).bit_length())[: len(run)]
    return points
