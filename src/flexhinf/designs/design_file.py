"""Design files: a robot and the specification of its loop, as TOML; every command that takes a robot takes one.

A file is a design file by its table [design]: ``robot``, for a URDF ``elastic``, ``payload`` instead of that of the
robot's file, and fields of `Specification` by name. Paths are relative to the file's folder. The table [result] has
the results and is not read ([found] in older files). Fields are read before the robot, so numbers keep their units
(`flexhinf.options.Stated`) until it is known which joints slide.
"""

# Not checked strictly: tomlkit does not say what its tables hold.
# pyright: reportUnknownArgumentType=false, reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import contextlib
import difflib
import itertools
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import tomlkit
from pydantic import TypeAdapter
from tomlkit.items import AoT, Table

from flexhinf import __version__
from flexhinf.designs.requirements.kinds import limit_fields
from flexhinf.designs.specification import (
    FIELDS,
    FORMER,
    Specification,
    SpecificationError,
)
from flexhinf.designs.stated_units import parts_of
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.loop import load_controller
from flexhinf.options import HOME, Stated, lengths
from flexhinf.plant import Penalty
from flexhinf.report import is_listed, is_report, sources, unchanged
from flexhinf.robot import Robot, catalogue
from flexhinf.robot.waypoints import Tool, WaypointTable, states_range
from flexhinf.validation import checked_path, file_digest, nearest, read_toml, value_text, within_proportion

TABLES = ("design", "result", "found")
PLACES = ("robot", "elastic", "payload")

#: A table whose name is at least as similar to "design" counts as a misspelt [design].
SIMILAR = 0.8

#: In the folder of a report.
DESIGN_FILE, CONTROLLER_FILE = "design.toml", "controller"


def is_design_file(source: str | Path) -> bool:
    """Whether this is a design file, or is meant as one; False for a robot's file and for an unreadable file."""
    if str(source) in catalogue() or Path(source).suffix.lower() != ".toml":
        return False
    try:
        data = read_toml(Path(source))
    except InvalidInput:
        return False
    similar = difflib.get_close_matches("design", data, n=1, cutoff=SIMILAR)
    return bool(similar or {"result", "found"} & set(data)) and not {"joint", "urdf"} & set(data)


def meant_file(source: str) -> str:
    """The file that a command's argument names: the design file of a report's folder, otherwise the argument."""
    folder = checked_path("The robot or design file", source)
    named = source in catalogue() or not (folder / DESIGN_FILE).is_file()
    return source if named else str(folder / DESIGN_FILE)


def robot_digests(source: str | Path, elastic: str | Path | None, folder: str | Path = ".") -> dict[str, str]:
    """SHA-256 of the files that state a robot: its own, that of its joints, and a URDF or MJCF that one of them names.

    By their paths from `folder`, and of a robot of the catalogue by its name.
    """
    shipped = catalogue()
    files = {_place_text(source, folder): shipped.get(str(source), Path(source))}
    files |= {} if elastic is None else {_place_text(elastic, folder): Path(elastic)}
    for file in tuple(files.values()):
        root = read_toml(file) if file.suffix.lower() == ".toml" else {}
        rigid = [file.parent / root[key] for key in ("urdf", "mjcf") if isinstance(root.get(key), str)]
        beside = file in shipped.values()
        files |= {path.name if beside else _place_text(path, folder): path for path in rigid}
    return {name: file_digest(path) for name, path in files.items()}


def why_anew(file: Path, robot: Robot | None = None) -> str:
    """Why the controller beside a design file is not the one of this design: "" if it is, or if there is none.

    `robot`: of the design file, to say whether the controller is one of another robot.
    """
    folder = file.parent
    if file.name != DESIGN_FILE or not is_report(folder):
        return ""
    if not unchanged(folder, (file.name,)):
        return f"{file.name} was changed since the report" if (folder / CONTROLLER_FILE).exists() else ""
    places, known = read_tables(file)[0], sources(folder).values()
    now = robot_digests(places["robot"], places.get("elastic"), folder) if known else {}
    changed = [Path(name).name for name, digest in now.items() if digest not in known]
    if changed:
        return f"{' and '.join(changed)} {'was' if len(changed) == 1 else 'were'} changed since the report"
    if unchanged(folder, (CONTROLLER_FILE,)) or not is_listed(folder, CONTROLLER_FILE):
        return ""
    if not (folder / CONTROLLER_FILE).exists():
        return f"the folder of this report has lost its file {CONTROLLER_FILE!r}"
    if robot is not None and _of_another(folder / CONTROLLER_FILE, robot):
        return f"the {CONTROLLER_FILE} in this folder belongs to a robot other than {robot.name!r}"
    return f"the {CONTROLLER_FILE} was changed since the report"


