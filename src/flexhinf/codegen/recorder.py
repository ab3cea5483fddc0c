"""A run that computes directly and keeps what was computed one after the other: the stages of one trace."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial, wraps
from typing import TYPE_CHECKING, cast

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.codegen.compose import Direct, Result
from flexhinf.codegen.naming import Names, documentation, function_name, result_names
from flexhinf.codegen.program import Stages, TracedStage

if TYPE_CHECKING:
    import casadi


def _kept(name: str) -> Callable[..., Elements]:
    """A method of `Direct` whose result is kept as a stage."""
    own: Callable[..., Elements] = getattr(Direct, name)

    def method(self: Recorder, *arrays: object, **options: object) -> Elements:
        return self.kept(own, partial(own, self), *arrays, **options)

    return wraps(own)(method)


class Recorder(Direct):
    """As `Direct`, and keeps what was computed one after the other, with what the functions say of themselves; of calls
    inside of others only the outer ones."""

    gram, product, combination = map(_kept, ("gram", "product", "combination"))
    cholesky, householder, residual = map(_kept, ("cholesky", "householder", "residual"))

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """As `Direct.begin`."""
        self._done: list[tuple[TracedStage, object]] = []
        self._inside = False
        self._section = self._turn = ""
        self._names = Names()
        self._columns: list[tuple[str, int]] | None = (
            None  # names and sizes of the results of the columns before
        )

    def recorded(self) -> list[Elements]:
        """As `Direct.recorded`: an array for each stage, of a zero and what it gives."""
        return [np.concatenate([np.zeros(1), *_flat(result)]) for _, result in self._done]

    def stages(self, function: casadi.Function) -> Stages:
        """Those of a function whose first results are the arrays that were recorded."""
        return Stages(function, tuple(stage for stage, _ in self._done))

    def kept(
        self,
        named: Callable[..., object],
        compute: Callable[..., Result],
        *arrays: object,
        **options: object,
    ) -> Result:
        """What a function computes; as a stage, unless another one calls it. `named`: Says what it is."""
        if self._inside:
            return compute(*arrays, **options)
        self._inside = True
        try:
            result = compute(*arrays, **options)
        finally:
            self._inside = False
        about, begins = self._section or documentation(named), bool(self._section or self._turn)
        results = self._results(named, result)
        name = result_names(named, 1)[0] if len(results) == 1 else function_name(named)
        self._done.append((TracedStage(name, about, results, begins, self._turn), result))
        self._section = self._turn = ""
        return result

    def _results(self, named: Callable[..., object], result: object) -> tuple[tuple[str, int, int], ...]:
        """Names, sizes and places of what a function gave; those of further columns come after those before."""
        arrays = cast(tuple[Elements, ...], result if isinstance(result, tuple) else (result,))
        sizes = [np.size(each) for each in arrays]
        if not self._columns:
            places = [0] * len(sizes)
            names = [self._names.allot(name, "") for name in result_names(named, len(sizes))]
        else:
            names, places = (list(each) for each in zip(*self._columns, strict=True))
        if self._columns is not None:
            self._columns = [(name, place + size) for name, place, size in zip(names, places, sizes)]
        return tuple(zip(names, sizes, places, strict=True))

    def section(self, about: str) -> None:
        """As `Direct.section`: the sentence of the next stage."""
        self._section = "" if self._inside else about

    def call(self, function: Callable[..., Result], *arrays: object) -> Result:
        """As `Direct.call`."""
        return self.kept(function, function, *arrays)

    def repeat(
        self, times: int, function: Callable[..., tuple[Elements, ...]], *arrays: Elements
    ) -> tuple[Elements, ...]:
        """As `Direct.repeat`: every turn begins with a new stage, and gives results of the same names."""
        names = self._names
        for _ in range(times):
            if not self._inside:
                self._turn, self._names = function_name(function), names.within()
            arrays = function(*arrays)
        return arrays

    def columns(
        self, function: Callable[..., Result], moving: Elements | tuple[Elements, ...], *held: object
    ) -> Result:
        """As `Direct.columns`: a stage for each column."""
        if self._inside:
            return super().columns(function, moving, *held)
        self._columns = []
        try:
            return super().columns(partial(self.call, function), moving, *held)
        finally:
            self._columns = None


def _flat(result: object) -> Iterator[Elements]:
    """The arrays of a result, flat."""
    if isinstance(result, tuple):
        for part in cast(tuple[object, ...], result):
            yield from _flat(part)
    else:
        yield np.ravel(cast(Elements, result))
