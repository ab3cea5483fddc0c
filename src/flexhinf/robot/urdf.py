"""URDF: the rigid part of a robot. Fixed and locked joints are merged into the links that carry them."""

from __future__ import annotations

import difflib
import itertools
import math
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput, readable, refuse_if
from flexhinf.robot.arm import Frame
from flexhinf.robot.dynamics import KINDS, ZERO, Placement, matrix_of
from flexhinf.robot.faults import NO_EXTENT, NO_KIND, NO_ROOM, refuse_part
from flexhinf.robot.mjcf import WHOLE
from flexhinf.robot.parameters import INERTIA, measured
from flexhinf.robot.parts import ask
from flexhinf.robot.rigid_arm import (
    MOST_LINKS,
    NEAREST,
    Correction,
    RigidArm,
    ball_inertia,
    check_count,
    check_turns,
    locked_joints,
    range_of,
    selection,
    toml_key,
)
from flexhinf.validation import HUGE, checked_name, distinct, one_of, value_text

#: What may stand in an element, and only once, with what else a URDF has there.
ONCE = {
    "link": ("inertial",),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
}
#: Of these the first is read where they say different things, as ROS reads them.
FIRST = ("inertial", "origin")
OTHERS = {"link": ("visual", "collision"), "joint": ("calibration", "safety_controller")}

#: Components of an inertia below its diagonal, which have to be those above it.
MIRRORED = {"iyx": "ixy", "izx": "ixz", "izy": "iyz"}

#: Attributes of the elements that are read: the first ones are required, the others are not.
ATTRIBUTES = {
    "origin": ((), ("xyz", "rpy")),
    "mass": (("value",), ()),
    "inertia": (("ixx", "iyy", "izz"), ("ixy", "ixz", "iyz", *MIRRORED)),
    "axis": (("xyz",), ()),
    "parent": (("link",), ()),
    "child": (("link",), ()),
    "mimic": (("joint",), ("multiplier", "offset")),
    "limit": ((), ("lower", "upper", "effort", "velocity")),
    "dynamics": ((), ("damping", "friction")),
}

#: The link that files may name without stating it, as Drake's do.
WORLD = "world"

#: Elements of xacro that make others: without them, and without texts that name a property or an argument, nothing of
#: a file is to be expanded.
XACRO = {
    "include",
    "macro",
    "if",
    "unless",
    "insert_block",
    "element",
    "attribute",
    "call",
}

#: Elements of a joint that mean nothing where it is fixed.
OF_MOTION = ("axis", "limit", "dynamics", "mimic")

#: Elements where other programs have attributes of their own: only what looks like one of ours is a mistake there.
OPEN = ("axis", "limit", "dynamics")

#: A number as XML writes it. Python's own takes 2_5 for 25, and digits of other scripts.
NUMBER = re.compile(r"[+-]?(?:[0-9]++\.?[0-9]*+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?")

#: What follows a sign where π is written, with a factor before it and a divisor behind it.
_PI = re.compile(
    r"(?:\$\{)?([+-]?)(?:([0-9]++\.?[0-9]*+)\*?)?(?:pi|PI|Pi|M_PI|π)(?:/([0-9]++\.?[0-9]*+))?\}?"
)
_INFINITE = re.compile(r"[+-]?(?:inf|infinity|∞|none|unlimited|nan)", re.IGNORECASE)

#: Units of numbers: of a joint that turns, and one that slides.
UNITS = {
    ("origin", "xyz"): ("m", "m"),
    ("origin", "rpy"): ("rad", "rad"),
    ("mass", "value"): ("kg", "kg"),
    **{("inertia", f"i{axes}"): ("kg·m²", "kg·m²") for axes in INERTIA},
    ("mimic", "offset"): ("rad", "m"),
    **{("limit", key): ("rad", "m") for key in ("lower", "upper")},
    ("limit", "effort"): ("N·m", "N"),
    ("limit", "velocity"): ("rad/s", "m/s"),
    ("dynamics", "damping"): ("N·m·s/rad", "N·s/m"),
    ("dynamics", "friction"): ("N·m", "N"),
}

#: What stands for no limit.
NO_LIMITS = {"effort": "0", "velocity": "0", "lower": "1e16", "upper": "1e16"}

#: N·m, N, rad/s or m/s that no motor of a robot has: a placeholder.
NO_MOTOR = 1e9