def _of_another(controller: Path, robot: Robot) -> bool:
    """Whether the estimator of a stored controller has another model than this robot's; False where none can tell."""
    try:
        estimator = load_controller(controller).estimator
    except FlexhinfError:
        return False
    model = getattr(getattr(estimator, "plant", None), "parameters", None)
    known, own = getattr(model, "values", {}), robot.plant_parameters()
    return bool(known) and not all(
        name in own and np.shape(own[name]) == np.shape(value) and np.allclose(own[name], value)
        for name, value in known.items()
    )


def has_controller(file: Path) -> bool:
    """Whether a design file lies in a report whose controller was made of it, and of its robot as it is now."""
    return unchanged(file.parent, (file.name, CONTROLLER_FILE)) and not why_anew(file)


def read_tables(path: Path) -> tuple[dict[str, str], dict[str, Any]]:
    """Robot, elastic and payload of a design file, and its fields of a specification; InvalidInput for another file."""
    data, name = read_toml(path, "design file"), path.name
    stated = data.get("design")
    if not isinstance(stated, dict):
        close = difflib.get_close_matches("design", data, n=1, cutoff=SIMILAR)
        wrong = f"[design] for {close[0]!r}" if close and close[0] != "design" else ""
        raise InvalidInput(
            f"{name}: there is no table [design].",
            f"expected [design], below it robot = …, got {list(data)}",
            wrong or "[design], below it robot = 'arm.toml'",
        )

    table = cast("dict[str, Any]", stated)

    def unknown(where: str, key: str, allowed: Sequence[str]) -> InvalidInput:
        same = FORMER.get(key.replace("-", "_"))
        advice = repr(same) if same in allowed else nearest(key, allowed, "one of these keys")
        found = f"expected keys out of {list(allowed)}, got {key!r}"
        return InvalidInput(f"{name}: {where} has an unknown key {key!r}.", found, advice)

    for key in data:
        if key not in TABLES:
            raise unknown("the file", key, TABLES[:2])
    if "robot" not in table:
        close = difflib.get_close_matches("robot", [key for key in table if key not in FIELDS], n=1)
        raise InvalidInput(
            f"{name}: [design] has no 'robot'.",
            f"expected the name or the file of a robot, got only {list(table)}",
            f"'robot' for {close[0]!r}" if close else "robot = 'planar-two-link', or a path from this file",
        )
    for key in ("move", "workspace"):
        if isinstance(table.get(key), str) and not (key == "workspace" and states_range(table[key])):
            table[key] = str(path.parent / table[key]) if table[key].strip() else ""
    places = {key: _place(path, key, table.pop(key)) for key in PLACES if key in table}
    try:
        Specification(**table)
    except SpecificationError as error:
        if error.field not in FIELDS:
            raise unknown("[design]", error.field, (*PLACES, *FIELDS)) from None
        what = f"{name}: [design] has a value of {error.field!r} that cannot be used."
        raise InvalidInput(what, error.found, _example(error.field, error.example)) from None
    return places, table


def _place(path: Path, key: str, value: Any) -> str:
    refuse_if(
        not isinstance(value, str),
        f"{path.name}: [design] has a value of {key!r} that cannot be used.",
        f"expected text, got {value!r}",
        f"{key} = '0..3kg'" if key == "payload" else f"{key} = 'arm.toml'",
    )
    if key == "payload" or (key == "robot" and value in catalogue()):
        return value
    place = path.parent / value
    if not place.is_file():
        named = f", or a name of the catalogue: {list(catalogue())}" if key == "robot" else ""
        raise InvalidInput(
            f"{path.name}: its {key} {value!r} is not there.",
            f"expected a file, seen from the folder of {path.name}{named}",
            nearest(value, catalogue() if key == "robot" else (), f"{key} = '…' with the path of that file"),
        )
    return str(place)


