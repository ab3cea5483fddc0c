"""How an option is declared: once, as a field of a frozen dataclass made by `option`.

Command line, design file, JSON schema, ``help()`` and the tables in docs/ are made from these fields.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import textwrap
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from flexhinf.design.units import Allowed, Duration, Real, Text, Unreadable, Whole
from flexhinf.errors import InvalidInput
from flexhinf.validation import checked_path, value_text

#: Headings of the help, in the order in which they are shown: a question of the user's each. Seldom used options last.
WAY, LOOP, LIMITS, HARDWARE = "Where it moves", "What the loop must do", "Limits", "Robot, sensors, estimator"
TRIED, COMPARED, PROVED, SAMPLED = "What is tried", "What is compared", "What is proved", "What is sampled"
RUN, WRITTEN, ADVANCED = "How it runs", "What is written", "Advanced"
GROUPS = (WAY, LOOP, LIMITS, HARDWARE, TRIED, COMPARED, PROVED, SAMPLED, RUN, WRITTEN, ADVANCED)

#: What 0 stands for at the command line where a limit is stated: infinity, also over a limit of the robot.
NO_LIMIT = "no limit"


@dataclasses.dataclass(frozen=True)
class About:
    """What people read about a field."""

    group: str  # one of `GROUPS`; "" for an argument of the command line, which has no name there
    help: str
    example: str = ""  # as on the command line; the same text is understood in Python and in a design file
    unit: str = ""
    zero: str = ""  # meaning of 0 at the command line, where it is not a number of the range
    default: str = ""  # choice where the default is None

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
    option: str  # Its option, which has its name; of a flag both, ``--mujoco/--no-mujoco``

    @property
    def is_path(self) -> bool:
        """Whether it is a file or a folder, or several."""
        return Path in (self.kind, *get_args(self.kind))

    @property
    def several(self) -> bool:
        """Whether it is a list, each of whose values the command line takes by itself."""
        return list in (get_origin(self.kind), *map(get_origin, get_args(self.kind)))

    @functools.cached_property
    def adapter(self) -> TypeAdapter:
        """Reads a value."""
        return TypeAdapter(self.kind)

    def read(self, value: Any) -> Any:
        """A value in SI units, checked against its range. Raises `InvalidInput`, its advice an example."""
        if self.is_path:
            for path in value if self.several else [value]:
                checked_path(self.option if self.about.group else self.about.unit, path)
        try:
            return self.adapter.validate_python(value)
        except UnicodeEncodeError as error:
            what, found = f"The {spaced(self.name)} is no text in UTF-8.", f"got {value_text(error.object)}"
            raise InvalidInput(what, found, "text that can be printed") from None
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            own = first.get("ctx", {}).get("error")
            if isinstance(own, InvalidInput):
                raise own from None
            example = own.meant if isinstance(own, Unreadable) and isinstance(value, str) else ""
            if self.name == "period" and first["type"] == "less_than_equal" and str(value).isnumeric():
                example = f"{float(value):g}ms"
            found = f"expected {self.allowed}, got {value_text(value)}"
            raise InvalidInput(refused(self.name), found, example or self.about.example) from None


def option(value: Any, group: str, help: str, /, *others: str, **named: str) -> Any:
    """A field of a dataclass: its default, a `list` for an empty one, and what people read about it, as for `About`."""
    about = About(group, help, *others, **named)
    made: dict[str, Any] = {"default_factory": list} if value is list else {"default": value}
    return dataclasses.field(**made, metadata={"about": about})


def argument(help: str, metavar: str = "", *, default: Any = dataclasses.MISSING) -> Any:
    """A field that has no name at the command line, only a place."""
    about = About("", help, unit=metavar)
    return dataclasses.field(default=default, metadata={"about": about})


def spaced(name: str) -> str:
    """The name of a field as words."""
    return name.replace("_", " ")


def refused(name: str) -> str:
    """First part of the error about a value of a field."""
    return f"The {spaced(name)} cannot be used."


def option_name(name: str) -> str:
    """``peak_effort`` at the command line: ``--peak-effort``."""
    return f"--{name.replace('_', '-')}"


def declared(cls: Any) -> dict[str, FieldInfo]:
    """The options that are declared in a dataclass, by name."""
    kinds, found = get_type_hints(cls, include_extras=True), {}
    for field in dataclasses.fields(cls):
        if "about" in field.metadata:
            name, default = field.name, field.default
            flag = f"/--no-{option_name(name)[2:]}" if default is True or default is False else ""
            default = [] if field.default_factory is not dataclasses.MISSING else default
            about, kind = field.metadata["about"], kinds[name]
            found[name] = FieldInfo(name, about, kind, _allowed(kind), default, option_name(name) + flag)
    return found


def _allowed(annotation: Any) -> str:
    """The first range in words that stands in a type."""
    for part in getattr(annotation, "__metadata__", ()):
        if isinstance(part, Allowed):
            return part.words
    return next((words for part in get_args(annotation) if (words := _allowed(part))), "")


def with_parameters(cls: Any) -> str:
    """The docstring of a dataclass with its declared options as the section "Parameters", before "Raises"."""
    lines = ["    Parameters", "    ----------"]
    for field in declared(cls).values():
        default = field.about.default or ("none" if field.default in (None, ()) else repr(field.default))
        lines.append(f"    {field.name} : {field.allowed}; default: {default}")
        lines += textwrap.wrap(field.about.help, 110, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return str(cls.__doc__).replace("    Raises\n", "\n".join([*lines, "", "    Raises\n"]))


@dataclasses.dataclass(frozen=True)
class CampaignOptions:
    """What a campaign adds to a design; every field but `tolerances` is an option of ``flexhinf campaign``."""

    # fmt: off
    samples: Whole = option(1000, SAMPLED, "How many robots.", "1000")
    seed: Whole = option(0, ADVANCED, "Sample i depends on it and on i alone.", "0")
    batch: Whole = option(256, ADVANCED, "Samples of a file of the journal: what SIGKILL may cost.", "256")
    distribution: Text = option("uniform", SAMPLED,
        "Within the tolerances: uniform, normal (the tolerance is 3σ), truncated-normal, corners.", "normal")
    method: Text = option("random", SAMPLED,
        "How samples are spread: random (independent), latin-hypercube, sobol.", "sobol")
    #: Parameters of the robot and what they are instead: ``("stiffness", "15%")`` or ``("mass", "0.9..1.2")``.
    tolerances: tuple[tuple[str, str], ...] = ()
    payload: Text | None = option(None, HARDWARE,
        "What the true robot carries, 0..2kg; the controller stays the design's.", "0..2kg", "kg@link",
        default="that of the design")
    initial_error: Real = option(0.0, SAMPLED,
        "The robot starts up to so much beside where the estimator believes it, rad or m.", "0.01", "rad, m")
    disturbance: Real = option(0.0, SAMPLED,
        "A constant torque on each link of up to so much, N·m or N, from a tenth of the run on.", "0.1", "N·m or N")
    duration: Duration | None = option(None, RUN, "Length of a run.", "5s", "s", zero="the default",
        default="that of the design")
    # fmt: on

    def __post_init__(self) -> None:
        from flexhinf.campaign import (  # not for `flexhinf --help`
            DISTRIBUTIONS,
            METHODS,
            check_counts,
            one_of,
        )

        check_counts(self.samples, self.seed, self.batch)
        one_of("distribution", self.distribution, DISTRIBUTIONS)
        one_of("method", self.method, METHODS)
        for name in ("initial_error", "disturbance"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                found = f"expected a number >= 0, the half width of its interval, got {value_text(value)}"
                raise InvalidInput(f"The {spaced(name)} is not usable.", found, "0.01")
