"""Published numbers of joints, of gears too, by name, each with its source and, where that states one, its spread."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from flexhinf.robot.elastic import SPRING
from flexhinf.robot.gears import CURVE
from flexhinf.validation import nearest

#: The two forms in which the inertia on the motor's side is stated; a joint that has one takes nothing of the other.
INERTIAS = ({"motor_inertia"}, {"rotor_inertia", "hub_inertia"})


class PublishedJoint(NamedTuple):
    """What is published of a joint: a text, tables of numbers as in [joint.spring] and [joint.motor], and names that
    its maker's files give it."""

    about: str
    numbers: dict[str, dict[str, Any]]
    joints: tuple[str, ...] = ()

    @property
    def sources(self) -> list[str]:
        """Where the numbers are from, each once."""
        return list(dict.fromkeys(str(number["source"]) for number in self.numbers.values()))

    def beside(self, stated: set[str], rigid: bool) -> dict[str, dict[str, Any]]:
        """The numbers that a joint takes which states others; a rigid one has none of a spring."""
        one, other = INERTIAS
        lost = {
            *stated,
            # other numbers of a motor are behind the gear
            *(() if "rotor_inertia" in {*stated, *self.numbers} else ("gear_ratio",)),
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
        name: PublishedJoint(
            row["about"], {**row.get("spring", {}), **row.get("motor", {})}, tuple(row.get("joints", ()))
        )
        for name, row in tomllib.loads(text).items()
    }


@cache
def published_gears() -> dict[str, PublishedJoint]:
    """Stiffness curves of gears by series, size and ratio, for ``gear = "NAME"`` in a robot file.

    >>> published_gears()["CSG-25-100"].numbers["second_stiffness"]["value"]
    50000.0
    """
    text = (Path(__file__).parent / "gears.toml").read_text(encoding="utf-8")
    gears = dict[str, PublishedJoint]()
    for brand in tomllib.loads(text).values():
        for series, (size, row) in product(brand["series"], brand["sizes"].items()):
            for kind, slopes in row["slopes"].items():
                values = dict(zip(CURVE, (*slopes, *row["torques"])))
                for ratio in brand["classes"][kind]:
                    numbers = {
                        name: {"value": float(value), "source": brand["source"]}
                        for name, value in {**values, "gear_ratio": ratio}.items()
                    }
                    about = f"strain-wave gear, size {size}, ratio {ratio}"
                    gears[f"{series}-{size}-{ratio}"] = PublishedJoint(about, numbers)
    return gears


def gear_name(text: object) -> str:
    """The name of a gear as a file writes it, in any case."""
    return text.strip().upper() if isinstance(text, str) else ""


def gear_advice(name: str, otherwise: str) -> tuple[str, str]:
    """What is expected in the place of a gear that is not published, and the published name that is nearest to it."""
    series, _, size = name.partition("-")
    known = published_gears()
    same = [other for other in known if other.startswith(f"{series}-{size.partition('-')[0]}-")]
    expected = f"a gear such as {', '.join(same or ['CSG-25-100'])}, which `flexhinf robots` lists"
    return expected, nearest(name, same or known, otherwise)


def published_of(row: Mapping[str, Any]) -> list[PublishedJoint]:
    """What is published of a joint of a robot file, by the names of its actuator and of its gear."""
    known = (
        published_joints().get(str(row.get("actuator", ""))),
        published_gears().get(gear_name(row.get("gear"))),
    )
    return [joint for joint in known if joint is not None]