def _example(name: str, text: str) -> str:
    if not text:
        return f"{name} = true"
    if name == "move":
        return f"{name} = '{text}', or [design.move] with time = [0.0, 1.0] and a list for each joint"
    fields: dict[str, Any] = {name: text}
    value = plain(name, getattr(Specification(**fields), name))
    if isinstance(value, dict):
        return f"[design.{name}], below it " + ", ".join(f"{key} = {entry}" for key, entry in value.items())
    unit = any(part in text for part in ("ms", "deg", "°", "mrad"))
    return f"{name} = {tomlkit.item(text if unit else value).as_string()}"


def plain(name: str, value: Any) -> Any:
    """The value of a field in lists, numbers and rms values with units, for TOML.

    Raises InvalidInput: for a penalty or a move that is code."""
    if name == "measurement_noise" and any(isinstance(part, Stated) for part in parts_of(value)):
        # rms values, which as numbers would be variances
        parts = [f"{v.number}{v.unit}" if isinstance(v, Stated) else v for v in parts_of(value)]
        return parts if isinstance(value, tuple) else parts[0]
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if name in ("pose", "start") and not len(value):
        return HOME
    if isinstance(value, WaypointTable):
        return value.columns()
    states = value.states if isinstance(value, Penalty) else value
    refuse_if(
        name == "move" or callable(states),
        f"A design file cannot hold a {name} that is {'a signal' if name == 'move' else 'code'}.",
        f"expected {'waypoints' if name == 'move' else 'weights by name, one per state, or rows'}, got {value!r}",
        "the report without its design file: design_files(…)",
    )
    if isinstance(states, Mapping):
        return {state: np.asarray(weight, dtype=float).tolist() for state, weight in states.items()}
    return np.asarray(states, dtype=float if name in ("penalty", "checked_penalty") else None).tolist()


HEAD = f"""\
A design, by flexhinf {__version__}. The same design is made by: flexhinf design design.toml
Options on the command line win over this file, and every command that takes a robot takes it.
Units: rad (m), rad/s, s, V or N·m (N), or text with a unit: "90deg", "0.6Hz", "5ms". Paths are seen from this folder.
"""


def fields_text(s: Specification) -> dict[str, str]:
    """The fields of a specification that are not at their defaults, as text."""
    values = {name: plain(name, getattr(s, name)) for name in FIELDS}
    return {name: str(value) for name, value in values.items() if value != plain(name, FIELDS[name].default)}


def request_document(
    specification: Specification,
    robot: str | Path,
    elastic: str | Path | None = None,
    folder: str | Path = ".",
    payload: str | None = None,
    slides: Sequence[bool] = (False,),
) -> tomlkit.TOMLDocument:
    """A design file without a result: its table [design] with the fields that differ from the defaults, and the
    defaults below it as comments."""
    values = {name: plain(name, getattr(specification, name)) for name in FIELDS}
    if isinstance(specification.penalty, Penalty) and specification.effort is None:
        effort = np.asarray(specification.penalty.effort, dtype=float)
        refuse_if(
            effort.ndim > 1 and effort.size > 1,
            "A design file holds one price of each input.",
            f"expected R2 as a number, or one per joint, got {effort.tolist()}",
            "the report without its design file: design_files(…)",
        )
        values["effort"] = float(effort.ravel()[0]) if effort.size == 1 else effort.tolist()
    defaults = {name: plain(name, field.default) for name, field in FIELDS.items()}
    stated = {name: value for name, value in values.items() if value != defaults[name]}
    document, table = tomlkit.document(), tomlkit.table()
    for line in HEAD.splitlines():
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    beside = None if elastic is None else _place_text(elastic, folder)
    places = {"robot": _place_text(robot, folder), "elastic": beside, "payload": payload}
    flat = {name: value for name, value in stated.items() if not isinstance(value, dict)}
    for name, value in ({k: place for k, place in places.items() if place is not None} | flat).items():
        table.add(name, value)
        about = name in flat and _comment(name, value, slides if specification.in_degrees else ())
        if about:
            table[name].comment(about)
    table.add(tomlkit.nl())
    table.add(tomlkit.comment("By default:"))
    for name, value in defaults.items():
        if value is not None and name not in stated:
            unit = FIELDS[name].about.unit
            text = f"{name} = {tomlkit.item(value).as_string()}"
            table.add(tomlkit.comment(f"{text}  # {unit}" if unit else text))
    for name, value in stated.items():
        if isinstance(value, dict):
            table.add(name, toml_table(value))
    document.add("design", table)
    return document


