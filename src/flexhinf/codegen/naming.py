"""What functions, their arguments and their results are called, for C: as they are in Python."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from inspect import Parameter, signature

from flexhinf.codegen.memory import Block


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
