"""Laws, requirements, estimators and exports that other files add, by name.

A file adds something when it is imported: `Registry.register` keeps it under its name. Files of a registry's own
package are imported when the registry is first read. A package of yours is imported then too if it says so in its
``pyproject.toml``; a program of yours imports its file itself.

    [project.entry-points."flexhinf.extensions"]
    mine = "my_package.rise_time"
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import iter_modules
from typing import Any, Protocol, TypeVar

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.validation import value_text

#: Entry points of modules that are imported before anything is looked up by its name.
EXTENSIONS = "flexhinf.extensions"

#: Longest name, in characters.
LONGEST = 40


class Named(Protocol):
    """What a registry keeps."""

    @property
    def name(self) -> str:
        """As users write it."""
        ...


T = TypeVar("T", bound=Named)


@cache
def load_extensions() -> None:
    """Import the modules that installed packages name; each is imported once.

    Raises `InvalidInput` for a module that cannot be imported, with the package's own words.
    """
    for point in entry_points(group=EXTENSIONS):
        try:
            point.load()
        except InvalidInput:
            raise
        except Exception as error:
            raise InvalidInput(
                f"The extension {point.name!r} cannot be imported.",
                f"expected {point.value}, got {type(error).__name__}: {error}",
                "the package that states it, corrected or uninstalled",
            ) from error


@cache
def _load_files(package: str) -> None:
    for _, name, _ in iter_modules(import_module(package).__path__):
        import_module(f"{package}.{name}")


class Registry(Mapping[str, T]):
    """What files register, by name and in order.

    `what`: noun for errors, such as "law". `package`: whose files register too. `place`: key by which all are sorted;
    equal ones stay as they were registered.
    """

    def __init__(self, what: str, package: str, place: Callable[[T], float] = lambda thing: 0.0) -> None:
        self._what, self._package, self._place = what, package, place
        self._things: dict[str, T] = {}
        self._sorted: dict[str, T] | None = None

    def check(self, name: Any) -> None:
        """Raise `InvalidInput` for a name that is no word in small letters, or that is there already."""
        usual = isinstance(name, str) and len(name) <= LONGEST and name.replace("-", "_").isidentifier()
        refuse_if(
            not usual or name != name.lower() or not name.isascii(),
            f"The name of a {self._what} cannot be used.",
            f"expected small letters, digits, - and _, got {value_text(name, 60)}",
            f"my_{self._what}",
        )
        refuse_if(
            name in self._things,
            f"There are two of the {self._what} {name!r}.",
            "expected each name once, got it again",
            f"my_{name}",
        )

    def register(self, thing: T) -> T:
        """Keep something under its name, and return it. Raises as `check`."""
        self.check(thing.name)
        self._things[thing.name] = thing
        self._sorted = None
        return thing

    def registered(self) -> tuple[T, ...]:
        """What is registered by now; no file is read for it."""
        return tuple(self._things.values())

    @property
    def _all(self) -> dict[str, T]:
        _load_files(self._package)
        load_extensions()
        if self._sorted is None:
            self._sorted = dict(sorted(self._things.items(), key=lambda pair: self._place(pair[1])))
        return self._sorted

    def __getitem__(self, name: str) -> T:
        return self._all[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)
