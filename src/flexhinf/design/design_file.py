"""Design files: a robot and the specification of its loop, as TOML; every command that takes a robot takes one.

A file is a design file by its table [design]: ``robot``, for a URDF ``elastic``, ``payload`` instead of that of the
robot's file, and fields of `Specification` by name.
Paths are seen from the file's folder. The table [result] says what came of it and is not read ([found] in older files).

Whether the units of a specification are those of the joints: lengths where a joint slides, angles where it turns.

A specification is read before the robot, so its numbers remember their units (`flexhinf.design.units.Stated`).
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from flexhinf.design.specification import FIELDS, Specification, SpecificationError, json_schema
from flexhinf.design.units import Stated
from flexhinf.design.waypoint_table import WaypointTable
from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty
from flexhinf.robot import Robot, catalogue, load_robot
from flexhinf.robot.signals import SENSORS, expanded, signal_names, units_of
from flexhinf.validation import checked_path, read_toml, value_text

#: Fields with one number, or one per joint, and the signal that each is a value of.
SIGNALS = {
    "pose": "link_position",
    "start": "link_position",
    "tracking_error": "link_position",
    "integral_dead_zone": "link_position",
    "peak_speed": "link_velocity",
}

#: How people write numbers of an SI unit, for advice.
CUSTOMARY = {"rad": "deg", "m": "mm", "rad/s": "deg/s", "m/s": "mm/s", "N·m": "Nm", "N": "N"}


def check_stated_units(robot: Robot, s: Specification) -> None:
    """Refuse a length for a joint that turns, an angle for one that slides, and the same of speeds and sensors.

    A number without a unit fits every joint; so does a wrong count of numbers here, which is refused where it is
    used.
    """
    known = units_of(robot.joint_names, robot.links.slides)
    for field, values, signals in _stated(robot, s):
        parts, units = _parts(values), [known[name] for name in signals]
        each = parts * len(signals) if len(parts) == 1 else parts
        if len(each) != len(signals):
            continue
        for part, signal, unit in zip(each, signals, units):
            if isinstance(part, Stated) and part.si != unit:
                written = parts if len(set(units)) == 1 else each  # one for all joints, where one can be
                raise _refusal(field, part, signal, unit, ",".join(map(_fitted, written, units)))


def _stated(robot: Robot, s: Specification) -> Iterator[tuple[str, Any, Sequence[str]]]:
    for field, signal in SIGNALS.items():
        yield field, getattr(s, field), signal_names(signal, robot.joint_names)
    for pose in s.via:
        yield "via", pose, signal_names("link_position", robot.joint_names)
    if any(isinstance(one, Stated) for one in _parts(s.quantisation)):
        yield "quantisation", *per_signal(robot, s.measured, s.quantisation)


def per_signal(robot: Robot, measured: Sequence[str], values: Any) -> tuple[tuple[Any, ...], tuple[str, ...]]:
    """Values of measured signals, and these signals: a value for each name counts for all that the name stands for.

    Another number of values is returned as it is.
    """
    signals = expanded(measured, SENSORS, robot.joint_names, robot.rigid)
    parts = _parts(values)
    if len(parts) != len(signals) and len(parts) == len(measured):
        groups = [expanded(name, SENSORS, robot.joint_names, robot.rigid) for name in measured]
        parts = tuple(part for group, part in zip(groups, parts) for _ in group)
    return parts, signals


def _parts(values: Any) -> tuple[Any, ...]:
    return values if isinstance(values, tuple) else (values,)


def _refusal(field: str, stated: Stated, signal: str, unit: str, example: str) -> SpecificationError:
    return SpecificationError(
        field,
        f"The {field.replace('_', ' ')} has a unit that {signal!r} does not have.",
        f"expected {unit} (or text with {CUSTOMARY[unit]}), got {value_text(stated.number + stated.unit, 60)}",
        example=example,
    )


def _fitted(value: float, unit: str) -> str:
    """A value as it was written, its unit exchanged for one of the same size that fits."""
    if not isinstance(value, Stated):
        return f"{value:g}"
    if value.si == unit:
        return value.number + value.unit
    plain = value.unit.lower() == value.si.lower()
    return value.number + (unit.replace("·", "") if plain else CUSTOMARY[unit])


TABLES = ("design", "result", "found")
PLACES = ("robot", "elastic", "payload")

#: A table whose name is as similar as this to "design" was meant to be it.
SIMILAR = 0.8

#: In the folder of a report.
DESIGN_FILE = "design.toml"


@dataclass(frozen=True)
class DesignFile:
    """What a design file says."""

    path: Path
    # robot, elastic, payload: As `load_robot` takes them
    robot: str
    elastic: str | None
    fields: dict[str, Any]  # Of a specification, as the file has them
    payload: str | None = None


@dataclass(frozen=True, eq=False)
class DesignRequest:
    """What a command is asked for."""

    robot: Robot
    specification: Specification
    # source, elastic, payload: Where the robot came from and what it carries, as `load_robot` takes them
    source: str
    elastic: str | None = None
    notes: tuple[str, ...] = ()  # What the user should know before the work
    payload: str | None = None


def load_design(path: str | Path) -> tuple[Robot, Specification]:
    """Robot and specification of a design file.

    Raises
    ------
    InvalidInput
        With the file, the key, the value and what is allowed there.
    """
    request = _merged(read_design(path), None, {})
    return request.robot, request.specification


def read_request(
    source: str | Path,
    elastic: str | Path | None = None,
    given: Mapping[str, Any] | None = None,
    payload: str | None = None,
) -> DesignRequest:
    """The request of a robot, or of a design file over which `given` wins.

    Parameters
    ----------
    source : path or str
        As for `load_robot`, or a design file.
    elastic : path, optional
        With a URDF; wins over a design file's.
    given : mapping, optional
        Fields of a specification; one that is None takes back what the file says. Weights in the file give way to a
        preset, a bandwidth or a damping that is given, and the other way round: `DesignRequest.notes` says so.
    payload : str, optional
        As for `load_robot`; wins over a design file's.

    Raises
    ------
    InvalidInput
        For a file or a value that cannot be used.
    """
    given = dict(given or {})
    if not is_design_file(source):
        plain = None if elastic is None else str(elastic)
        specification = Specification(**_without_none(given))
        robot = load_robot(source, plain, payload=payload)
        check_stated_units(robot, specification)
        specification = _without_own_limits(specification, robot)
        return DesignRequest(robot, specification, str(source), plain, payload=payload)
    return _merged(read_design(source), elastic, given, payload)


def _merged(
    file: DesignFile, elastic: str | Path | None, given: Mapping[str, Any], payload: str | None = None
) -> DesignRequest:
    fields = {name: value for name, value in file.fields.items() if name not in given}
    rivals = {
        rival: name
        for name, value in given.items()
        if value is not None
        for rival in _rivals(name, value, fields)
        if rival in fields
    }
    kept = {name: value for name, value in fields.items() if name not in rivals}
    notes = [f"{file.path.name}: {rival} gives way to `{name}`" for rival, name in rivals.items()]
    specification = Specification(**_without_none({**kept, **given}))
    beside = file.elastic if elastic is None else str(elastic)
    carried = file.payload if payload is None else payload
    robot = load_robot(file.robot, beside, payload=carried)
    check_stated_units(robot, specification)
    specification = _without_own_limits(specification, robot)
    return DesignRequest(robot, specification, file.robot, beside, tuple(notes), carried)


def _without_own_limits(s: Specification, robot: Robot) -> Specification:
    """The specification without infinite limits where the robot states none: they are the default there."""
    own = {
        "peak_effort": robot.effort_limits,
        "saturation": robot.effort_limits,
        "peak_speed": robot.speed_limits,
    }
    none = [name for name, limits in own.items() if np.isinf(np.array(limits, dtype=float)).all()]
    return replace(s, **{name: None for name in none if getattr(s, name) == np.inf})


def _without_none(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if value is not None}


def _rivals(name: str, value: Any, fields: Mapping[str, Any]) -> tuple[str, ...]:
    """Fields that contradict this one, see `flexhinf.design.problem.presets.preset_of`."""
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
        data = read_toml(Path(source))
    except InvalidInput:
        return False
    similar = difflib.get_close_matches("design", data, n=1, cutoff=SIMILAR)
    return bool(similar or {"result", "found"} & set(data)) and not {"joint", "urdf"} & set(data)


def meant_file(source: str) -> str:
    """The file that a command's argument means: of a report's folder its design file, else what was given."""
    folder = checked_path("The robot or design file", source)
    named = source in catalogue() or not (folder / DESIGN_FILE).is_file()
    return source if named else str(folder / DESIGN_FILE)


def read_design(path: str | Path) -> DesignFile:
    """A design file, every key and every value of it checked; the robot is not read."""
    path = checked_path("The design file", path)
    data = read_toml(path, "design file")
    table = data.get("design")
    if not isinstance(table, dict):
        raise _no_design(path.name, list(data))
    for key in data:
        if key not in TABLES:
            raise _unknown(path.name, "the file", key, TABLES[:2])
    if "robot" not in table:
        close = difflib.get_close_matches("robot", [key for key in table if key not in FIELDS], n=1)
        raise InvalidInput(
            f"{path.name}: [design] has no 'robot'.",
            f"expected the name or the file of a robot, got only {list(table)}",
            f"'robot' for {close[0]!r}" if close else "robot = 'planar-two-link', or a path from this file",
        )
    if isinstance(table.get("move"), str) and table["move"].strip():
        table["move"] = str(path.parent / table["move"])
    places = {key: _place(path, key, table.pop(key)) for key in PLACES if key in table}
    _check_fields(path.name, table)
    return DesignFile(path, places["robot"], places.get("elastic"), table, places.get("payload"))


def _no_design(file: str, keys: list[str]) -> InvalidInput:
    close = difflib.get_close_matches("design", keys, n=1, cutoff=SIMILAR)
    return InvalidInput(
        f"{file}: there is no table [design].",
        f"expected [design], below it robot = …, got {keys}",
        f"[design] for {close[0]!r}"
        if close and close[0] != "design"
        else "[design], below it robot = 'arm.toml'",
    )


#: Other names that a field had or has: those of earlier versions, and --peak-effort by the kind of drive.
OPTIONS = {
    "goal": "pose", "from_pose": "start", "friction": "friction_model", "dead_zone": "integral_dead_zone",
    "peak_voltage": "peak_effort", "peak_current": "peak_effort", "peak_torque": "peak_effort",
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
    """A catalogue's name and a payload as they are; a path from the folder of the design file."""
    if not isinstance(value, str):
        raise InvalidInput(
            f"{path.name}: [design] has a value of {key!r} that cannot be used.",
            f"expected text, got {value!r}",
            f"{key} = '0..3kg'" if key == "payload" else f"{key} = 'arm.toml'",
        )
    if key == "payload" or (key == "robot" and value in catalogue()):
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


