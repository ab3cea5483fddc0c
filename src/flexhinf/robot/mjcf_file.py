"""What stands in an MJCF file outside of its bodies: units, default classes, gravity, actuators and couplings."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.mjcf_elements import Compiler, numbers
from flexhinf.untrusted import checked_name, distinct, value_text

#: Attributes of <compiler> that change masses after the file is read.
CHANGED = {"boundmass": "0", "boundinertia": "0", "settotalmass": "-1", "balanceinertia": "false"}


class MjcfFile:
    """The parts of a file that its bodies refer to.

    Parameters
    ----------
    name : str
        Of the file, for messages.
    root : Element
        <mujoco>.

    Raises
    ------
    InvalidInput
        For units and masses that are not read.
    """

    def __init__(self, name: str, root: Element) -> None:
        self.name, self.root = name, root
        self.compiler = self._compiler()
        self._classes: dict[str, dict[str, dict[str, str]]] = {}
        self._main = "main"
        for default in root.findall("default"):
            self._main = default.get("class", "main")
            self._read_class(default, self._classes.get(self._main, {}), self._main)

    # Units ------------------------------------------------------------------------------------------
    def _compiler(self) -> Compiler:
        values: dict[str, str] = {}
        for element in self.root.findall("compiler"):
            values |= element.attrib
        for key, usual in CHANGED.items():
            if key in values and values[key] != usual and real_text(values[key]) != real_text(usual):
                raise self._refusal(
                    f"<compiler {key}> is not read",
                    f"it changes masses: {values[key]}",
                    "inertials as they are",
                )
        euler = values.get("eulerseq", "xyz")
        if len(euler) != 3 or set(euler.lower()) - set("xyz"):
            raise self._refusal("eulerseq cannot be read", f"got {value_text(euler, 40)}", 'eulerseq="xyz"')
        for key, known in (
            ("angle", ("degree", "radian")),
            ("inertiafromgeom", ("auto", "true", "false")),
            ("autolimits", ("true", "false")),
            ("coordinate", ("local",)),
        ):
            if values.get(key, known[0]) not in known:
                raise self._refusal(
                    f"{key} cannot be read", f"expected {known}, got {value_text(values[key], 40)}", known[0]
                )
        return Compiler(
            values.get("angle", "degree") == "degree", euler,
            values.get("inertiafromgeom", "auto"), values.get("autolimits", "true") == "true",
        )  # fmt: skip

    def _refusal(self, what: str, found: str, advice: str) -> InvalidInput:
        return InvalidInput(f"{self.name}: {what}.", found, advice)

    def gravity(self) -> tuple[float, tuple[float, float, float]]:
        """Strength, m/s², and direction of free fall."""
        vector, air = np.array([0.0, 0.0, -9.81]), 0.0
        for option in self.root.findall("option"):
            stated = numbers(self.name, "<option>", option.attrib, "gravity", (3,))
            vector = vector if stated is None else stated
            if any(flag.get("gravity", "enable") == "disable" for flag in option.findall("flag")):
                vector = np.zeros(3)
            for key in ("density", "viscosity"):
                air = max(air, real_text(option.get(key, "0")))
        if not air == 0.0:
            raise self._refusal("<option> has a medium", "expected density and viscosity 0", "a robot in air")
        size = float(np.linalg.norm(vector))
        x, y, z = (vector / size if size else np.array([0.0, 0.0, -1.0])).tolist()
        return size, (x, y, z)

    # Defaults ---------------------------------------------------------------------------------------
    def _read_class(self, element: Element, above: Mapping[str, dict[str, str]], name: str) -> None:
        own = {tag: dict(values) for tag, values in above.items()}
        for child in element:
            if child.tag != "default":
                own.setdefault(child.tag, {}).update(child.attrib)
        self._classes[name] = own
        for child in element.findall("default"):
            if child.get("class") is None:
                raise self._refusal(
                    "a default class inside another has no name", "got <default>", "class='…'"
                )
            if child.get("class") in self._classes:
                raise self._refusal(
                    f"the default class {value_text(child.get('class'), 60)} stands there twice",
                    "expected distinct names, as MuJoCo does",
                    "another name, or one of the two",
                )
            self._read_class(child, own, child.get("class", ""))

    def childclass(self, element: Element, inherited: str | None) -> str | None:
        """The class of what an element holds."""
        return element.get("childclass", inherited)

    def values(self, element: Element, inherited: str | None) -> dict[str, str]:
        """Attributes of an element over those of its class."""
        name = element.get("class", inherited or self._main)
        if name not in self._classes and name != self._main:
            raise self._refusal(
                f"there is no default class {value_text(name, 60)}",
                f"expected one of {sorted(self._classes)}"
                if self._classes
                else "expected none: there are no classes",
                "one of these" if self._classes else "leave out class and childclass",
            )
        values = {**self._classes.get(name, {}).get(str(element.tag), {}), **element.attrib}
        values.pop("class", None)
        return values

    # Joints -----------------------------------------------------------------------------------------
    def joint_names(self) -> list[str]:
        """Of all joints of all bodies, in the order of the file."""
        found = [joint for world in self.root.findall("worldbody") for joint in world.iter("joint")]
        names = [checked_name(f"a joint of {self.name}", joint.get("name"), spaces=True) for joint in found]
        distinct(f"{self.name}: the joint", names)
        self._check_bodies()
        return names

    def _check_bodies(self) -> None:
        """Names of bodies can be shown and stand once: a payload hangs on one. The world itself has no joint."""
        bodies = [
            body.get("name", "") for world in self.root.findall("worldbody") for body in world.iter("body")
        ]
        named = [checked_name(f"a body of {self.name}", name, spaces=True) for name in bodies if name]
        distinct(f"{self.name}: the body", named)
        if any(world.find("joint") is not None for world in self.root.findall("worldbody")):
            raise self._refusal("<worldbody> has a joint", "expected joints in bodies", "a <body> around it")

    def range(self, where: str, values: Mapping[str, str], key: str, limited: str) -> np.ndarray | None:
        """A range that acts, (2,), or None: it is not stated, switched off, or 0 0 and not switched on.

        Parameters
        ----------
        where, values
            As for `numbers`.
        key, limited : str
            Names of the range, and of the attribute that switches it: true, false or auto.

        Raises
        ------
        InvalidInput
            For ends in the wrong order, and another word.
        """
        stated, switch = numbers(self.name, where, values, key, (2,)), values.get(limited, "auto")
        if switch not in ("true", "false", "auto"):
            raise self._refusal(
                f"{limited} of {where} cannot be read", f"got {value_text(switch, 40)}", "true, false or auto"
            )
        if switch == "false" or (switch == "auto" and (stated is None or not self.compiler.limited)):
            return None
        ends = np.zeros(2) if stated is None else stated
        if switch == "auto" and not ends.any():
            return None
        if not ends[0] < ends[1]:
            raise self._refusal(
                f"{key} of {where} is none",
                f"expected two ends in order, got {ends.tolist()}",
                f'{key}="-1 1"',
            )
        return ends

    def check_couplings(self, moving: set[str]) -> None:
        """Refuse constraints and elastic tendons of joints that move."""
        for group in self.root.findall("equality"):
            for element in group:
                names = {element.get("joint1"), element.get("joint2")}
                locked = element.tag == "joint" and not names & moving
                if not locked and element.get("active", "true") != "false":
                    raise self._refusal(
                        f"<equality> {element.tag} {value_text(element.get('name', ''), 60)} couples what moves",
                        "expected a tree of independent joints",
                        "lock the joints that it couples: locked={'finger': 0.0}",
                    )
        for group in self.root.findall("tendon"):
            for element in group:
                values = self.values(element, None)
                acting = [
                    key
                    for key in ("stiffness", "damping", "frictionloss", "armature")
                    if any(real_text(word) != 0.0 for word in values.get(key, "").split())
                ]
                coupled = {part.get("joint") for part in element}
                if acting and (element.tag != "fixed" or coupled & moving):
                    raise self._refusal(
                        f"a tendon has {acting[0]}", "expected joints that are coupled by links alone",
                        "the robot without it",
                    )  # fmt: skip

    def effort(self, joint: str) -> float:
        """Largest torque or force of the actuators of a joint; infinite where one of them has no limit, or none."""
        total, any_found = 0.0, False
        for group in self.root.findall("actuator"):
            for element in group:
                if element.get("joint") != joint:
                    continue
                values, where = self.values(element, None), f"the actuator of {joint!r}"
                gear = numbers(self.name, where, values, "gear", (1, 2, 3, 4, 5, 6))
                force = self.range(where, values, "forcerange", "forcelimited")
                if force is None and element.tag == "motor":
                    force = self.range(where, values, "ctrlrange", "ctrllimited")
                if force is None:
                    return np.inf
                any_found = True
                total += float(np.abs(force).max() * abs(1.0 if gear is None else gear[0]))
        return total if any_found and total > 0.0 else np.inf


def real_text(text: str) -> float:
    """A number, NaN for another text."""
    try:
        return float(text)
    except ValueError:
        return float("nan")