def read_urdf(
    root: Element,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
    inertias: Mapping[str, Correction] | None = None,
) -> RigidArm:
    """The moving joints of a URDF, of its root, and their links; neither meshes nor transmissions.

    `joints` are those that move (by default all that are not fixed); `locked` is where others stand, rad or m. Those
    that `joints` leaves out stand at zero or at the nearer limit, or where the joint that they mimic takes them.
    `inertias` take the place of those that the file states, by link.
    """
    left = refuse_other_xml(root)
    ask(
        left,
        f"Macros of xacro that nobody expanded are left out: {value_text(', '.join(sorted(left)), 120)}.",
        "expected plain URDF",
        "xacro arm.xacro > arm.urdf, with all files that it includes",
    )
    links, elements = _named(root, "link"), _named(root, "joint")
    if any(_link_at(joint, "parent") == WORLD for joint in elements.values()):
        links.setdefault(WORLD, Element("link"))
    behind, base = _tree(links, elements)
    movable = tuple(name for name, element in elements.items() if element.get("type") != "fixed")
    arm = RigidArm(movable, _with_mimics(elements, locked_joints(movable, joints, locked)), inertias or {})
    for link in arm.inertias:
        one_of(f"There is no link {value_text(link, 60)} whose inertia could be corrected.", link, links)
    # From the base outwards, each link before those behind it, without recursion: chains may be long.
    ahead: list[Any] = [(name, None, Placement()) for name in reversed(behind.get(base, []))]
    while ahead:
        name, carrier, above = ahead.pop()
        element, link = elements[name], _link_at(elements[name], "child")
        kind, place = element.get("type", ""), above.then(_origin(name, element))
        if kind not in KINDS and name in arm.locked:
            kind = "fixed"  # of a base that floats, say
        if refuse_part(
            kind not in (*KINDS, "fixed"),
            NO_KIND,
            (name,),
            f"The joint {name!r} is of kind {value_text(kind, 60)}.",
            f"expected fixed or one of {list(KINDS)}, got {value_text(kind, 60)}",
            f"type='{close[0]}' in the <joint name={name!r}>"
            if (close := difflib.get_close_matches(kind[:60].strip().lower(), (*KINDS, "fixed"), n=1))
            else f"type='fixed' in the <joint name={name!r}>, where the base, or what is behind it, stands still",
        ):
            kind = "fixed"
        if kind != "fixed":
            axis = _vector(name, element.find("axis"), "xyz", (1.0, 0.0, 0.0))
            if refuse_part(
                not np.linalg.norm(axis) > 1.0 / HUGE,
                NO_ROOM,
                (name,),
                f"The axis of the joint {name!r} has no direction.",
                f"expected a vector that is not zero, got {axis}",
                "xyz='0 0 1'",
            ):
                axis = (1.0, 0.0, 0.0)
            limits = _limits(name, element, name in arm.locked)
            carrier, place = arm.add_joint(carrier, name, kind, axis, place, limits)
            if name not in arm.locked:
                arm.motors[name] = _dynamics(name, element)
        if carrier is not None:
            _add_body(arm, carrier, link, links[link], place)
            arm.frames[link] = Frame(arm.joints[carrier].name, place)
            arm.frames.setdefault(name, arm.frames[link])
            if link not in behind:
                arm.tips.append(link)
        ahead += [(after, carrier, place) for after in reversed(behind.get(link, []))]
    _check_mimics(elements, movable, arm.locked)
    arm.repeated += _repeated({name: link for name, link in links.items() if name in arm.frames}, elements)
    ask(
        arm.repeated,
        "Elements that should stand once say different things: the first of each is read, as by ROS.",
        "expected one <inertial> of a link and one <origin>, got " + "; ".join(arm.repeated),
        "the file without the others; or, where another one is right, without the first",
    )
    _tell_unread({joint.name: elements[joint.name] for joint in arm.joints})
    arm.efforts, arm.speeds = (
        [_largest(joint.name, elements[joint.name], key) for joint in arm.joints]
        for key in ("effort", "velocity")
    )
    return arm.merge()


