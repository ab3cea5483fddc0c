"""Names for C: those that functions, arguments and results have in Python, each allotted once in its scope."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from inspect import Parameter, signature
from itertools import count

from flexhinf.codegen.memory import Block


class Names:
    """A scope: every name in it is allotted here, and to one thing alone.

    `taken`: Names that others have in it. `around`: The scope that it lies in, none of whose names it hides.
    """

    def __init__(self, taken: Iterable[str] = (), around: Names | None = None) -> None:
        self._taken, self._around = {*taken}, around
        self._last = Counter[str]()  # number behind each name

    def __contains__(self, name: object) -> bool:
        return name in self._taken or (self._around is not None and name in self._around)

    def within(self, taken: Iterable[str] = ()) -> Names:
        """A scope in this one."""
        return Names(taken, self)

    def take(self, *names: str) -> None:
        """Keep names that are as they are: of the caller's own, whatever else may be called so."""
        self._taken.update(names)

    def allot(self, name: str, joint: str = "_") -> str:
        """The name, or where it is taken, with the first number from 2 on behind it that makes it free."""
        return self.numbered(name, joint, 2) if name in self else self._allotted(name)

    def numbered(self, name: str, joint: str = "", first: int = 1) -> str:
        """The name with the first number behind it that makes it free."""
        stem = name + joint
        numbers = count(max(first, self._last[stem] + 1))
        self._last[stem] = next(number for number in numbers if f"{stem}{number}" not in self)
        return self._allotted(f"{stem}{self._last[stem]}")

    def _allotted(self, name: str) -> str:
        self._taken.add(name)
        return name


def distinct(names: Iterable[str]) -> list[str]:
    """The names, with a number behind one that an earlier one has."""
    scope = Names()
    return [scope.allot(name) for name in names]


def function_name(function: Callable[..., object]) -> str:
    """A name that CasADi takes: letters, without two underscores in a row, and no keyword."""
    plain = _plain(function)
    parts = re.findall("[a-z]+", getattr(plain, "__name__", type(plain).__name__).lower())
    return "piece" if parts in ([], ["lambda"], ["null"], ["jac"], ["hess"]) else "_".join(parts)


def result_names(function: Callable[..., object], count: int) -> list[str]:
    """Names of the results of a function: as it says, or by its own name."""
    said = getattr(function, "results", getattr(_plain(function), "results", ()))
    more = count + 1 - len(said)
    said = [own for name in said for own in (_numbered(name[1:], more) if name.startswith("*") else [name])]
    if len(said) == count:
        return list(said)
    name = function_name(function)
    return _numbered(name, count)


def _numbered(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}_{k}" for k in range(1, count + 1)]


def _plain(function: Callable[..., object]) -> Callable[..., object]:
    """The function inside of partial ones."""
    while isinstance(function, partial):
        function = function.func
    return function


def documentation(function: Callable[..., object]) -> str:
    """What a function of ours says of itself."""
    plain = _plain(function)
    written = plain if hasattr(plain, "__name__") else type(plain).__call__
    package = str(getattr(written, "__module__", "")).partition(".")[0]
    return (written.__doc__ or "") if package == __name__.partition(".")[0] else ""


def argument_names(function: Callable[..., object], arrays: Sequence[object]) -> tuple[str, ...]:
    """Names of the parameters of a function that take the blocks among some arrays; none where they are not known."""
    try:
        parameters = list(signature(function).parameters.values())
    except (TypeError, ValueError):
        return ()
    names = [each.name for each in parameters]
    if parameters and parameters[-1].kind is Parameter.VAR_POSITIONAL:
        names += [f"{names[-1]}{k}" for k in range(2, len(arrays))]
    whole = len(names) >= len(arrays)
    return tuple(
        name for name, array in zip(names, arrays) if whole and isinstance(array, Block) and array.size
    )


def names_of(
    function: Callable[..., object], arrays: Sequence[object], filled: Sequence[bool]
) -> tuple[str, ...]:
    """Those of the arguments, and where these are known, of the results that have elements."""
    known = argument_names(function, arrays)
    results = zip(result_names(function, len(filled)), filled)
    return (*known, *(name for name, full in results if full)) if known else ()