def _check_fields(file: str, fields: Mapping[str, Any]) -> None:
    try:
        Specification(**fields)
    except SpecificationError as error:
        if error.field not in FIELDS:
            raise _unknown(file, "[design]", error.field, (*PLACES, *FIELDS)) from None
        raise InvalidInput(
            f"{file}: [design] has a value of {error.field!r} that cannot be used.", error.found,
            _example(error.field, error.example),
        ) from None  # fmt: skip


def _example(name: str, text: str) -> str:
    """A value that can be used, as a line of the file."""
    if not text:
        return f"{name} = true"
    if name == "move":
        return f"{name} = '{text}', or [design.move] with time = [0.0, 1.0] and a list for each joint"
    fields: dict[str, Any] = {name: text}
    value = plain(name, getattr(Specification(**fields), name))
    if isinstance(value, dict):
        return f"[design.{name}], below it " + ", ".join(f"{key} = {one}" for key, one in value.items())
    unit = any(part in text for part in ("ms", "deg", "°"))
    return f"{name} = {tomlkit.item(text if unit else value).as_string()}"


def plain(name: str, value: Any) -> Any:
    """The value of a field in lists and numbers, for TOML."""
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if name in ("penalty", "checked_penalty"):
        return weights_of(value)
    if name == "move":
        return move_of(value)
    return np.asarray(value).tolist()