# Elements -----------------------------------------------------------------------------------------
def refuse_other_xml(root: Element) -> set[str]:
    """Refuse what is no URDF, and a file that xacro has to expand; names of macros left in one that it has expanded."""
    refuse_if(
        root.tag == "mujocoinclude",
        "This is a part of an MJCF file.",
        "expected the root element <mujoco>, got <mujocoinclude>, which another file includes",
        f"the file that includes it, or one that says <mujoco><include file='part.xml'/></mujoco>; of either, {WHOLE}",
    )
    refuse_if(
        root.tag != "robot",
        "This is no URDF.",
        f"expected the root element <robot>, got <{root.tag[:60]}>",
        "arm.xml with the root <mujoco> is read as MJCF; convert other files to URDF first",
    )
    left = {
        str(element.tag).rpartition("}")[2].rpartition(":")[2]
        for element in root.iter()
        if "xacro" in str(element.tag)
    } - {"property", "arg"}  # which change nothing where no text names them
    read = [part for path in ("link", "joint", "joint/*", "link/inertial/*") for part in root.findall(path)]
    opened = [
        _open_texts(parts) for parts in (read, root.iter())
    ]  # what is only drawn may name a mesh by one
    refuse_if(
        left & XACRO or (left and opened[1]) or opened[0],
        "This is a xacro file.",
        f"expected plain URDF, got {value_text(opened[0][0], 60) if opened[0] else 'elements of xacro'}",
        "xacro arm.xacro > arm.urdf",
    )
    return left


def _open_texts(parts: Iterable[Element]) -> list[str]:
    """Attributes that name a property or an argument of xacro."""
    return [text for part in parts for text in part.attrib.values() if "${" in text or "$(" in text]


def _named(root: Element, tag: str) -> dict[str, Element]:
    elements = root.findall(tag)
    check_count(f"{tag}s", len(elements), MOST_LINKS)
    names = [checked_name(f"a {tag}", entry.get("name"), spaces=True) for entry in elements]
    distinct(f"The {tag}", names)
    for name, element in zip(names, elements):
        _check_element(name, element)
    return dict(zip(names, elements))


def _link_at(joint: Element, end: str) -> str:
    link = joint.find(end)
    return "" if link is None else link.get("link", "")


def _tree(links: Mapping[str, Element], joints: Mapping[str, Element]) -> tuple[Any, str]:
    behind: dict[str, list[str]] = {}
    for name, element in joints.items():
        for end in ("parent", "child"):
            if _link_at(element, end) not in links:
                raise InvalidInput(
                    f"The joint {name!r} has no {end} link.",
                    f"expected one of {list(links)}, got {_link_at(element, end)!r}",
                    f"<{end} link='…'/>",
                )
        behind.setdefault(_link_at(element, "parent"), []).append(name)
    children = [_link_at(element, "child") for element in joints.values()]
    free = [link for link in links if link not in children]
    reached, ahead = set[str](), list(free)
    while ahead:
        link = ahead.pop()
        if link not in reached:
            reached.add(link)
            ahead += [_link_at(joints[name], "child") for name in behind.get(link, [])]
    refuse_if(
        len(free) != 1 or len(set(children)) != len(children) or len(reached) != len(links),
        "The links are no tree.",
        "expected one link without a parent and one parent for every other, got the links without a parent "
        f"{free}, and in loops {[link for link in links if link not in reached]}",
        "a closed loop is cut, a second robot goes into a file of its own",
    )
    return behind, free[0]


def _check_element(name: str, element: Element) -> None:
    once, where = ONCE[element.tag], "<inertial> of" if element.tag == "inertial" else f"the {element.tag}"
    for tag in once:
        found = _said(element, tag)
        refuse_part(
            len(found) > 1 and tag not in FIRST,
            "",
            (name,),
            f"<{tag}> stands {len(found)} times in {where} {name!r}, and says different things.",
            f"expected one <{tag}>, got {len(found)}",
            "delete the others",
        )
    known = (*once, *OTHERS.get(element.tag, ()))
    for tag in sorted({str(child.tag) for child in element} - set(known)):
        for close in difflib.get_close_matches(tag[:60].lower(), known, n=1, cutoff=0.75):
            raise InvalidInput(
                f"There is an unknown element <{tag[:60]}> in {name!r}.",
                f"expected one of {list(known)}, got {tag[:60]!r}",
                f"<{close}>",
            )
    for child in element:
        if child.tag in FIRST and child is not element.find(child.tag):
            continue  # it is not read
        if child.tag == "inertial":
            _check_element(name, child)
        if not (element.get("type") == "fixed" and child.tag in OF_MOTION):
            _check_attributes(name, child)


def _said(element: Element, tag: str) -> list[str]:
    """The different texts of the children of this name, in their order."""
    texts = (ElementTree.tostring(part, encoding="unicode") for part in element.findall(tag))
    return [*dict.fromkeys(" ".join(text.split()) for text in texts)]


