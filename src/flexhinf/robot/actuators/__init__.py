"""Published numbers of joints by name, each with its source and, where that states one, its spread."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from flexhinf.robot.elastic import SPRING

#: The two forms in which the inertia on the motor's side is stated; a joint that has one takes nothing of the other.
INERTIAS = ({"motor_inertia"}, {"rotor_inertia", "hub_inertia"})


class PublishedJoint(NamedTuple):
    """What is published of a joint: a text, and tables of numbers as in [joint.spring] and [joint.motor]."""

    about: str
    numbers: dict[str, dict[str, Any]]

    @property
    def sources(self) -> list[str]:
        """Where the numbers are from, each once."""
        return list(dict.fromkeys(str(number["source"]) for number in self.numbers.values()))

    def beside(self, stated: set[str], rigid: bool) -> dict[str, dict[str, Any]]:
        """The numbers that a joint takes which states others; a rigid one has none of a spring."""
        one, other = INERTIAS
        lost = {
            *stated,
            *(SPRING if rigid else ()),
            *(other if stated & one else one if stated & other else ()),
        }
        return {name: number for name, number in self.numbers.items() if name not in lost}


@cache
def published_joints() -> dict[str, PublishedJoint]:
    """All of them by name, for ``actuator = "NAME"`` in a robot file.

    >>> published_joints()["lwr2-2"].numbers["motor_inertia"]["value"]
    4.447
    """
    text = (Path(__file__).parent / "published.toml").read_text(encoding="utf-8")
    return {
        name: PublishedJoint(row["about"], {**row.get("spring", {}), **row.get("motor", {})})
        for name, row in tomllib.loads(text).items()
    }