def _comment(name: str, value: Any, slides: Sequence[bool]) -> str:
    """Comment on a field: its unit, or positions in the report's degrees and m; `slides`: which joints slide."""
    known, positions = name in ("pose", "start", "via", "tracking_error") and bool(slides), np.ravel(value)
    if not known or (len(positions) == 1 and len(set(slides)) > 1):  # one for joints of both kinds
        rms = name == "measurement_noise" and positions.dtype.kind == "U"
        return "" if rms else FIELDS[name].about.unit
    pairs = zip(positions, itertools.cycle(slides))
    return ", ".join(f"{q:.6g} m" if slide else f"{math.degrees(q):.6g}°" for q, slide in pairs)


def toml_table(values: Mapping[str, Any]) -> Table:
    """A table of plain values; tables stand below their numbers, as TOML wants it."""
    table, below = tomlkit.table(), dict[str, Table | AoT]()
    for name, value in values.items():
        if isinstance(value, Mapping):
            below[name] = toml_table(value)
        elif isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping):
            rows = tomlkit.aot()
            rows.extend(map(toml_table, value))
            below[name] = rows
        else:
            table.add(name, value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value)
    for name, value in below.items():
        table.add(name, value)
    return table


def _place_text(source: str | Path, folder: str | Path) -> str:
    if str(source) in catalogue():
        return str(source)
    path = Path(source).resolve()
    with contextlib.suppress(ValueError):  # another drive
        path = Path(os.path.relpath(path, Path(folder).resolve()))
    return path.as_posix()


def design_schema() -> dict[str, Any]:
    """The JSON schema of a design file, for editors and other programs."""
    places = {
        "robot": "A name that `flexhinf robots` lists, or the path of a robot's file.",
        "elastic": "With a URDF: the robot file with spring and motor of each joint.",
        "payload": "What the robot carries instead of its file's own payload: 0..3kg@hand.",
    }
    design = TypeAdapter(Specification).json_schema()
    own = design["properties"]
    limit = {name: {"default": None, "title": name.replace("_", " ").title()} for name in limit_fields()}
    limit = {name: FIELDS[name].adapter.json_schema() | more for name, more in limit.items()}
    design["properties"] = {name: (own | limit)[name] for name in FIELDS}
    for name, field in FIELDS.items():
        about = field.about
        text = f"{about.help} Default: {about.default}." if about.default else about.help
        design["properties"][name] |= {"description": text} | ({"x-unit": about.unit} if about.unit else {})
    texts = {name: {"type": "string", "description": text} for name, text in places.items()}
    design |= {
        "description": str(Specification.__doc__).partition("\n")[0],
        "additionalProperties": False,
        "properties": {**texts, **design["properties"]},
        "required": ["robot"],
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Design file of flexhinf",
        "type": "object",
        "properties": {"design": design, "result": {"type": "object"}, "found": {"type": "object"}},
        "required": ["design"],
        "additionalProperties": False,
    }


def tool_of(text: str) -> Tool:
    """``hand:0,0,0.1``, ``hand`` or ``:0,0,0.1``; the origin of the last link for an empty text."""
    link, colon, offset = text.partition(":")
    return Tool(link.strip() or None, point_of("tool", offset) if colon else (0.0, 0.0, 0.0))


def point_of(what: str, text: str) -> tuple[float, ...]:
    """The three coordinates of a text, m; InvalidInput, with the option `what`, for another text."""
    point: tuple[float, ...] = ()
    with contextlib.suppress(ValueError):
        point = lengths(text)
    refuse_if(
        len(point) != 3 or not all(map(within_proportion, point)),
        f"The point of --{what} cannot be read.",
        f"expected x,y,z in m or mm, got {value_text(text, 80)}",
        "0.4,0,300mm",
    )
    return point