def _repeated(*groups: Mapping[str, Element]) -> list[str]:
    """What is read, and what is left, of <inertial> and <origin> that say different things, in sentences."""
    found = [
        (tag, name, _said(part, tag))
        for elements in groups
        for name, element in elements.items()
        for part in [element, *element.findall("inertial")[:1]]
        for tag in FIRST
    ]
    return [
        f"<{tag}> of {name!r} stands {len(texts)} times: {texts[0]} is read, and left is {', '.join(texts[1:])}"
        for tag, name, said in found
        if len(texts := [value_text(textwrap.shorten(text, 110, placeholder=" …")) for text in said]) > 1
    ]


def _check_attributes(name: str, element: Element) -> None:
    required, optional = ATTRIBUTES.get(element.tag, ((), tuple(element.attrib)))
    absent = [key for key in (*required, *optional) if key not in element.attrib]
    expected = (
        f"expected {' '.join([*required, *(f'[{key}]' for key in optional)])}, got "
        f"{value_text(list(element.attrib), 120)}"
    )
    for key in [key for key in required if key in absent]:
        raise InvalidInput(f"<{element.tag}> in {name!r} has no {key!r}.", expected, f"{key}='…'")
    for key in _unread(element):
        close = difflib.get_close_matches(key[:60].lower(), absent, n=1)
        refuse_if(
            close or element.tag not in OPEN,
            f"<{element.tag}> in {name!r} has an unknown attribute {value_text(key, 60)}.",
            expected,
            "".join(f"{meant}={value_text(element.get(key), 60)}, or " for meant in close)
            + f"the file without {key[:60]}",
        )


def _unread(element: Element) -> list[str]:
    """Attributes that this reader does not know; those of a namespace are another program's."""
    required, optional = ATTRIBUTES.get(element.tag, ((), tuple(element.attrib)))
    return [key for key in element.attrib if key not in (*required, *optional) and "{" not in key]


def _tell_unread(moving: Mapping[str, Element]) -> None:
    """Say which attributes of joints that move belong to other programs, and are not in the model."""
    unread: dict[tuple[str, ...], list[str]] = {}  # joints, which are often all alike
    for name, joint in moving.items():
        for part in joint:
            if part.tag in OPEN and (keys := _unread(part)):
                unread.setdefault((part.tag, *keys), []).append(name)
    found = "; ".join(
        f"{', '.join(keys)} of <{tag}> in {', '.join(map(repr, names))}"
        for (tag, *keys), names in unread.items()
    )
    ask(
        unread,
        f"Attributes are not read: {readable(found, 400)}.",
        "expected " + ", ".join(f"<{' '.join([tag, *itertools.chain(*ATTRIBUTES[tag])])}>" for tag in OPEN),
        "friction, coulomb_friction, stiffness and limits, where they are meant, in [[joint]] of the robot file",
    )


# Numbers ------------------------------------------------------------------------------------------
def _vector(
    name: str, element: Element | None, key: str, default: Sequence[float], slides: bool = False
) -> Sequence[float]:
    if element is None or element.get(key) is None:
        return default
    text = str(element.get(key))
    tokens = re.sub(r",(?=\s)", "", text).split()  # a comma before a space is none of a decimal fraction
    numbers = tuple(float(word) for word in tokens) if all(map(NUMBER.fullmatch, tokens)) else ()
    if len(numbers) != len(default) or not all(abs(number) <= HUGE for number in numbers):
        unit = UNITS.get((element.tag, key), ("", ""))[slides]
        raise InvalidInput(
            f"{key} of <{element.tag}> in {name!r} cannot be read.",
            f"expected {len(default)} numbers{f' in {unit}' if unit else ''} of at most {HUGE:g}, got "
            f"{value_text(text)}",
            _meant(key, text, len(default), unit),
        )
    return numbers


