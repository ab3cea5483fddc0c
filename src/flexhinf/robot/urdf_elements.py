"""The elements of a URDF: which of them stand once, their attributes, and the bodies that they describe."""

from __future__ import annotations

import difflib
import re
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.dynamics import Placement
from flexhinf.untrusted import HUGE, value_text

#: What may stand in an element, and only once, with what else a URDF has there.
ONCE = {
    "link": ("inertial",),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
}
OTHERS = {"link": ("visual", "collision"), "joint": ("dynamics", "calibration", "safety_controller")}

#: Attributes of the elements that are read: the first ones are required, the others are not.
ATTRIBUTES = {
    "origin": ((), ("xyz", "rpy")),
    "mass": (("value",), ()),
    "inertia": (("ixx", "iyy", "izz"), ("ixy", "ixz", "iyz")),
    "axis": (("xyz",), ()),
    "parent": (("link",), ()),
    "child": (("link",), ()),
}

#: A number as XML writes it. Python's own takes 2_5 for 25, and digits of other scripts.
NUMBER = re.compile(r"[+-]?(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?")


def check_element(file: str, name: str, element: Element) -> None:
    """Refuse what could be read in two ways in the link or the joint `name`, and what is probably misspelt.

    Raises
    ------
    InvalidInput
        For an element that stands twice, one whose name is almost one that is read, and attributes that are missing
        or are none of that element.
    """
    once, where = ONCE[element.tag], "<inertial> of" if element.tag == "inertial" else f"the {element.tag}"
    for tag in once:
        count = len(element.findall(tag))
        if count > 1:
            raise InvalidInput(
                f"{file}: <{tag}> stands {count} times in {where} {name!r}.",
                f"expected one <{tag}>, got {count}",
                "delete the others",
            )
    known = (*once, *OTHERS.get(element.tag, ()))
    for tag in sorted({str(child.tag) for child in element} - set(known)):
        close = difflib.get_close_matches(tag[:60].lower(), known, n=1, cutoff=0.75)
        if close:
            raise InvalidInput(
                f"{file}: there is an unknown element <{tag[:60]}> in {name!r}.",
                f"expected one of {list(known)}, got {tag[:60]!r}",
                f"<{close[0]}>",
            )
    for child in element:
        if child.tag in ATTRIBUTES:
            _check_attributes(file, name, child)
        elif child.tag == "inertial":
            check_element(file, name, child)


def _check_attributes(file: str, name: str, element: Element) -> None:
    required, optional = ATTRIBUTES[element.tag]
    missing = [key for key in required if key not in element.attrib]
    unknown = [key for key in element.attrib if key not in (*required, *optional)]
    if missing or unknown:
        raise InvalidInput(
            f"{file}: <{element.tag}> in {name!r} has no {missing[0]!r}."
            if missing
            else f"{file}: <{element.tag}> in {name!r} has an unknown attribute {value_text(unknown[0], 60)}.",
            f"expected {' '.join([*required, *(f'[{key}]' for key in optional)])}, got "
            f"{value_text(list(element.attrib), 120)}",
            f"{missing[0]}='…'" if missing else "leave it out, or correct its name",
        )


# Numbers ------------------------------------------------------------------------------------------
def _vector(file: str, name: str, element: Element | None, key: str, default: tuple[float, ...]) -> Any:
    if element is None or element.get(key) is None:
        return default
    words = str(element.get(key)).split()
    numbers = tuple(float(word) for word in words) if all(map(NUMBER.fullmatch, words)) else ()
    if len(numbers) != len(default) or not all(abs(number) <= HUGE for number in numbers):
        raise InvalidInput(
            f"{file}: {key} of <{element.tag}> in {name!r} cannot be read.",
            f"expected {len(default)} numbers of at most {HUGE:g}, got {value_text(element.get(key))}",
            f"{key}='0 0 1'" if len(default) == 3 else f"{key}='1.0'",
        )
    return numbers


def _number(file: str, name: str, element: Element, key: str) -> float:
    return _vector(file, name, element, key, (0.0,))[0]


