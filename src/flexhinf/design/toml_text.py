"""TOML for what `tomllib` reads back as it was: numbers in full, text, lists, and tables of them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from numbers import Integral, Real
from typing import Any

__all__ = ["toml_table", "toml_value"]

_BARE = re.compile(r"[A-Za-z0-9_-]+\Z")


def toml_value(value: Any) -> str:
    """A value on one line; NumPy's numbers and arrays are understood.

    Raises
    ------
    TypeError
        For what TOML has no value for.

    Examples
    --------
    >>> toml_value([0.1, 2, "r2", True])
    '[0.1, 2, "r2", true]'
    """
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Integral):
        return str(int(value))
    if isinstance(value, Real):
        return repr(float(value))
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml_value(one) for one in value) + "]"
    raise TypeError(f"TOML has no value for {type(value).__name__}")


def toml_table(name: str, table: Mapping[str, Any]) -> str:
    """A table with its tables below it; a list of tables becomes an array of them.

    Examples
    --------
    >>> print(toml_table("found", {"gamma": 2.5, "weights": {"link_position": 60.0}}), end="")
    [found]
    gamma = 2.5
    <BLANKLINE>
    [found.weights]
    link_position = 60.0
    """
    return _table(name, table, f"[{name}]")


def _table(name: str, table: Mapping[str, Any], head: str) -> str:
    lines, below = [head], []
    for key, value in table.items():
        key = key if _BARE.match(key) else toml_value(key)
        rows = value if isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping) else None
        if isinstance(value, Mapping):
            below.append(_table(f"{name}.{key}", value, f"[{name}.{key}]"))
        elif rows is not None:
            below += [_table(f"{name}.{key}", row, f"[[{name}.{key}]]") for row in rows]
        else:
            lines.append(f"{key} = {toml_value(value)}")
    return "\n".join(["\n".join(lines) + "\n", *below])