def _meant(key: str, text: str, count: int, unit: str) -> str:
    """What to write for numbers that cannot be read, in `unit`; an ellipsis where nobody knows what was meant."""
    text = re.sub(r"(?<=[0-9.])[ \t]+(?=[^\W\d_]|°)", "", text[:200]).strip(" \t\n()[]{}")  # 50 g is one word
    tokens = [word for part in text.split() if (word := part.strip(",;"))]
    tokens = tokens if len(tokens) == count else [word for word in re.split(r"[,;\s]+", text) if word]
    values = [_read_as(word, unit) for word in tokens]
    if count == len(values) and None not in values:
        return f"{key}='{' '.join(map(str, values))}'"
    none = NO_LIMITS.get(key)
    if none and count == 1 and (_INFINITE.fullmatch(text) or _too_large(text)):
        sign = "-" if text.startswith("-") and key in ("lower", "upper") else ""
        return f"{key}='{sign}{none}', which stands for none; or the limit{f' in {unit}' if unit else ''}"
    how = f"its {'value' if count == 1 else f'{count} values'}{f' in {unit}' if unit else ''}"
    return f"{how}, with a decimal point and nothing else: {key}='{' '.join(['…'] * count)}'"


def _too_large(text: str) -> bool:
    return bool(NUMBER.fullmatch(text)) and abs(float(text)) > HUGE


def _read_as(word: str, unit: str) -> str | None:
    """One number as XML writes it, of a text with a unit, a decimal comma, or π; None where it is none."""
    comma = re.fullmatch(r"([+-]?[0-9]*),([0-9]+)(.*)", word, re.DOTALL)
    if comma and "," not in comma[3] and len(comma[2]) != 3:  # 1,000 may be a thousand
        word = f"{comma[1] or '0'}.{comma[2]}{comma[3]}"
    if NUMBER.fullmatch(word):
        return word if abs(float(word)) <= HUGE else None
    if turn := _PI.fullmatch(word):
        value = float(turn[2] or 1.0) * math.pi / float(turn[3] or 1.0) if float(turn[3] or 1.0) else math.inf
        value = -value if turn[1] == "-" else value
    else:
        try:
            value = float(measured(word, unit))
        except ValueError:
            return None
    return f"{value:.6g}" if abs(value) <= HUGE else None


def _number(name: str, element: Element | None, key: str, slides: bool = False) -> float:
    return _vector(name, element, key, (0.0,), slides)[0]


def _slides(joint: Element) -> bool:
    return joint.get("type") == "prismatic"


def _origin(name: str, element: Element) -> Placement:
    place, angles = (_vector(name, element.find("origin"), key, ZERO) for key in ("xyz", "rpy"))
    check_turns(f"<origin> in {name!r}", angles, "rpy='{} {} {}'")
    return Placement.of(place, angles)


def _with_mimics(
    elements: Mapping[str, Element], locked: Mapping[str, float | None]
) -> dict[str, float | None]:
    """Locked joints, of which those that mimic a locked one stand where it takes them, or as near as they can, if
    nobody placed them."""
    placed, left = dict(locked), dict[str, str]()
    for _ in range(len(placed)):  # a leader may follow another one
        for name in [name for name, value in placed.items() if value is None]:
            mimic, place = elements[name].find("mimic"), 0.0
            led_by = "" if mimic is None else mimic.get("joint", "")
            if mimic is not None and led_by in placed:
                leader = placed[led_by]
                if leader is None:
                    continue
                factor = 1.0 if mimic.get("multiplier") is None else _number(name, mimic, "multiplier")
                place = factor * leader + _number(name, mimic, "offset", _slides(elements[name]))
            elif led_by in elements:
                left[name] = led_by
            low, high = _limits(name, elements[name], True) or (place, place)
            placed[name] = min(max(place, low), high)
    still = ", ".join(f"{toml_key(name)} = {placed[name]:g}" for name in left)
    ask(
        left,
        f"Joints stand still although their leaders move: {', '.join(map(repr, left))}.",
        "expected <mimic> of joints that are locked, got "
        + ", ".join(f"{name!r} that mimics {leader!r}" for name, leader in left.items()),
        f"locked = {{{still}}} at the top of the robot file, where they may stand still; or joints "
        f"without {', '.join(map(repr, dict.fromkeys(left.values())))}, which are then locked too",
    )
    return placed


def _check_mimics(
    elements: Mapping[str, Element], movable: Sequence[str], locked: Mapping[str, float | None]
) -> None:
    """Refuse joints that mimic others, all at once."""
    leaders = {
        name: str(mimic.get("joint"))
        for name in movable
        if (mimic := elements[name].find("mimic")) is not None
    }
    moving = [name for name in leaders if name not in locked]
    alone = [name for name in movable if name not in leaders]
    free = [name for name in alone if name not in leaders.values()]
    refuse_if(
        moving,
        f"An elastic joint cannot mimic another one: {', '.join(map(repr, moving))}.",
        f"expected independent joints, got <mimic> of {', '.join(sorted({leaders[name] for name in moving}))}",
        selection([name for name in free or alone if name not in locked], movable),
    )


