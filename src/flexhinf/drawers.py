"""Functions by which rooms above draw the results of rooms below: one for each type of result, registered from above.

A result says that it can be drawn, and calls its `Drawer`; what draws it registers a function when its file is
imported. The package itself, which knows all rooms, says by `on_first_use` which files these are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, singledispatch
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_loaders: list[Callable[[], object]] = []


def on_first_use(load: Callable[[], object]) -> None:
    """Call a function once, before anything is drawn: it imports the files that register themselves."""
    _loaders.append(load)


@cache
def _load() -> None:
    for load in _loaders:
        load()


class Drawer(Generic[P, R]):
    """One thing that is drawn of results, by the function that is registered for the type of each.

    `otherwise`: what a type has for which none is registered; a `TypeError` by default.
    """

    def __init__(self, *otherwise: R) -> None:
        def unknown(result: object, *args: Any, **kwargs: Any) -> R:
            if not otherwise:
                raise TypeError(f"Nothing draws a {type(result).__name__}.")
            return otherwise[0]

        self._functions = singledispatch(unknown)

    def register(
        self, *kinds: type[T]
    ) -> Callable[[Callable[Concatenate[T, P], R]], Callable[Concatenate[T, P], R]]:
        """Register the decorated function for these types, and for those that derive from them."""

        def keep(function: Callable[Concatenate[T, P], R]) -> Callable[Concatenate[T, P], R]:
            for kind in kinds:
                self._functions.register(kind, function)
            return function

        return keep

    def __call__(self, result: object, *args: P.args, **kwargs: P.kwargs) -> R:
        """Draw a result by the function of its type."""
        _load()
        return self._functions(result, *args, **kwargs)
