"""What tells two campaigns apart, as text that is the same in every process: functions of a user, options, numbers.

A campaign goes on with the draw and the metrics that it was begun with. Their names say little: a body that was changed
has the same one. So the code is hashed as it was compiled (comments, line numbers and the function's docstring do not
matter; another minor version of Python does), with constants, defaults, what it closes over, globals that it reads, and
functions and classes of the same package that it calls. Code and objects of other packages, flexhinf among them, go by
their names: what they do to a draw is seen in its first sample.
"""

from __future__ import annotations

import dataclasses
import dis
import functools
import hashlib
import json
import types
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

#: Digits of computed numbers that count, as of a short run, and of those that a function reads: their last bits may
#: differ from machine to machine.
DIGITS, READ_DIGITS = 6, 12


def is_ours(function: Any) -> bool:
    """Whether the version of flexhinf says which code a function is."""
    return _package(_base(function)) == "flexhinf"


def fingerprint(function: Any) -> str:
    """The function's name and a digest of its code and of what it reads."""
    digest = hashlib.sha256(_Reader(_package(_base(function))).text(function).encode())
    return f"{_name(_base(function))}, code {digest.hexdigest()[:16]}"


def number_hash(numbers: np.ndarray) -> str:
    """Of numbers, to `DIGITS` digits: the same on machines whose last bits differ."""
    text = " ".join(f"{value:.{DIGITS}g}" for value in np.ravel(np.asarray(numbers, dtype=float)))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def campaign_digest(
    settings: Mapping[str, str], columns: Sequence[Sequence[str]], time: Sequence[float]
) -> str:
    """Of a campaign's settings, of its columns (name, kind, unit) and of the instants (T,), s, at which signals are
    kept: files that state it are parts of one table."""
    stated = [dict(settings), [list(column) for column in columns], list(time)]
    return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()


def option_text(value: Any) -> str:
    """An option of a run; of a signal its name, of a user's function its fingerprint."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {option_text(part)}" for name, part in value.items())
    if isinstance(value, np.ndarray):
        return ", ".join(repr(one) for one in value.ravel().tolist())
    if isinstance(value, types.FunctionType | types.MethodType | functools.partial) and not is_ours(value):
        return fingerprint(value)
    text = str(getattr(value, "name", "") or getattr(value, "__qualname__", None) or repr(value))
    return str(type(value).__qualname__) if " at 0x" in text else text


def _base(function: Any) -> Any:
    """The function itself, or the class whose instance is called."""
    while isinstance(function, (functools.partial, types.MethodType)):
        function = function.func if isinstance(function, functools.partial) else function.__func__
    return function if hasattr(function, "__qualname__") else type(function)


def _name(value: Any) -> str:
    return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__qualname__)}"


def _package(value: Any) -> str:
    return str(getattr(value, "__module__", None) or "").partition(".")[0]


class _Reader:
    """Values as text: equal for equal values and equal code."""

    def __init__(self, package: str) -> None:
        self.package, self.known = package, dict[int, str]()
        self.kept: list[Any] = []  # so that no other value gets the identity of one that is known

    def text(self, value: Any) -> str:
        """Of any value."""
        if value is None or value is Ellipsis or isinstance(value, (bool, int, str, bytes)):
            return repr(value)
        if isinstance(value, (float, complex)):
            return f"{value:.{READ_DIGITS}g}"
        if isinstance(value, np.generic):
            return self.text(value.item())
        if id(value) not in self.known:
            self.kept.append(value)
            self.known[id(value)] = f"inside {_name(type(value))}"  # where it holds itself
            found = self._code(value) or self._container(value) or self._instance(value)
            self.known[id(value)] = hashlib.sha256(found.encode()).hexdigest()
        return self.known[id(value)]

    def _container(self, value: Any) -> str:
        """Of arrays, sequences, sets and mappings; empty for other values."""
        if isinstance(value, (set, frozenset)):
            return f"set {sorted(map(self.text, value))}"
        if isinstance(value, np.ndarray):
            return f"array {value.shape} {[self.text(one) for one in value.ravel().tolist()]}"
        if isinstance(value, (list, tuple)):
            return f"{type(value).__name__} {[self.text(one) for one in value]}"
        if isinstance(value, Mapping):
            return f"map {[(self.text(key), self.text(one)) for key, one in value.items()]}"
        return ""

    def _code(self, value: Any) -> str:
        """Of functions, classes and modules; empty for other values."""
        if isinstance(value, types.ModuleType):
            return f"module {value.__name__}"
        if isinstance(value, types.MethodType):
            return f"method {self.text(value.__func__)} of {self.text(value.__self__)}"
        if isinstance(value, functools.partial):
            return f"partial {[self.text(one) for one in (value.func, value.args, value.keywords)]}"
        if isinstance(value, types.CodeType):
            return self._compiled(value)
        if not isinstance(value, (types.FunctionType, type)):
            return f"built in {_name(value)}" if isinstance(value, types.BuiltinFunctionType) else ""
        if _package(value) != self.package or self.package == "flexhinf":
            return f"code {_name(value)}"
        return self._class(value) if isinstance(value, type) else self._function(value)

    def _function(self, value: types.FunctionType) -> str:
        cells = [cell.cell_contents for cell in value.__closure__ or () if cell != types.CellType()]
        read = {
            name: value.__globals__[name] for name in _globals(value.__code__) if name in value.__globals__
        }
        parts = value.__defaults__, value.__kwdefaults__, cells, read
        return f"function {self._compiled(value.__code__, value.__doc__)} {[self.text(one) for one in parts]}"

    def _class(self, value: type) -> str:
        own = {
            name: getattr(one, "__func__", getattr(one, "fget", getattr(one, "func", one)))
            for name, one in vars(value).items()
            if not (name.startswith("__") and name.endswith("__")) or isinstance(one, types.FunctionType)
        }
        return f"class {_name(value)} {[self.text(one) for one in (value.__bases__, own)]}"

    def _compiled(self, code: types.CodeType, docstring: str | None = None) -> str:
        constants = [None if docstring and one == docstring else one for one in code.co_consts]
        names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
        return f"{code.co_code.hex()} {names} {[self.text(one) for one in constants]}"

    def _instance(self, value: Any) -> str:
        """Of an object: its class, and what it holds but not what it has only computed of that.

        Objects of other packages may hold anything, addresses and rounding among it: they go by their class.
        """
        kind = type(value)
        held: dict[str, Any] = {}
        if _package(kind) == self.package != "flexhinf":
            parts = [part for one in kind.__mro__ for part in vars(one).items()]
            cached = {name for name, part in parts if isinstance(part, functools.cached_property)}
            fields = (
                [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
            )
            names = fields or [name for name in getattr(value, "__dict__", {}) if name not in cached]
            held = {name: getattr(value, name, None) for name in names}
        return f"{self.text(kind)} {self.text(held)}"


def _globals(code: types.CodeType) -> list[str]:
    """Names of globals that code reads, and functions inside it."""
    found = {one.argval for one in dis.get_instructions(code) if one.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
    for one in code.co_consts:
        if isinstance(one, types.CodeType):
            found |= set(_globals(one))
    return sorted(found)