def _dynamics(name: str, joint: Element) -> dict[str, float]:
    """Friction of a joint, viscous and dry, as <dynamics damping friction> states it, by its names in a robot file."""
    stated = {
        "friction": _number(name, joint.find("dynamics"), "damping", _slides(joint)),
        "coulomb_friction": _number(name, joint.find("dynamics"), "friction", _slides(joint)),
    }
    refuse_part(
        min(stated.values()) < 0.0,
        "",
        (name,),
        f"<dynamics> of the joint {name!r} is negative.",
        f"expected damping and friction >= 0, got {list(stated.values())}",
        "0 for none",
    )
    return {quantity: value for quantity, value in stated.items() if value}


def _limits(name: str, joint: Element, locked: bool) -> tuple[float, float] | None:
    """Range of a joint, rad or m; None where there is none: also of lower = upper = 0, which exporters write then."""
    if joint.get("type") == "continuous":
        return None
    lower, upper = (_number(name, joint.find("limit"), key, _slides(joint)) for key in ("lower", "upper"))
    if refuse_part(
        (lower > upper or lower == upper != 0.0) and not locked,
        NO_ROOM,
        (name,),
        f"The limits of the joint {name!r} leave no room.",
        f"expected lower < upper, got lower {lower:g} and upper {upper:g} (0 where not stated)",
        f"lower='{upper:g}' upper='{lower:g}'"
        if lower > upper
        else f"locked = {{{toml_key(name)} = {lower:g}}} at the top of the robot file",
    ):
        return None
    lower, upper = sorted(
        (lower, upper)
    )  # of a joint that stands still, where turned ends and none are the same
    return range_of(lower, upper) if lower < upper or lower == upper != 0.0 else None


def _largest(name: str, joint: Element, key: str) -> float:
    """The limit that <limit effort velocity> states; infinite without one, and for 0 and -1, which exporters write
    then, and for what is beyond all motors."""
    stated = _number(name, joint.find("limit"), key, _slides(joint))
    refuse_part(
        stated < 0.0 and stated != -1.0,
        "",
        (name,),
        f"The {key} limit of the joint {name!r} is negative.",
        f"expected {key} >= 0 (0 or -1 for none) in <limit>, got {stated:g}",
        f"{key}='0' for none, or the limit",
    )
    return stated if 0.0 < stated < NO_MOTOR else np.inf


def _add_body(arm: RigidArm, carrier: int, link: str, element: Element, place: Placement) -> None:
    inertial = element.find("inertial")
    if inertial is None:
        return
    mass_element, six = inertial.find("mass"), inertial.find("inertia")
    mass = _number(link, mass_element, "value")
    if six is None and mass_element is not None and mass == 0.0:
        return
    if refuse_part(
        mass_element is None,
        "",
        (link,),
        f"The <inertial> of the link {link!r} has no mass.",
        "expected <mass value=…/>, kg, and <inertia ixx=… iyy=… izz=…/> about the centre of mass",
        "the mass; or no <inertial> for a link without mass",
    ):
        return
    there = place.then(_origin(link, inertial))
    if six is None:
        ball = ball_inertia(max(mass, 0.0))
        corrected = arm.inertias.get(link, NEAREST) != NEAREST
        refuse_part(
            not corrected,
            NO_EXTENT,
            (link,),
            f"The <inertial> of the link {link!r} has no inertia.",
            "expected <mass value=…/>, kg, and <inertia ixx=… iyy=… izz=…/> about the centre of mass",
            f"<inertia ixx='{ball:.2g}' iyy='{ball:.2g}' izz='{ball:.2g}'/> of a plastic ball, or as measured",
        )
        arm.add_body(carrier, link, mass, ball * np.eye(3), there)
        return
    moments = matrix_of([_number(link, six, f"i{axes}") for axes in INERTIA])
    for below, above in MIRRORED.items():
        mirrored, own = (_number(link, six, key) for key in (below, above))
        refuse_part(
            below in six.attrib and mirrored != own,
            "",
            (link,),
            f"The inertia of the link {link!r} is not symmetric.",
            f"expected {below} equal to {above}, got {mirrored:g} and {own:g}",
            f"the file without {below}",
        )
    arm.add_body(carrier, link, mass, moments, there)
