"""Parameters, an argument of every model: a vector for kernels, attributes for the reader."""

from __future__ import annotations

import keyword
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import checked_kind, one_of, read_only, real_array, unknown_name, value_text

#: Numbers or arrays of parameters, by name.
ParameterValues: TypeAlias = Mapping[str, ArrayLike]

AS_STATED = "the name as it stands in the parameters"


class Parameters:
    """The parameters of a model as attributes: ``p.stiffness``."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.__dict__.update(values)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # copy, pickle and notebooks ask for such names
            raise AttributeError(name)
        what = f"The model reads a parameter that it does not have: {name!r}."
        raise unknown_name(what, name, sorted(self.__dict__), AS_STATED)


@dataclass(frozen=True)
class ParameterTable:
    """Nominal values (finite numbers or arrays, SI units), and their order in a kernel's parameter vector."""

    values: Mapping[str, Any]

    def __post_init__(self) -> None:
        checked_kind("The parameters are not named.", self.values, Mapping, "a mapping", "{'mass': 1.0}")
        checked = {}
        for name, value in self.values.items():
            refuse_if(
                not str(name).isidentifier() or keyword.iskeyword(str(name)) or str(name).startswith("_"),
                f"The parameter name {name!r} cannot be an attribute.",
                "expected a Python identifier without a leading underscore that is no keyword",
                "letters, digits and underscores, for example lambda_ for lambda",
            )
            array = real_array(value)
            if not np.all(np.isfinite(array)):
                raise InvalidInput(
                    f"The parameter {name!r} is not a finite number.",
                    f"expected finite numbers, got {value_text(value)}",
                    "correct the value; a limit that does not exist is left out rather than infinite",
                )
            array.setflags(write=False)
            checked[str(name)] = array
        object.__setattr__(self, "values", checked)

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(read_only(state))  # copies share their arrays

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the vector."""
        return tuple(self.values)

    @cached_property
    def size(self) -> int:
        """Length of the vector."""
        return sum(value.size for value in self.values.values())

    @cached_property
    def _places(self) -> dict[str, slice]:
        ends = np.cumsum([value.size for value in self.values.values()], dtype=int).tolist()
        return {name: slice(end - value.size, end) for end, (name, value) in zip(ends, self.values.items())}

    def vector(self) -> np.ndarray:
        """Nominal values, flat (size,)."""
        return np.concatenate([np.zeros(0), *(value.ravel() for value in self.values.values())])

    def named(self, vector: Elements) -> Parameters:
        """A vector (size,) of numbers or elements, by name."""
        vector = np.asarray(vector)
        if vector.shape != (self.size,):
            raise InvalidInput(
                "The parameter vector does not fit the parameters.",
                f"expected shape ({self.size},) for {list(self.names)}, got {vector.shape}",
                "vector(), changed",
            )
        parts = {name: vector[place].reshape(self.values[name].shape) for name, place in self._places.items()}
        return Parameters({name: part if part.ndim else part[()] for name, part in parts.items()})

    def flat(self, parameters: Parameters) -> np.ndarray:
        """Named parameters back as a vector (size,): the inverse of `named`."""
        return np.concatenate([np.zeros(0), *(np.ravel(getattr(parameters, name)) for name in self.values)])

    def known(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The values whose names are in this table: a robot states more than each of its plants has."""
        return {name: value for name, value in values.items() if name in self.values}

    def replaced(self, changes: Mapping[str, Any]) -> ParameterTable:
        """A copy with some values changed: known names, the same shapes, finite numbers."""
        for name, value in changes.items():
            one_of(f"There is no parameter {name!r}.", name, self.values, AS_STATED)
            if np.shape(value) != self.values[name].shape:
                raise InvalidInput(
                    f"The parameter {name!r} has the wrong shape.",
                    f"expected {self.values[name].shape}, got {np.shape(value)}",
                    "one number for each nominal number",
                )
        return ParameterTable({**self.values, **changes})

    def vectors(self, rows: Sequence[Mapping[str, Any]] | Mapping[str, np.ndarray]) -> np.ndarray:
        """Vectors (N, size) of many plants, each with some values changed: `replaced` for all of them at once.

        A mapping has the values of all plants in an array (N, …) by name.
        """
        count = len(next(iter(rows.values()))) if isinstance(rows, Mapping) else len(rows)
        table, fits = np.tile(self.vector(), (count, 1)), True
        try:
            for name, places, columns in _changes(rows):
                fits &= columns.shape == (len(places), *self.values[name].shape)
                table[places, self._places[name]] = columns.reshape(len(places), -1)
        except (KeyError, TypeError, ValueError, OverflowError):  # another name or size, or no number
            fits = False
        if not (fits and np.all(np.isfinite(table))):  # `replaced` raises, and says which value it is
            each = _rows(rows, count) if isinstance(rows, Mapping) else rows
            return np.array([self.replaced(row).vector() for row in each])
        return table


def _changes(
    rows: Sequence[Mapping[str, Any]] | Mapping[str, np.ndarray],
) -> Iterator[tuple[str, Any, np.ndarray]]:
    """Each name that some plants change, which ones they are, and their values (N, …)."""
    if isinstance(rows, Mapping):
        for name, column in rows.items():
            yield name, np.arange(len(column)), real_array(column)
        return
    for name in dict.fromkeys(name for row in rows for name in row):
        changed = [k for k, row in enumerate(rows) if name in row]
        yield name, changed, real_array([rows[k][name] for k in changed])


def _rows(columns: Mapping[str, np.ndarray], count: int) -> Iterator[dict[str, Any]]:
    return ({name: column[k] for name, column in columns.items()} for k in range(count))
