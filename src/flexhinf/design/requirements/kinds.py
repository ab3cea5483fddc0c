"""Definitions of requirements, by name: what is measured, and its limit.

`RequirementKind` has name, unit, sense, criterion and limit of a requirement. A kind that is measured on single motions
or loops has the function that does it, and a file of its own here; so has one that another package adds, which also
declares the option of its limit. The other kinds stand in the tables of `loop_margins` and `runs`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf import options
from flexhinf.analysis import LinearLoop
from flexhinf.arrays import Matrix, Vector
from flexhinf.design.requirements.requirement import Requirement
from flexhinf.design.specification import FIELDS, Specification, declare_limit
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.extensions import Registry
from flexhinf.loop.simulation import metrics
from flexhinf.options import LOOP
from flexhinf.validation import value_text

#: The unit of what is measured in that of a joint's position.
POSITION = "rad, m"

#: How a limit is written, by its unit; in any other it is a positive number.
LIMITS: dict[str, Any] = {POSITION: options.Tolerances, "s": options.Duration}

#: A limit: one number or one for each joint; None where nothing is required.
Limit = float | Sequence[float] | Vector | None

#: A travel that is rounding, rad or m.
STILL = 1e-9


@dataclass(frozen=True, eq=False)
class Motion:
    """One run to rest, of a step or of a move along a plan, as requirements measure it.

    All joints are columns, in rad or m. `positions` and `velocities` are the true ones of the links.
    """

    time: Vector  # (N,), s
    positions: Matrix  # (N, n)
    velocities: Matrix  # (N, n), rad/s or m/s
    inputs: Matrix  # (N, n), V, A, N·m or N
    planned: Matrix  # (N, n): where the plan is at the same time; the goal of a step
    path: Matrix  # (P, n): the way of the plan
    duration: float  # When the command ends, s; 0 of a step
    plans: bool  # Whether there is a plan that is followed in time
    rests: bool  # Whether the run is long enough for what is measured at rest
    effort: Vector  # (n,). Limits of the inputs; infinite where there is none
    span: Vector  # (n,). Lengths of the joints' ranges
    slides: np.ndarray  # (n,), bool: which joints slide

    @cached_property
    def travel(self) -> Vector:
        """Distance (n,) of the extreme positions on the way."""
        return np.ptp(self.path, axis=0)

    @property
    def moves(self) -> np.ndarray:
        """Which joints travel (n,)."""
        return self.travel > STILL

    @cached_property
    def largest(self) -> Vector:
        """Largest travel (n,) of all joints, in the unit of each."""
        return metrics.largest_travel(self.travel, self.slides, self.span)


@dataclass(frozen=True, eq=False)
class Allowance:
    """On what the limit of a motion depends beside the specification."""

    joints: tuple[str, ...]
    resolution: float  # Of a link position, rad or m
    travel: Any  # (n,), or 0 where it does not matter, rad or m
    rests: bool  # Whether the run is a move that rests long enough for the travel not to matter


@dataclass(frozen=True)
class RequirementKind:
    """What a requirement is: name, unit, sense, criterion, limit, and how it is measured.

    `of_motion` gives one number, or one for each joint (n,), of a run; NaN where a joint has none, and None where none
    has. `of_loop` gives the number of a linearised loop at rest. Of a design for a workspace the worst of all moves and
    poses is judged.
    """

    name: str  # In lists, and of its own option, ``--set NAME=VALUE``
    what: str  # In tables
    criterion: str  # Definition of what is measured
    unit: str = ""  # `POSITION` for the unit of each joint's position
    at_most: bool = True  # Whether the limit is an upper one
    field: str = ""  # The field of a specification that states the limit; "" if none does
    help: str = ""  # On its own option; with it the kind declares a field of its name
    example: str = ""  # Of its own option
    default: float | None = None  # Limit where none is stated; None for no requirement
    of_motion: Callable[[Motion], Any] | None = None
    of_loop: Callable[[LinearLoop], float] | None = None
    key: str = ""  # Name of the numbers of `of_motion`, by default `name`
    allowed: Callable[[Specification, Allowance], Limit] | None = (
        None  # Limit that depends on more than its field
    )

    @property
    def metric(self) -> str:
        """Name of what `of_motion` measures, in tables of joints and in result files."""
        return self.key or self.name

    def limit(self, s: Specification, about: Allowance | None = None) -> Limit:
        """What is required by a specification, of a motion `about` which more is known."""
        if self.allowed is not None and about is not None:
            return self.allowed(s, about)
        stated = getattr(s, self.field) if self.field else None
        return self.default if stated is None else stated

    def measured(self, motion: Motion) -> Vector | None:
        """The numbers (n,) of a motion; None where it has none. Raises `InvalidInput` for what is no such number."""
        joints = motion.positions.shape[1]
        values = None if self.of_motion is None else self.of_motion(motion)
        try:
            return None if values is None else np.broadcast_to(np.asarray(values, dtype=float), (joints,))
        except (TypeError, ValueError):
            raise InvalidInput(
                f"The requirement {self.name!r} measures no number.",
                f"expected one number, or {joints}, got {value_text(values)}",
                "np.array([...]) with a number for each joint",
            ) from None

    def judge(
        self, s: Specification | None, limit: float, value: float, where: str, **more: Any
    ) -> Requirement:
        """The requirement with its numbers; `more` replaces what the kind says."""
        stated = s is not None and self.field and getattr(s, self.field) != FIELDS[self.field].default
        own: dict[str, Any] = {
            "unit": "" if self.unit == POSITION else self.unit,
            "at_most": self.at_most,
            "criterion": self.criterion,
            "field": self.field,
            "stated_by": FIELDS[self.field].option if stated else "default",
        }
        return Requirement(
            more.pop("what", self.what), float(limit), float(value), where=where, **(own | more)
        )


def _place(kind: RequirementKind) -> float:
    """Requirements have the order of their fields."""
    return list(FIELDS).index(kind.field) if kind.field else -1.0


#: All kinds, by name.
REQUIREMENTS: Registry[RequirementKind] = Registry("requirement", __package__ or "", _place)


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
    default = "no requirement" if kind.default is None else f"{kind.default:g}"
    about = options.About(LOOP, kind.help, kind.example, kind.unit, default=default, setting="--set")
    declare_limit(kind.name, about, LIMITS.get(kind.unit, options.Positive))
    return REQUIREMENTS.register(replace(kind, field=kind.name))


def register_rows(rows: Mapping[str, tuple[str, str, str, str, str]]) -> None:
    """Add kinds that something else measures, by name: what, unit, sign, field and criterion of each."""
    for name, (what, unit, sign, field, criterion) in rows.items():
        register(RequirementKind(name, what, criterion, unit, sign == "≤", field))


def on_motions() -> tuple[RequirementKind, ...]:
    """Kinds that are measured on motions."""
    return tuple(kind for kind in REQUIREMENTS.values() if kind.of_motion is not None)


def on_loops() -> tuple[RequirementKind, ...]:
    """Kinds that are measured on loops at rest."""
    return tuple(kind for kind in REQUIREMENTS.values() if kind.of_loop is not None)
