"""Definitions of requirements, by name: what is measured, its limit, and the field that states the limit.

`RequirementKind` has name, unit, sense, criterion and limit of a requirement, and the function that measures it on
single motions or loops. A file here, or one of another package, registers one. With its `help` a kind declares its
field: options, design files, schema and `Specification` take their limits from here (`limit_fields`). Help needs all
fields, so what computes is imported late.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from flexhinf import options
from flexhinf.designs.requirements.measured import Motion, RestingLoop
from flexhinf.designs.requirements.requirement import Requirement
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.extensions import Registry
from flexhinf.options import LOOP
from flexhinf.validation import late_package, value_text

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Vector
else:
    np = late_package("numpy")

#: The unit of what is measured in that of a joint's position.
POSITION = "rad, m"

#: How a limit is written, by its unit; in any other it is a positive number.
LIMITS: dict[str, Any] = {POSITION: options.Tolerances | None, "s": options.Duration | None}

#: A limit: one number or one for each joint; None where nothing is required.
Limit: TypeAlias = "float | Sequence[float] | Vector | None"


class Stating(Protocol):
    """A specification, as far as requirements read it beside the fields of limits."""

    @property
    def estimator(self) -> str:
        """The name of the estimator."""
        ...

    def stated_by(self, name: str) -> str:
        """The option that states a field, or "default"."""
        ...


@dataclass(frozen=True, eq=False)
class Allowance:
    """On what the limit of a motion depends beside the specification."""

    joints: tuple[str, ...]
    resolution: float  # Of a link position, rad or m
    travel: Any  # (n,), or 0 where it does not matter, rad or m
    rests: bool  # Whether the run is a move that rests long enough for the travel not to matter


#: The allowance of something that does not move.
NO_MOTION = Allowance((), 0.0, 0.0, False)


@dataclass(frozen=True)
class RequirementKind:
    """What a requirement is: name, unit, sense, criterion, limit, and how it is measured.

    `of_motion` gives one number, or one for each joint (n,), of a run; NaN where a joint has none, and None where none
    has. Of one for each sample and joint (N, n) the largest counts, at its time. `of_loop` gives the number of a
    linearised loop at rest. Of several runs or loops the worst is judged.
    """

    name: str  # In lists, and of its own option, ``--set NAME=VALUE``
    what: str  # In tables
    criterion: str  # Definition of what is measured
    unit: str = ""  # `POSITION` for the unit of each joint's position
    at_most: bool = True  # Whether the limit is an upper one
    # Field of a specification that states the limit; "" if none does, or of a kind with `help` its name
    field: str = ""
    help: str = ""  # On its field; with it the kind declares the field
    example: str = ""  # Of its field
    default: float | None = None  # Limit where none is stated; None for no requirement
    without: str = ""  # What holds where none is stated, in words; by default the number
    within: Any = None  # How its field is read, and its range; by default by the unit
    steps: bool = False  # Whether it is of steps alone, and not of moves
    searched: bool = False  # Whether searches of a law keep it
    bounded: bool = False  # Whether limits of the joints are its limits, and no field
    usual: bool = False  # Whether its field has an option of its own, and not ``--set``
    place: float = math.inf  # Among the others, in lists of fields and of requirements
    of_motion: Callable[[Motion], Any] | None = None
    of_loop: Callable[[RestingLoop], Any] | None = None
    key: str = ""  # Name of the numbers of `of_motion`, by default `name`
    # Limit that depends on more than its field
    allowed: Callable[[Any, Allowance], Limit] | None = None
    info: options.FieldInfo | None = None  # The field that `register` declares

    @property
    def metric(self) -> str:
        """Name of what `of_motion` measures, in tables of joints and in result files."""
        return self.key or self.name

    def stated(self, s: Stating) -> Any:
        """The limit that a specification states; None where it states none, or no field does."""
        return getattr(s, self.field) if self.field else None

    def limit(self, s: Stating, about: Allowance = NO_MOTION) -> Limit:
        """What is required by a specification, of something `about` which more is known."""
        if self.allowed is not None:
            return self.allowed(s, about)
        stated = self.stated(s)
        return self.default if stated is None else stated

    def number(self, s: Stating) -> float:
        """The limit of what has one number; where nothing is required infinity, of a lower limit 0."""
        limit = self.limit(s)
        return (np.inf if self.at_most else 0.0) if limit is None else float(np.max(limit))

    def measured(self, motion: Motion) -> Vector | None:
        """The numbers (n,) of a motion; None where it has none. Raises `InvalidInput` for what is no such number."""
        located = self.located(motion)
        return None if located is None else located[0]

    def located(self, motion: Motion) -> tuple[Vector, Vector] | None:
        """The numbers (n,) of a motion with their times (n,), s, NaN where they have none; otherwise as `measured`."""
        joints: int = motion.positions.shape[1]
        missing = self.of_motion is None or (self.steps and not motion.step)
        values = None if missing or self.of_motion is None else self.of_motion(motion)
        if values is None:
            return None
        try:
            numbers = np.asarray(values, dtype=float)
            if numbers.shape == motion.positions.shape:
                rows: np.ndarray = np.argmax(numbers if self.at_most else -numbers, axis=0)
                largest: Vector = numbers[rows, np.arange(joints)]
                times: Vector = motion.time.take(rows)
                return largest, times
            return np.broadcast_to(numbers, (joints,)), np.full(joints, np.nan, dtype=float)
        except (TypeError, ValueError):
            raise InvalidInput(
                f"The requirement {self.name!r} measures no number.",
                f"expected one number, or {joints}, got {value_text(values)}",
                "np.array([...]) with a number for each joint",
            ) from None

    def judge(self, s: Stating | None, limit: float, value: float, where: str, **more: Any) -> Requirement:
        """The requirement with its numbers; `more` replaces what the kind says."""
        own: dict[str, Any] = {
            "unit": "" if self.unit == POSITION else self.unit,
            "at_most": self.at_most,
            "criterion": self.criterion,
            "field": self.field,
            "stated_by": "default" if s is None or not self.field else s.stated_by(self.field),
        }
        return Requirement(
            more.pop("what", self.what), float(limit), float(value), where=where, **(own | more)
        )


#: All kinds, by name.
REQUIREMENTS: Registry[RequirementKind] = Registry("requirement", __package__ or "", lambda kind: kind.place)

#: Names that a specification has beside its limits, see `reserve`.
_reserved: set[str] = set()


def reserve(names: Iterable[str]) -> None:
    """Keep names of a specification's own for it. Raises `InvalidInput` where a limit has one already."""
    _reserved.update(names)
    for kind in REQUIREMENTS.registered():
        if kind.info is not None:
            _check_field(kind.info.name)


