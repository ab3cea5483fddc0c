"""Options: how one is declared, once, as a field of a frozen dataclass made by `option`; and how values are read.

Command line, design file, JSON schema, ``help()`` and the tables in docs/ are made from these fields. Values are as
people write them: numbers, text with a unit (``90deg``, ``5ms``, ``0.6Hz``), lists, weights. Every reader takes what
Python, a TOML file or the command line gives and returns numbers in SI units; each raises ValueError for what it cannot
read. A number that was text with a unit remembers that unit (`Stated`): which units fit is known when the robot is, see
`flexhinf.designs.design_file`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints

from flexhinf.errors import InvalidInput
from flexhinf.robot.parameters import SECONDS, SLIDING, TURNING, Stated, lettered, measured, respelled, split
from flexhinf.validation import (
    checked_path,
    is_array,
    is_integer,
    late_package,
    real_number,
    value_text,
)

if TYPE_CHECKING:
    import numpy as np
    import pydantic
else:
    np, pydantic = map(late_package, ("numpy", "pydantic"))

#: Units of each kind of number, and what one is in the SI unit that stands first.
_FREQUENCIES = {"rad/s": 1.0, "Hz": 2.0 * math.pi}
_POSITIONS = (TURNING, SLIDING)
_SPEEDS = (
    {"rad/s": 1.0, "deg/s": math.pi / 180.0, "°/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    {"m/s": 1.0, "mm/s": 1e-3},
)
_TORQUES = ({"N·m": 1.0, "Nm": 1.0, "N*m": 1.0, "mN·m": 1e-3, "mNm": 1e-3}, {"N": 1.0})
_EFFORTS = ({"V": 1.0, "mV": 1e-3}, {"A": 1.0, "mA": 1e-3}, *_TORQUES)
_QUANTITIES = (*_POSITIONS, *_SPEEDS, *_TORQUES)

#: Longest list that is a field's value: rows of weights have a number per state.
_LONGEST = 10_000

#: What one is in SI units, by each unit of one kind; the SI unit first.
Units = Sequence[Mapping[str, float]]

Default = TypeVar("Default")


def quantity(value: object, units: Units = ()) -> float:
    """A number, or text of a number without a unit or with one of the units, which it then remembers.

    True and false are no numbers.

    Examples
    --------
    >>> quantity("5ms", (SECONDS,))
    0.005
    """
    if isinstance(value, Stated) or type(value) is float:
        return value
    if isinstance(value, str):
        parts = split(value)
        unit = lettered(parts[1]) if parts else ""
        known = next((scale for scale in units if unit in scale), None)
        if parts is None or (unit and known is None):
            raise Unreadable(value, units)
        parsed = float(parts[0])
        if math.isinf(parsed) and "inf" not in parts[0]:
            raise ValueError(value_text(value))  # beyond all floats, which is not what "none" means
        return parsed if known is None else Stated(parsed * known[unit], *parts, next(iter(known)))
    kind = type(value)
    is_number = issubclass(kind, (int, float, np.number)) and not issubclass(kind, (bool, np.bool_))
    parsed = real_number(value) if is_number else math.nan
    if np.isnan(parsed) and not issubclass(kind, (float, np.floating)):  # also an integer beyond all floats
        raise ValueError(value_text(value))
    return parsed


def several(
    value: object, units: Units = (), read: Callable[[object, Units], float] = quantity
) -> tuple[float, ...]:
    """Numbers as of `quantity`, or of another reader, one or several; as text between commas.

    Examples
    --------
    >>> several("0.5, 180deg", (TURNING, SLIDING))
    (0.5, 3.141592653589793)
    """
    if isinstance(value, str):
        parts: list[object] = [*value.split(",")]
    else:
        parts = _sequence(value) if _is_sequence(value) else [value]
    if not parts:
        raise ValueError(value_text(value))
    return tuple(read(part, units) for part in parts)


def interval(text: str) -> tuple[float, float]:
    """Two ends between two dots, in SI units or with units of their own.

    Examples
    --------
    >>> interval("-90deg..90deg"), interval("0..inf")
    ((-1.5707963267948966, 1.5707963267948966), (0.0, inf))
    """
    low, dots, high = text.partition("..")
    if not dots:
        raise ValueError(value_text(text))
    return float(quantity(low, _QUANTITIES)), float(quantity(high, _QUANTITIES))


def one_or_several(
    value: object, units: Units = (), read: Callable[[object, Units], float] = quantity
) -> float | tuple[float, ...]:
    """One number for all joints or signals, or one for each.

    Examples
    --------
    >>> one_or_several("2.5, 0.5m/s", ({"rad/s": 1.0}, {"m/s": 1.0}))
    (2.5, 0.5)
    """
    numbers = several(value, units, read)
    return (
        numbers[0] if len(numbers) == 1 and (isinstance(value, str) or not _is_sequence(value)) else numbers
    )


def variances(value: object, units: Units = ()) -> float | tuple[float, ...]:
    """Variances, one or several: text with a unit is an rms value, a number without a unit the variance itself.

    Examples
    --------
    >>> variances("0.5rad, 1e-8", ({"rad": 1.0},))
    (0.25, 1e-08)
    """
    return one_or_several(value, units, _variance)


def _variance(value: object, units: Units) -> float:
    """The variance of one signal; negative for a negative rms value, which is refused."""
    rms = quantity(value, units)
    if not isinstance(value, str) or not isinstance(rms, Stated):
        return rms
    return Stated(rms * abs(rms), rms.number, rms.unit, rms.si)


lengths = functools.partial(several, units=(SLIDING,))


def _poses(value: object) -> tuple[tuple[float, ...], ...]:
    each = [value] if isinstance(value, str) else _sequence(value)
    return tuple(several(pose if isinstance(pose, str) else _sequence(pose), _POSITIONS) for pose in each)


def angle_unit_of(*values: object) -> str | None:
    """The unit of angles that texts among the values state, "deg" or "rad"; None for numbers alone."""
    texts = " ".join(part for value in values for part in _texts(value))
    return "deg" if re.search("deg|°|arc", texts) else "rad" if "rad" in texts else None


def _integer(value: object) -> int:
    if isinstance(value, str):
        return int(value)
    if not is_integer(value):
        raise ValueError(value_text(value))
    return int(value)


def _integers(value: object) -> tuple[int, ...]:
    several = value.split(",") if isinstance(value, str) else _sequence(value)
    return tuple(sorted({_integer(part) for part in several}))


def _flag(value: object) -> bool:
    if isinstance(value, (bool, np.bool_)):
        return bool(cast("object", value))
    raise ValueError(value_text(value))


def names(value: object) -> tuple[str, ...]:
    """Names in a list, or between commas."""
    parts = value.split(",") if isinstance(value, str) else _sequence(value)
    if not all(isinstance(part, str) for part in parts):
        raise ValueError(value_text(value))
    return tuple(part for part in map(str.strip, cast("list[str]", parts)) if part)


def choice(value: object) -> object:
    """A choice in lower case."""
    return value.strip().lower() if isinstance(value, str) else value


def _weights(value: object) -> object:
    """Weights by name or one per state or in rows; text is read, and what is code or a `Penalty` stays as it is."""
    from flexhinf.plant import Penalty

    if isinstance(value, Penalty) or callable(value):
        return value
    if isinstance(value, str):
        if "=" not in value:
            return tuple(quantity(part) for part in value.split(","))
        pairs = [part.partition("=") for part in value.split(",")]
        return {name.strip(): quantity(weight) for name, _, weight in pairs}
    if isinstance(value, Mapping):
        items = cast("Mapping[str, object]", value)
        if not items:
            raise ValueError(value_text(items))
        return {name: _row(item) if _is_sequence(item) else quantity(item) for name, item in items.items()}
    rows = _sequence(value)
    if not any(_is_sequence(row) for row in rows):
        return _row(rows)
    if len({len(_sequence(row)) for row in rows}) > 1:
        raise ValueError(value_text(value))
    return tuple(_row(row) for row in rows)


def _row(values: object) -> tuple[float, ...]:
    row = tuple(quantity(value) for value in _sequence(values))
    if not row:
        raise ValueError(values)
    return row


class Unreadable(ValueError):
    """Text that is no number with one of some units.

    `meant`: the text with its unit spelled as in the SI; empty where that is none of the units, or is ambiguous.
    """

    def __init__(self, value: str, units: Sequence[Mapping[str, float]]) -> None:
        super().__init__(value_text(value))
        pairs = [split(text) for text in respelled(value, *(next(iter(known)) for known in units))]
        meant = ["".join(pair) for pair in pairs if pair and any(pair[1] in known for known in units)]
        self.meant = meant[0] if len(meant) == 1 else ""


def _is_sequence(value: object) -> bool:
    return (is_array(value) and value.ndim > 0) or (
        isinstance(value, Sequence) and not isinstance(value, (str, bytes, bytearray, memoryview))
    )


def _sequence(value: object) -> list[object]:
    entries = cast("Sequence[object]", value)
    if not _is_sequence(value) or len(entries) > _LONGEST:
        raise ValueError(value_text(value))
    return np.asarray(value).tolist() if is_array(value) else list(entries)


def _texts(value: object, depth: int = 2) -> list[str]:
    if isinstance(value, str):
        return [value]
    if depth and _is_sequence(value) and len(cast("Sequence[object]", value)) <= _LONGEST:
        return [text for part in _sequence(value) for text in _texts(part, depth - 1)]
    return []


# Types of fields: how a value is read, its range, and the range in words ---------------------------
@dataclasses.dataclass(frozen=True)
class Allowed:
    """Description of the values that are allowed, as `a number > 0`."""

    text: str


class Marker:
    """A marker of pydantic in an annotation, by its name and arguments: pydantic is imported where a value is read.

    To pydantic it is `annotated_types.GroupedMetadata`.
    """

    __is_annotated_types_grouped_metadata__ = True

    def __init__(self, name: str, *arguments: object, **named: object) -> None:
        self._name, self._arguments, self._named = name, arguments, named

    def __iter__(self) -> Iterator[object]:
        marker = getattr(pydantic, self._name)(*self._arguments, **self._named)
        yield from marker.metadata if self._name == "Field" else (marker,)


#: A value is read by this function, before it is checked; bounds.
read_by, _field = functools.partial(Marker, "BeforeValidator"), functools.partial(Marker, "Field")


def _as_stated(value: object, check: Callable[[object], float]) -> float:
    """The checked number, with the unit in which it was stated: pydantic makes plain floats."""
    checked = check(value)
    return value if isinstance(value, Stated) else checked


def _by(reader: Callable[..., object], *units: Mapping[str, float]) -> Marker:
    """What stands without a unit is in the SI unit: rad, m, rad/s, m/s, s, N·m or N."""
    return read_by(functools.partial(reader, units=units))


_finite = functools.partial(_field, allow_inf_nan=False)
_POSITIVE, _NOT_NEGATIVE = _finite(gt=0.0), _finite(ge=0.0)
_KEPT = Marker("WrapValidator", _as_stated)
_Finite = Annotated[float, _finite(), _KEPT]
_Above = Annotated[float, _POSITIVE, _KEPT]
_AtLeast = Annotated[float, _NOT_NEGATIVE, _KEPT]
Number = Annotated[float, _finite(), read_by(quantity), Allowed("a number")]
Positive = Annotated[float, _POSITIVE, read_by(quantity), Allowed("a number > 0")]
NotNegative = Annotated[float, _NOT_NEGATIVE, read_by(quantity), Allowed("a number >= 0")]
AboveOne = Annotated[float, _finite(gt=1.0), read_by(quantity), Allowed("a number > 1")]
Ratio = Annotated[float, _finite(ge=0.0, lt=1.0), read_by(quantity), Allowed("a number, a ratio from 0 to 1")]
Probability = Annotated[float, _finite(gt=0.0, lt=1.0), read_by(quantity), Allowed("a number > 0 and < 1")]
Seconds = Annotated[float, _NOT_NEGATIVE, _by(quantity, SECONDS), Allowed("a time >= 0, s")]
Duration = Annotated[float, _POSITIVE, _by(quantity, SECONDS), Allowed("a time > 0, s")]
Period = Annotated[
    float, _finite(ge=1e-5, le=0.1), _by(quantity, SECONDS), Allowed("a time from 1e-5 to 0.1 s")
]
Count = Annotated[int, _field(ge=0), read_by(_integer), Allowed("an integer >= 0")]
Seed = Annotated[int, _field(ge=0, lt=2**63), read_by(_integer), Allowed("an integer >= 0, below 2^63")]
Flag = Annotated[bool, read_by(_flag), Allowed("true or false")]
#: The text of the robot's own pose, which is read as no positions.
HOME = "home"


def _positions(value: object) -> object:
    """One position per joint; none for `HOME`, and for what it was read as."""
    home = isinstance(value, str) and choice(value) == HOME
    return () if home or str(value) == "()" else several(value, units=_POSITIONS)


Pose = Annotated[
    tuple[_Finite, ...], read_by(_positions),
    Allowed("one link position per joint (rad, m; or text with deg, °), or home"),
]  # fmt: skip
Tolerances = Annotated[
    Annotated[tuple[_Above, ...], _field(min_length=1)], _by(several, *_POSITIONS),
    Allowed("a number > 0, or one per joint (rad, m; or text with deg, mm)"),
]  # fmt: skip
Poses = Annotated[tuple[tuple[_Finite, ...], ...], read_by(_poses), Allowed("a list of poses")]
Frequencies = Annotated[
    _Above | tuple[_Above, ...], _by(one_or_several, _FREQUENCIES),
    Allowed("rad/s > 0: a number, or one per joint (or text with Hz)"),
]  # fmt: skip
Frequency = Annotated[float, _POSITIVE, _by(quantity, _FREQUENCIES), Allowed("rad/s > 0 (or text with Hz)")]
_Limit = Annotated[float, _field(gt=0.0), _KEPT]
PerJointEffort = Annotated[
    _Limit | tuple[_Limit, ...], _by(one_or_several, *_EFFORTS),
    Allowed("a number > 0, or one per joint (or text with the unit of the motors' inputs); inf for none"),
]  # fmt: skip
Efforts = Annotated[
    _Above | tuple[_Above, ...], read_by(one_or_several), Allowed("a number > 0, or one per joint")
]
PerJointSpeed = Annotated[
    _Limit | tuple[_Limit, ...], _by(one_or_several, *_SPEEDS),
    Allowed("a number > 0, or one per joint (or text with deg/s, rpm, m/s); inf for none"),
]  # fmt: skip
Quanta = Annotated[
    _AtLeast | tuple[_AtLeast, ...], _by(one_or_several, *_QUANTITIES),
    Allowed("a number >= 0, or one per measured signal (or text with deg, mm, Nm)"),
]  # fmt: skip
Variances = Annotated[
    _Above | tuple[_Above, ...], _by(variances, *_QUANTITIES),
    Allowed("an rms value with a unit, or a variance > 0; or one per measured signal"),
]  # fmt: skip
Distances = Annotated[
    _AtLeast | tuple[_AtLeast, ...], _by(one_or_several, *_POSITIONS),
    Allowed("a number >= 0, or one per joint (or text with deg, mm)"),
]  # fmt: skip
Degrees = Annotated[
    tuple[Annotated[int, _field(ge=2, le=12)], ...], _field(min_length=1), read_by(_integers),
    Allowed("a list of integers from 2 to 12, degrees of V"),
]  # fmt: skip
Text = Annotated[str, Allowed("text")]
Real = Annotated[float, read_by(quantity), Allowed("a number")]  # what is used checks its range
Whole = Annotated[int, read_by(_integer), Allowed("an integer")]
Threads = Annotated[int, _field(ge=1, le=1024), read_by(_integer), Allowed("an integer from 1 to 1024")]
CHOICE = read_by(choice)  # of a `Literal`
Names = Annotated[tuple[str, ...], read_by(names), Allowed("a list of names")]
Weights = Annotated[
    Any, read_by(_weights), Allowed("weights by name, one per state, or rows of a matrix"),
    Marker("WithJsonSchema", {"anyOf": [{"type": "object"}, {"type": "array"}]}),
]  # fmt: skip


# Declarations --------------------------------------------------------------------------------------------
#: Headings of the help, in the order in which they are shown: a question of the user each, and expert options last.
ROBOT, WAY = "Which robot?", "Where should it move?"
LOOP, LIMITS = "What must it achieve?", "What may the motors do?"
SENSORS, UNCERTAIN = "What does it measure, and when?", "What is uncertain?"
LOGGED, COMPARED, PROVED = "What is in the log?", "What is compared?", "What is proved?"
SEARCH = "How hard to search and test?"
RUN, TARGET, WRITTEN, ADVANCED = "How does it run?", "Where will it run?", "Where do results go?", "Advanced"
GROUPS = (
    ROBOT, WAY, LOOP, LIMITS, SENSORS, UNCERTAIN, LOGGED, COMPARED, PROVED, SEARCH, RUN, TARGET, WRITTEN, ADVANCED,
)  # fmt: skip

#: What 0 stands for at the command line where a limit is stated: infinity, also over a limit of the robot.
NO_LIMIT = "no limit"


@dataclasses.dataclass(frozen=True)
class About:
    """Texts on a field for its users: help, example, unit and default."""

    group: str  # one of `GROUPS`; "" for an argument of the command line, which has no name there
    help: str
    example: str = ""  # as on the command line; the same text is understood in Python and in a design file
    unit: str = ""
    zero: str = ""  # meaning of 0 at the command line, where it is not a number of the range
    default: str = ""  # choice where the default is None
    setting: str = ""  # of what is seldom stated the option that it shares, ``--set``

    @property
    def text(self) -> str:
        """Help, what 0 stands for, and the default."""
        zero = f" 0: {self.zero}." if self.zero else ""
        return self.help + zero + (f" Default: {self.default}." if self.default else "")


@dataclasses.dataclass(frozen=True, eq=False)
class FieldInfo:
    """One field, as the command line, the design file and the docs see it."""

    name: str
    about: About
    kind: Any  # Its type, with how it is read and its range
    allowed: str  # Its range in words
    default: Any
    option: str  # Its option, which has its name, or ``--set load``; of a flag both, ``--mujoco/--no-mujoco``

    @property
    def switch(self) -> str:
        """Its option; of a flag the one that switches it on."""
        return self.option.partition("/")[0]

    @property
    def is_path(self) -> bool:
        """Whether it is a file or a folder, or several."""
        return Path in (self.kind, *get_args(self.kind))

    @property
    def several(self) -> bool:
        """Whether it is a list, each of whose values the command line takes by itself."""
        return list in (get_origin(self.kind), *map(get_origin, get_args(self.kind)))

    @functools.cached_property
    def adapter(self) -> pydantic.TypeAdapter[Any]:
        """Reads a value."""
        return pydantic.TypeAdapter(self.kind)

    def read(self, value: object) -> object:
        """A value in SI units, checked against its range. Raises `InvalidInput`, its advice an example."""
        if self.is_path:
            for path in cast("Iterable[object]", value) if self.several else [value]:
                checked_path(self.option if self.about.group else self.about.unit, path)
        try:
            return self.adapter.validate_python(value)
        except UnicodeEncodeError as error:
            found = f"expected text in UTF-8, got {value_text(error.object)}"
            raise InvalidInput(refused(self.name), found, "text that can be printed") from None
        except pydantic.ValidationError as error:
            first = error.errors(include_url=False)[0]
            own = first.get("ctx", {}).get("error")
            if isinstance(own, InvalidInput):
                raise own from None
            example = own.meant if isinstance(own, Unreadable) and isinstance(value, str) else ""
            if self.name == "period" and first["type"] == "less_than_equal" and str(value).isnumeric():
                example = f"{float(str(value)):g}ms"
            unit = self.about.unit
            example = example or self._without_unit(value)
            among = f" ({unit})" if unit and unit not in self.allowed else ""
            among = " of samples, each one --period long" if unit == "samples" else among
            found = f"expected {self.allowed}{among}, got {value_text(value)}"
            raise InvalidInput(refused(self.name), found, example or self.about.example) from None

    def _without_unit(self, value: object) -> str:
        """Text with units as numbers in the unit of the field, which stays where it has several; "" where it has
        others."""
        units = self.about.unit.replace(" or ", ", ").split(", ")
        try:
            parts = [measured(part, *units) for part in value.split(",")] if isinstance(value, str) else []
            return ",".join(f"{part:g}{part.si if len(units) > 1 else ''}" for part in parts)
        except ValueError:
            return ""


def option(value: Default, group: str, help: str, /, *others: str, **named: str) -> Default:
    """A field of a dataclass: its default, `[]` for an empty list, and what people read about it, as for `About`."""
    default: dict[str, Any] = {"default_factory": list} if isinstance(value, list) else {"default": value}
    return dataclasses.field(**default, metadata={"about": About(group, help, *others, **named)})


def setting(value: Default, group: str, help: str, /, *others: str, **named: str) -> Default:
    """An `option` that is seldom stated, and shares one at the command line: ``--set NAME=VALUE``."""
    return option(value, group, help, *others, **named, setting="--set")


def argument(help: str, metavar: str = "", *, default: Any = dataclasses.MISSING) -> Any:
    """A field that has no name at the command line, only a place."""
    return dataclasses.field(default=default, metadata={"about": About("", help, unit=metavar)})


def refused(name: str) -> str:
    """First part of the error about a value of a field."""
    return f"The {name.replace('_', ' ')} cannot be used."


def option_name(name: str) -> str:
    """``peak_effort`` at the command line: ``--peak-effort``."""
    return f"--{name.replace('_', '-')}"


def _option(name: str, about: About, flag: bool) -> str:
    if about.setting:
        return "/".join(f"{about.setting} {name}{value}" for value in (("=yes", "=no") if flag else ("",)))
    return option_name(name) + (f"/--no-{option_name(name)[2:]}" if flag else "")


def with_value(option: str, value: str) -> str:
    """An option with its value, as it is written at the command line.

    Examples
    --------
    >>> with_value("--draws", "5"), with_value("--set rays", "5")
    ('--draws 5', '--set rays=5')
    """
    return f"{option}{'=' if option.startswith('--set ') else ' '}{value}"


def declared(cls: type) -> dict[str, FieldInfo]:
    """The options that are declared in a dataclass, by name."""
    kinds, fields = get_type_hints(cls, include_extras=True), dict[str, FieldInfo]()
    for field in dataclasses.fields(cls):
        if "about" in field.metadata:
            default: object = [] if field.default_factory is not dataclasses.MISSING else field.default
            fields[field.name] = field_info(field.name, field.metadata["about"], kinds[field.name], default)
    return fields


def field_info(name: str, about: About, kind: object, default: object = None) -> FieldInfo:
    """A field of this name, type and default."""
    flag = default is True or default is False
    return FieldInfo(name, about, kind, _allowed(kind), default, _option(name, about, flag))


def _allowed(annotation: object) -> str:
    if get_origin(annotation) is Literal:
        return ", ".join(get_args(annotation))
    own = [part.text for part in getattr(annotation, "__metadata__", ()) if isinstance(part, Allowed)]
    return next((text for text in (*own, *map(_allowed, get_args(annotation))) if text), "")


def with_parameters(text: str, fields: Mapping[str, FieldInfo]) -> str:
    """A docstring with fields as its section "Parameters", before "Raises"."""
    lines = ["    Parameters", "    ----------"]
    for field in fields.values():
        default = field.about.default or ("none" if field.default in (None, ()) else repr(field.default))
        lines.append(f"    {field.name} : {field.allowed}; default: {default}")
        lines += textwrap.wrap(field.about.help, 110, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return text.replace("    Raises\n", "\n".join([*lines, "", "    Raises\n"]))