def move_of(move: Any) -> dict[str, list[float]]:
    """The waypoints of a move by name, SI units."""
    if isinstance(move, WaypointTable):
        return move.columns()
    raise InvalidInput(
        "A design file cannot hold a move that is a signal.",
        f"expected waypoints, got {move!r}",
        "the report without its design file: design_files(…)",
    )


def weights_of(penalty: Any) -> Any:
    """The weights of a penalty in lists and numbers."""
    states = penalty.states if isinstance(penalty, Penalty) else penalty
    if callable(states):
        raise InvalidInput(
            "A design file cannot hold a penalty that is code.",
            f"expected weights by name, one per state, or rows, got {penalty!r}",
            "the report without its design file: design_files(…)",
        )
    if isinstance(states, Mapping):
        return {name: np.asarray(weight, dtype=float).tolist() for name, weight in states.items()}
    return np.asarray(states, dtype=float).tolist()


def design_schema() -> dict[str, Any]:
    """The JSON schema of a design file, for editors and other programs."""
    design = json_schema()
    text = {"type": "string"}
    design["properties"] = {
        "robot": text
        | {"description": "A name that `flexhinf robots` lists, or the path of a robot's file."},
        "elastic": text | {"description": "With a URDF: the robot file with spring and motor of each joint."},
        "payload": text
        | {"description": "What the robot carries instead of its file's own payload: 0..3kg@hand."},
        **design["properties"],
    }
    design["required"] = ["robot"]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Design file of flexhinf",
        "type": "object",
        "properties": {"design": design, "result": {"type": "object"}, "found": {"type": "object"}},
        "required": ["design"],
        "additionalProperties": False,
    }
