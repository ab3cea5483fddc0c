"""Brakes of joints, which close without power."""

from __future__ import annotations

from collections.abc import Sequence

from flexhinf.errors import refuse_if
from flexhinf.validation import value_text


def checked_brakes(name: str, brakes: Sequence[bool], joints: Sequence[str]) -> tuple[bool, ...]:
    """Whether each joint of a robot has a brake; none has where nothing is stated. InvalidInput: they do not fit."""
    stated: tuple[object, ...] = tuple(brakes) or (False,) * len(joints)
    refuse_if(
        len(stated) != len(joints) or not all(type(brake) is bool for brake in stated),
        f"The brakes of the robot {name!r} do not fit its joints.",
        f"expected True or False for each of {list(joints)}, got {value_text(brakes)}",
        "brakes=() for a robot without any; in a robot file brakes = true of a [[joint]]",
    )
    return tuple(brake is True for brake in stated)
