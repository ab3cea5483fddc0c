"""Readers of the fields of a specification: which task, law or estimator reads one that others do not.

A field that none of those of a design reads is refused by its name, before any work. No field but ``law``,
``estimator`` and ``pose`` changes what kind of controller is made.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from flexhinf.designs.estimators import ESTIMATORS, estimator_name_at_any_pose, fits_modal
from flexhinf.designs.laws import LAWS, MODAL, NL_HINF, LawKind
from flexhinf.designs.specification import AUTO, FIELDS, PROVED, Specification, SpecificationError
from flexhinf.robot import Robot
from flexhinf.robot.waypoints import LIMITS
from flexhinf.validation import unknown_name, value_text

#: Fields of the one motion to a pose.
OF_POSE = ("start", "shaping", "move", "duration", "overshoot")

#: The law of a task by default: of one pose, and of a workspace.
BY_DEFAULT = {True: NL_HINF, False: MODAL}


def law_of(s: Specification) -> LawKind:
    """The law of a specification: as stated, or that of its task.

    Raises `SpecificationError` for a name of which no design is made.
    """
    name = s.law or BY_DEFAULT[s.pose is not None]
    if name not in LAWS:
        error = unknown_name(f"No design is made with the law {name!r}.", name, LAWS, repr(MODAL))
        raise SpecificationError("law", error.what, error.found, example=error.advice.strip("'"))
    return LAWS[name]


def estimator_of(robot: Robot, s: Specification) -> str:
    """The name of the estimator that runs: as stated, or by law and sensors."""
    if s.estimator != AUTO:
        return s.estimator
    if not law_of(s).any_pose:
        return "ukf"
    return estimator_name_at_any_pose(robot, s)


def unchosen(robot: Robot, s: Specification) -> Specification:
    """A specification that leaves the estimator to law and sensors again, where it is the one that suits them."""
    free = replace(s, estimator=AUTO)
    return free if s.estimator == estimator_of(robot, free) else s


def home_of(robot: Robot) -> tuple[float, ...]:
    """The robot's own pose, rad or m."""
    return tuple(np.array(robot.home, dtype=float).tolist())


def with_home(robot: Robot, s: Specification) -> Specification:
    """A specification whose pose and start are numbers, where they are the robot's own pose."""
    own = {name: home_of(robot) for name in ("pose", "start") if getattr(s, name) == ()}
    return replace(s, **own)


def resolved(robot: Robot, s: Specification) -> Specification:
    """A specification that states pose, law and estimator as they are.

    Raises `SpecificationError` for a law that does not serve the task, an estimator that does not serve the law, and a
    field that none of them reads.
    """
    s = with_home(robot, s)
    kind = law_of(s)
    space = LIMITS if s.workspace is None and s.pose is None else s.workspace
    s = replace(s, law=kind.name, estimator=estimator_of(robot, s), workspace=space)
    _check_law(robot, s, kind)
    _check_estimator(robot, s, kind)
    _check_fields(s, kind)
    return s


def _check_law(robot: Robot, s: Specification, kind: LawKind) -> None:
    home = "pose='home'"
    if not kind.any_pose and s.pose is None:
        raise SpecificationError(
            "law",
            f"The law {kind.name} is made about one pose.",
            "expected `pose` with it, got a workspace",
            f"{home}, which is {value_text(home_of(robot), 60)}; or law={MODAL!r} for a workspace",
        )
    if s.pose is not None and s.workspace is not None:
        raise SpecificationError(
            "workspace",
            "A task is a workspace or one pose.",
            f"expected `workspace` or `pose`, got both: {value_text(s.workspace, 60)} and {value_text(s.pose, 60)}",
            "leave out `workspace`, or leave out `pose`",
        )
    if not kind.fits(robot.drive):
        raise SpecificationError(
            "law",
            f"The law {kind.name} is for other drives.",
            f"expected a robot whose drives take {kind.commands} commands, got drive = {robot.drive!r}",
            f"law={MODAL!r}",
        )


def _check_estimator(robot: Robot, s: Specification, kind: LawKind) -> None:
    if s.estimator == "none":
        return
    own = ESTIMATORS[s.estimator]
    if own.name == MODAL and not (kind.any_pose and fits_modal(robot, s)):
        needed = (
            "the same sensors at every elastic joint" if kind.any_pose else "a law with gains at any pose"
        )
        raise SpecificationError(
            "estimator",
            f"The estimator {own.name} has gains of pairs of a link and a motor.",
            f"expected {needed}, got law={kind.name!r} with measured={list(s.measured)}",
            example=AUTO,
        )
    if own.about_pose and kind.any_pose and s.pose is None:
        raise SpecificationError(
            "estimator",
            f"The estimator {own.name} has the gain of one pose.",
            "expected `pose` with it, got a workspace",
            f"estimator={AUTO!r}, or pose='home'",
        )


def readers() -> Mapping[str, tuple[LawKind, ...]]:
    """Laws that read a field which not every design reads, by the field's name; none for one of the motion to a pose,
    which every law reads there."""
    found: dict[str, list[LawKind]] = {name: [] for name in OF_POSE}
    for kind in LAWS.values():
        for name in kind.fields:
            found.setdefault(name, []).append(kind)
    return {name: tuple(kinds) for name, kinds in found.items()}


def unread(s: Specification) -> dict[str, str]:
    """Fields that law and task do not read, by name: what has to be stated with each."""
    read = {*law_of(s).fields, *(OF_POSE if s.pose is not None else ())}
    return {
        name: " or ".join(f"law={kind.name!r}{'' if kind.any_pose else ' and `pose`'}" for kind in kinds)
        or "`pose`"
        for name, kinds in readers().items()
        if name not in read
    }


def _check_fields(s: Specification, kind: LawKind) -> None:
    for name, needed in unread(s).items():
        value, default = getattr(s, name), FIELDS[name].default
        if value is not default and (default is None or value != default):
            raise SpecificationError(
                name,
                f"The field `{name}` is not read by this design: law {kind.name}, "
                f"{'one pose' if s.pose is not None else 'a workspace'}.",
                f"expected {needed} with it, got {name}={value_text(value, 60)}",
                f"leave out `{name}`, or {_advice(name, s)}",
            )
    if "preset" in kind.fields and kind.any_pose and s.preset not in (None, PROVED):
        raise SpecificationError(
            "preset",
            f"The law {kind.name} has no preset {s.preset}.",
            f"expected {PROVED}, or none, got {s.preset}",
            f"preset={PROVED!r}, or {_advice('preset', s)}",
        )


def _advice(name: str, s: Specification) -> str:
    """What to state for a field, as it is written in Python: of laws that read it, that by default at a pose."""
    laws = {kind.name: kind for kind in readers()[name]}
    if not laws:
        return "pose='home'"
    law = laws.get(NL_HINF) or next(iter(laws.values()))
    return f"law={law.name!r}" + " and pose='home'" * (s.pose is None and not law.any_pose)
