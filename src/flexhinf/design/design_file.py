"""Design files: a robot and what is asked of its loop, as `file_text` writes them; every command takes one.

A file is a design file by its table [design]: ``robot``, for a URDF ``elastic``, and fields of `Specification` by name,
in rad, s, V, N·m. Paths are seen from the file's folder. The table [found] says what came of it, and is not read.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexhinf.design.file_fields import FIELDS
from flexhinf.design.specification import Specification
from flexhinf.errors import InvalidInput
from flexhinf.robot import Robot, catalogue, load_robot

__all__ = ["Asked", "DesignFile", "asked_of", "is_design_file", "load_design", "read_design"]

TABLES = ("design", "found")
PLACES = ("robot", "elastic")

#: A name that is as much like "design" as this was meant to be it.
ALIKE = 0.8


@dataclass(frozen=True)
class DesignFile:
    """What a design file says.

    Attributes
    ----------
    path : Path
    robot, elastic : str, str or None
        As `load_robot` takes them.
    fields : dict
        Of a specification.
    """

    path: Path
    robot: str
    elastic: str | None
    fields: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Asked:
    """What a command is asked for.

    Attributes
    ----------
    robot : Robot
    specification : Specification
    source, elastic : str, str or None
        Where the robot came from, as `load_robot` takes them.
    notes : tuple of str
        What is to be told before the work.
    """

    robot: Robot
    specification: Specification
    source: str
    elastic: str | None = None
    notes: tuple[str, ...] = ()


def load_design(path: str | Path) -> tuple[Robot, Specification]:
    """Robot and specification of a design file.

    Raises
    ------
    InvalidInput
        With the file, the key, the value and what is allowed there.
    """
    asked = _asked(read_design(path), None, {})
    return asked.robot, asked.specification


def asked_of(
    source: str | Path, elastic: str | Path | None = None, given: Mapping[str, Any] | None = None
) -> Asked:
    """What is asked for with a robot, or with a design file over which `given` wins.

    Parameters
    ----------
    source : path or str
        As for `load_robot`, or a design file.
    elastic : path, optional
        With a URDF; wins over a design file's.
    given : mapping, optional
        Fields of a specification; one that is None takes back what the file says. What the file says of weights gives
        way to a behaviour that is given, and the other way round: `Asked.notes` tells.

    Raises
    ------
    InvalidInput
        For a file or a value that cannot be used.
    """
    given = dict(given or {})
    if not is_design_file(source):
        plain = None if elastic is None else str(elastic)
        specification = Specification(**_without_nothing(given))
        return Asked(load_robot(source, plain), specification, str(source), plain)
    return _asked(read_design(source), elastic, given)


def _asked(file: DesignFile, elastic: str | Path | None, given: Mapping[str, Any]) -> Asked:
    """A design file, and what wins over it."""
    fields = {name: value for name, value in file.fields.items() if name not in given}
    rivals = {
        rival: name
        for name, value in given.items()
        if value is not None
        for rival in _rivals(name, value, fields)
        if rival in fields
    }
    kept = {name: value for name, value in fields.items() if name not in rivals}
    notes = [f"{file.path.name}: {rival} gives way to --{name}" for rival, name in rivals.items()]
    specification = Specification(**_without_nothing({**kept, **given}))
    beside = file.elastic if elastic is None else str(elastic)
    return Asked(load_robot(file.robot, beside), specification, file.robot, beside, tuple(notes))


def _without_nothing(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None}


def _rivals(name: str, value: Any, fields: Mapping[str, Any]) -> tuple[str, ...]:
    """Fields that cannot stand beside this one, see `flexhinf.design.presets.choose.preset_of`."""
    stated = fields.get("preset") == "paper"
    if name == "penalty":
        return ("bandwidth", "damping", "preset")
    if name == "effort":
        return ("bandwidth", "damping") if stated else ("bandwidth", "damping", "preset")
    if name in ("bandwidth", "damping"):
        return ("penalty", "effort", "preset") if stated else ("penalty", "effort")
    if name == "preset":
        return ("penalty", "bandwidth", "damping") if value == "paper" else ("penalty", "effort")
    return ()


# Reading ------------------------------------------------------------------------------------------
def is_design_file(source: str | Path) -> bool:
    """Whether this is a design file, or is meant as one; a robot's file and what cannot be read are not."""
    if str(source) in catalogue() or Path(source).suffix.lower() != ".toml":
        return False
    try:
        data = tomllib.loads(Path(source).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    alike = difflib.get_close_matches("design", data, n=1, cutoff=ALIKE)
    return bool(alike or "found" in data) and not {"joint", "urdf"} & set(data)


def read_design(path: str | Path) -> DesignFile:
    """A design file, every key and every value of it looked at; the robot is not read.

    Raises
    ------
    InvalidInput
        With the file, the key, the value and what is allowed there.
    """
    path = Path(path)
    data = _data(path)
    table = data.get("design")
    if not isinstance(table, dict):
        raise _no_design(path.name, list(data))
    for name in data:
        if name not in TABLES:
            raise _unknown(path.name, "the file", name, TABLES)
    table = dict(table)
    if "robot" not in table:
        close = difflib.get_close_matches("robot", [key for key in table if key not in FIELDS], n=1)
        raise InvalidInput(
            f"{path.name}: [design] has no 'robot'.",
            f"expected the name or the file of a robot, got only {list(table)}",
            f"'robot' for {close[0]!r}" if close else "robot = 'planar-two-link', or a path from this file",
        )
    places = {key: _place(path, key, table.pop(key)) for key in PLACES if key in table}
    fields = {key: _field(path.name, key, value) for key, value in table.items()}
    return DesignFile(path, places["robot"], places.get("elastic"), fields)


def _data(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InvalidInput(
            f"There is no design file {str(path)!r}.",
            f"expected a file that can be read: {error.strerror}",
            "the design.toml of a report",
        ) from error
    except ValueError as error:
        raise InvalidInput(
            f"{path.name}: this is no TOML.", f"expected key = value, got: {error}", "correct that line"
        ) from error


def _no_design(file: str, keys: list[str]) -> InvalidInput:
    close = difflib.get_close_matches("design", keys, n=1, cutoff=ALIKE)
    return InvalidInput(
        f"{file}: there is no table [design].",
        f"expected [design], below it robot = …, got {keys}",
        f"[design] for {close[0]!r}"
        if close and close[0] != "design"
        else "[design], below it robot = 'arm.toml'",
    )


#: What options are called that a design file calls otherwise.
OPTIONS = {
    "goal": "pose", "from_pose": "start", "peak_voltage": "peak_effort", "peak_torque": "peak_effort",
}  # fmt: skip


def _unknown(file: str, where: str, key: str, allowed: Any) -> InvalidInput:
    same = OPTIONS.get(key.replace("-", "_"))
    close = [same] if same in allowed else difflib.get_close_matches(key, allowed, n=1)
    return InvalidInput(
        f"{file}: {where} has an unknown key {key!r}.",
        f"expected keys out of {list(allowed)}, got {key!r}",
        f"{close[0]!r}" if close else "one of these keys",
    )


def _place(path: Path, key: str, value: Any) -> str:
    """A catalogue's name as it is; a path from the folder of the design file."""
    if not isinstance(value, str):
        raise InvalidInput(
            f"{path.name}: [design] has a value of {key!r} that cannot be used.",
            f"expected text, got {value!r}",
            f"{key} = 'arm.toml'",
        )
    if key == "robot" and value in catalogue():
        return value
    place = path.parent / value
    if not place.is_file():
        close = difflib.get_close_matches(value, catalogue(), n=1) if key == "robot" else []
        raise InvalidInput(
            f"{path.name}: its {key} {value!r} is not there.",
            f"expected a file, seen from the folder of {path.name}"
            + (f", or a name of the catalogue: {list(catalogue())}" if key == "robot" else ""),
            f"{close[0]!r}" if close else f"{key} = '…' with the path of that file",
        )
    return str(place)


def _field(file: str, key: str, value: Any) -> Any:
    """A value of a specification, of the right kind and in its range."""
    if key not in FIELDS:
        raise _unknown(file, "[design]", key, (*PLACES, *FIELDS))
    kind = FIELDS[key]
    expected = f"expected {kind.words}, got {value!r}"
    try:
        read = kind.read(value)
        Specification(**{key: read})
        return read
    except InvalidInput as error:
        expected = error.found
    except (ValueError, OverflowError):
        pass
    raise InvalidInput(
        f"{file}: [design] has a value of {key!r} that cannot be used.", expected, kind.example
    ) from None