def origin_of(file: str, name: str, element: Element) -> Placement:
    """The place that <origin> states, the identity without one."""
    origin, nothing = element.find("origin"), (0.0, 0.0, 0.0)
    return Placement.of(*(_vector(file, name, origin, key, nothing) for key in ("xyz", "rpy")))


def axis_of(file: str, name: str, joint: Element) -> tuple[float, float, float]:
    """Direction of a joint's axis, not zero; x without one."""
    axis = _vector(file, name, joint.find("axis"), "xyz", (1.0, 0.0, 0.0))
    if not np.linalg.norm(axis) > 1.0 / HUGE:
        raise InvalidInput(
            f"{file}: the axis of the joint {name!r} has no direction.",
            f"expected a vector that is not zero, got {axis}",
            "xyz='0 0 1'",
        )
    return axis


def limits_of(file: str, name: str, joint: Element) -> tuple[float, float] | None:
    """Range of a joint, rad or m; None where there is none: also of lower = upper = 0, which exporters write then."""
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return None
    lower, upper = (_number(file, name, limit, key) for key in ("lower", "upper"))
    if lower == upper == 0.0:
        return None
    if not lower < upper:
        raise InvalidInput(
            f"{file}: the limits of the joint {name!r} leave no room.",
            f"expected lower < upper, got lower {lower:g} and upper {upper:g} (0 where not stated)",
            "exchange them; or a fixed joint",
        )
    return lower, upper


def largest_of(file: str, name: str, joint: Element, key: str) -> float:
    """The limit that <limit effort velocity> states, N·m, N, rad/s or m/s; infinite without one, and for 0, which
    exporters write then."""
    limit = joint.find("limit")
    stated = 0.0 if limit is None else _number(file, name, limit, key)
    if stated < 0.0:
        raise InvalidInput(
            f"{file}: the {key} limit of the joint {name!r} is negative.",
            f"expected {key} >= 0 (0 for none) in <limit>, got {stated:g}",
            f"{key}='{-stated:g}'",
        )
    return stated or np.inf


# Bodies -------------------------------------------------------------------------------------------
def body_of(
    file: str, link: str, element: Element, placement: Placement
) -> list[tuple[str, float, np.ndarray, np.ndarray]]:
    """A link's name, mass, centre of mass and inertia about it, in the carrier's frame; nothing without <inertial>."""
    inertial = element.find("inertial")
    if inertial is None:
        return []
    mass_element, six = inertial.find("mass"), inertial.find("inertia")
    if mass_element is None:
        raise InvalidInput(
            f"{file}: the link {link!r} has an <inertial> without a mass.",
            "expected <mass value=…/> in <inertial>, got none",
            "the mass in kg; or no <inertial> for a link without mass",
        )
    mass = _number(file, link, mass_element, "value")
    if six is None and mass == 0.0:
        return []
    if six is None:
        raise InvalidInput(
            f"{file}: the link {link!r} has a mass and no inertia.",
            "expected <inertia ixx=… iyy=… izz=…/> in <inertial>",
            "the moments about its centre of mass",
        )
    xx, xy, xz, yy, yz, zz = (
        _number(file, link, six, key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    check_body(file, link, mass, about)
    place = placement.then(origin_of(file, link, inertial))
    turn = np.array(place.rotation)
    return [(link, mass, np.array(place.translation), turn @ about @ turn.T)]


def check_body(file: str, link: str, mass: float, inertia: np.ndarray) -> None:
    """Refuse what no body has, before it is merged with others; a body may be a point, or have no mass at all."""
    a, b, c = np.linalg.eigvalsh(inertia)
    slack = 1e-9 * max(abs(a), c)
    if mass < 0.0 or a < -slack:
        wrong = "a negative mass" if mass < 0.0 else "a negative inertia"
    elif a + b < c - slack:
        wrong = "an inertia that violates the triangle inequality"
    else:
        return
    raise InvalidInput(
        f"{file}: the link {link!r} has {wrong}: no such body exists.",
        "expected mass >= 0 and principal inertias >= 0 of which none exceeds the sum of the others, got "
        f"{mass:g} kg and ({a:.4g}, {b:.4g}, {c:.4g}) kg·m²",
        "the inertia about the centre of mass, in kg·m²",
    )