def limit_fields() -> dict[str, options.FieldInfo]:
    """The fields that requirements declare, by name; files of requirements are read for it."""
    return {kind.info.name: kind.info for kind in REQUIREMENTS.values() if kind.info is not None}


def _check_field(name: str) -> None:
    refuse_if(
        name in _reserved or not name.isidentifier(),
        f"The limit {name!r} cannot be a field of a specification.",
        f"expected a name in Python that no field has, got {name!r}",
        f"my_{name.replace('-', '_')}",
    )


def register(kind: RequirementKind) -> RequirementKind:
    """Add a kind of requirement, and with its `help` the field and the option of its limit; returns the kind.

    Raises `InvalidInput` for a name that is there already or cannot be used.
    """
    REQUIREMENTS.check(kind.name)
    if not kind.help:
        return REQUIREMENTS.register(kind)
    refuse_if(
        kind.of_motion is None and kind.of_loop is None,
        f"Nothing measures the requirement {kind.name!r}.",
        "expected a function of a motion or of a loop, got none",
        "of_motion=…, a function of a Motion that returns a number for each joint",
    )
    name = kind.field or kind.name
    _check_field(name)
    without = kind.without or ("no requirement" if kind.default is None else f"{kind.default:g}")
    setting, unit = "" if kind.usual else "--set", kind.unit
    about = options.About(LOOP, kind.help, kind.example, unit, default=without, setting=setting)
    within = LIMITS.get(kind.unit, options.Positive | None) if kind.within is None else kind.within
    return REQUIREMENTS.register(replace(kind, field=name, info=options.field_info(name, about, within)))


def register_rows(rows: Mapping[str, tuple[str, str, str, str, str]]) -> None:
    """Add kinds that something else measures, by name: what, unit, sign, field and criterion of each."""
    for name, (what, unit, sign, field, criterion) in rows.items():
        register(RequirementKind(name, what, criterion, unit, sign == "≤", field, place=0.0))


def on_motions() -> tuple[RequirementKind, ...]:
    """Kinds that are measured on motions."""
    return tuple(kind for kind in REQUIREMENTS.values() if kind.of_motion is not None)


def on_loops() -> tuple[RequirementKind, ...]:
    """Kinds that are measured on loops at rest."""
    return tuple(kind for kind in REQUIREMENTS.values() if kind.of_loop is not None)
