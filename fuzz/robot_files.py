"""Robot files, URDFs and MJCF with mutated bytes, numbers, names and structure: a robot as written, or a refusal."""

from __future__ import annotations

import ctypes
import re
import tempfile
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from flexhinf.robot import Robot, catalogue, load_robot
from flexhinf.robot.arm import Arm
from flexhinf.robot.parameters import QUANTITIES, per_joint
from fuzz.tally import Tally

ATTEMPTS = 3000

NUMBERS = (
    "0", "-0.0", "-1", "1e-300", "5e-324", "1e31", "1e200", "1e308", "1e400", "-1e300", "nan", "inf", "-inf",
    "9" * 400, "9" * 5000, "1e-31", "0x10", "1_000", "+7", ".5", "true", '"1"', "[1.0]", "{}", "1e", "", "٣",
    "1979-05-27", "100", "99.99",
)  # fmt: skip
WORDS = (
    "", " ", "world", "integral", "a_integral", "a b", "$x$", "[red]", "é", "\u202e", "\x1b[31m", "\x00",
    "a" * 200, "../..", "url(x)", "😀", "link", "joint", "robot", "prismatic", "floating", "fixed", "stiffness",
    "mass",
)  # fmt: skip

URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0.02 0.3" rpy="0.2 -0.1 0.3"/><mass value="2.5"/>
<inertia ixx="0.03" ixy="0.002" ixz="-0.001" iyy="0.04" iyz="0.003" izz="0.02"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0.1 0 0.3" rpy="0 0.4 0"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="1.5" effort="9" velocity="1"/></joint>
<link name="plate"><inertial><mass value="0.4"/><inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.0015"/>
</inertial></link>
<joint name="weld" type="fixed"><parent link="upper"/><child link="plate"/><origin xyz="0 0 0.5"/></joint>
<link name="fore"><inertial><mass value="1.2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"/>
</inertial></link>
<joint name="elbow" type="prismatic"><parent link="plate"/><child link="fore"/><axis xyz="0.6 0 0.8"/>
<limit lower="-0.1" upper="0.3" effort="9" velocity="1"/></joint></robot>
"""
MJCF = """<mujoco model="arm"><compiler angle="radian" eulerseq="XYz"/><option gravity="0 0 -9.81"/>
<default><joint damping="0.4"/><default class="heavy"><joint armature="0.3"/></default></default>
<worldbody><light pos="0 0 3"/>
<body name="upper" pos="0.1 0 0.3" euler="0 0.4 0" childclass="heavy">
<joint name="shoulder" axis="0 1 0" pos="0.01 0 0" range="-2 1.5"/>
<inertial pos="0.1 0.02 0.3" quat="0.9 0.1 -0.3 0.2" mass="2.5" diaginertia="0.03 0.04 0.02"/>
<body name="plate" pos="0 0 0.5"><inertial pos="0 0 0" mass="0.4" fullinertia="0.001 0.002 0.0015 0 0 0.0001"/>
<frame axisangle="1 0 1 0.7"><body name="fore"><joint name="elbow" type="slide" axis="0.6 0 0.8" range="-0.1 0.3"/>
<inertial pos="0 0 0" mass="1.2" diaginertia="0.02 0.02 0.004"/></body></frame></body></body></worldbody>
<actuator><motor joint="shoulder" ctrlrange="-9 9"/>
<position joint="elbow" kp="3" forcerange="-5 5"/></actuator></mujoco>
"""
JOINTS = "".join(
    f'[[joint]]\nname = "{name}"\n[joint.spring]\nstiffness = 500.0\n[joint.motor]\nmotor_inertia = 0.2\n'
    for name in ("shoulder", "elbow")
)


#: Units of a stiffness at a joint that turns and one that slides, and of nothing of the kind.
TURNING = {
    "N·m/rad": 1.0,
    "kNm/rad": 1e3,
    "Nm/deg": 180.0 / np.pi,
    "mNm/mrad": 1.0,
    "kg m^2 s^-2 rad^-1": 1.0,
}
SLIDING = {"N/m": 1.0, "kN/m": 1e3, "N/mm": 1e3, "MN/m": 1e6, "kg/s²": 1.0}
OTHER = (
    "N·m",
    "rad",
    "kat",
    "N·m/rad/rad",
    "kg",
    "%",
    "",
    "/",
    "N·m//rad",
    "m" * 50,
    "²",
    "N·m/rad " + "·m" * 20,
)

#: What drives a motor, by which of its constants are stated.
DRIVES = {(True, True, True): "voltage", (False, True, False): "current", (False, False, False): "torque"}
CONSTANTS = ("resistance", "torque_constant", "back_emf_constant")

#: Elements that are read of a link, a joint or an <inertial>.
READ = {"inertial", "origin", "mass", "inertia", "parent", "child", "axis", "limit", "mimic"}

STRTOD: Any = ctypes.CDLL(None).strtod
STRTOD.restype, STRTOD.argtypes = ctypes.c_double, [ctypes.c_char_p, ctypes.POINTER(ctypes.c_char_p)]


def run(attempts: int, seed: int) -> Tally:
    """Mutate a file once or a few times, read it, and compare the robot with the file's own numbers."""
    tally, rng = Tally("robot files, URDFs, MJCF files"), np.random.default_rng([seed, 1])
    shipped = [path.read_text(encoding="utf-8") for path in catalogue().values() if path.suffix == ".toml"]
    own = [text for text in shipped if "\nurdf" not in text]
    with tempfile.TemporaryDirectory() as folder:
        for attempt in range(attempts):
            name = ("arm.toml", "arm.urdf", "arm.xml")[rng.integers(3)]
            content = {"arm.urdf": URDF, "arm.xml": MJCF}.get(name, own[rng.integers(len(own))]).encode()
            for _ in range(rng.geometric(0.6)):
                content = MUTATIONS[rng.integers(len(MUTATIONS))](content, rng)
            path = Path(folder) / name
            path.write_bytes(content)
            (Path(folder) / "joints.toml").write_text(JOINTS, encoding="utf-8")
            how = f"seed {seed}, attempt {attempt}, {path.name}"
            try:
                with warnings.catch_warnings(), np.errstate(all="ignore"):
                    warnings.simplefilter("ignore")
                    robot = load_robot(path, None if name == "arm.toml" else path.with_name("joints.toml"))
                    fault = _fault(robot) or FAULTS[name](robot, content)
                tally.answered(fault, how)
            except Exception as error:
                tally.raised(error, how)
    return tally


# Mutations ------------------------------------------------------------------------------------------
def _bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """One byte changed, put in or taken out."""
    k, kind = int(rng.integers(len(content) + 1)), rng.integers(3)
    new = bytes([int(rng.integers(256))]) if kind < 2 else b""
    return content[:k] + new + content[k + (kind != 1) :]


def _replaced(pattern: str, choices: tuple[str, ...]) -> Callable[[bytes, np.random.Generator], bytes]:
    def mutate(content: bytes, rng: np.random.Generator) -> bytes:
        places = list(re.finditer(pattern.encode(), content))
        if not places:
            return content
        place = places[rng.integers(len(places))]
        return (
            content[: place.start()] + choices[rng.integers(len(choices))].encode() + content[place.end() :]
        )

    return mutate


def _lines(content: bytes, rng: np.random.Generator) -> bytes:
    """Some lines taken out, repeated or moved."""
    lines = content.splitlines(keepends=True)
    a = int(rng.integers(len(lines) + 1))
    part = lines[a : a + int(rng.integers(1, 6))]
    kept = lines if rng.integers(2) else lines[:a] + lines[a + len(part) :]
    b = int(rng.integers(len(kept) + 1))
    return b"".join(kept[:b] + part * int(rng.integers(2)) + kept[b:])


def _structure(content: bytes, rng: np.random.Generator) -> bytes:
    """Nesting, repetition and sizes that no robot has."""
    k, many = int(rng.integers(len(content) + 1)), int(10 ** rng.uniform(1, 5))
    piece = (b"[", b"{", b"a.", b"<a>", b"<link name='x'/>", b"[[joint]]\n", b"0.5,", b"&a;", b"#", b'"""')[
        rng.integers(10)
    ]
    return content[:k] + piece * many + content[k:]


def _swapped(content: bytes, rng: np.random.Generator) -> bytes:
    """One quoted text in the place of another: names that stand twice, parents that are children."""
    places = list(re.finditer(rb'"[^"\n]*"', content))
    if len(places) < 2:
        return content
    old, new = (places[k] for k in rng.integers(len(places), size=2))
    return content[: old.start()] + new[0] + content[old.end() :]


def _doubled(content: bytes, rng: np.random.Generator) -> bytes:
    """An element twice, the second time with another number."""
    places = list(re.finditer(rb"<[a-z]+ [^<>]*/>", content))
    if not places:
        return content
    place = places[rng.integers(len(places))]
    other = re.sub(rb"\d+\.?\d*", str(rng.integers(1, 9)).encode(), place[0], count=1)
    return content[: place.end()] + other + content[place.end() :]


def _ranged(content: bytes, rng: np.random.Generator) -> bytes:
    """A range about a number instead of its tolerance; its ends may be anything."""
    places = list(re.finditer(rb"(value = (\d[\d.e+-]*))(, tolerance = \d+)?", content))
    if not places:
        return content
    place = places[rng.integers(len(places))]
    value = float(place[2])
    ends = [repr(value * rng.uniform(0.5, 1.0)), repr(value * rng.uniform(1.0, 2.0))]
    if rng.random() < 0.5:
        ends[rng.integers(2)] = NUMBERS[rng.integers(len(NUMBERS))]
    stated = f"{place[1].decode()}, range = [{ends[0]}, {ends[1]}]".encode()
    return content[: place.start()] + stated + content[place.end() :]


def _unit(content: bytes, rng: np.random.Generator) -> bytes:
    """A number as text with a unit: mostly of a stiffness, in one of its units or in another."""
    pattern = (
        rb"(stiffness = (?:\{ *value = )?)(\d[\d.e+-]*)" if rng.random() < 0.8 else rb"( = )(\d[\d.e+-]*)"
    )
    places = list(re.finditer(pattern, content))
    if not places:
        return content
    place = places[rng.integers(len(places))]
    units = (*TURNING, *SLIDING, *OTHER)
    text = f'"{place[2].decode()} {units[rng.integers(len(units))]}"'.encode()
    return content[: place.start()] + place[1] + text + content[place.end() :]


def _constants(content: bytes, rng: np.random.Generator) -> bytes:
    """Some constants of the motors left out everywhere, or stated everywhere."""
    for name in CONSTANTS:
        content = re.sub(rb"(?m)^%s = .*$" % name.encode(), b"", content)
    stated = "".join(f"{name} = 0.5\n" for name in CONSTANTS if rng.random() < 0.5).encode()
    return content.replace(b"[joint.motor]\n", b"[joint.motor]\n" + stated)


MUTATIONS = (
    _unit,
    _constants,
    _bytes,
    _replaced(r"-?\d+\.?\d*(e-?\d+)?", NUMBERS),
    _replaced(r'(?<=")[^"\n]*(?=")', (*WORDS, *NUMBERS)),
    _replaced(r"[A-Za-z_]+", WORDS),
    _lines,
    _structure,
    _swapped,
    _doubled,
    _ranged,
)


# Judgement ------------------------------------------------------------------------------------------
def _fault(robot: Robot) -> str:
    """What no robot may be, whatever its file said."""
    names = robot.joint_names
    if len(set(names)) < len(names) or not all(name.isprintable() and name for name in names):
        return f"joints {names!r}"
    if not all(np.isfinite(p.value) and 0.0 <= p.tolerance < 100.0 for p in robot.parameters):
        return "a parameter that is not finite"
    for one in robot.parameters:
        quantity = max((name for name in QUANTITIES if one.name.startswith(name)), key=len)
        sign, lowest = QUANTITIES[quantity].sign, min(one.interval)
        if (sign == "positive" and not lowest > 0.0) or (sign != "any" and lowest < 0.0):
            return f"{one.name} may be {lowest}"
    p: Any = robot.plant().parameters.named(robot.plant().parameters.vector())
    q = np.asarray(robot.home)
    x, u = robot.operating_point()
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(u))):
        return "an equilibrium that is not finite"
    links = robot.links
    if not isinstance(links, Arm):
        return "" if robot["link_inertia"].value > 0.0 else "no inertia"
    if any(abs(np.linalg.norm(joint.axis) - 1.0) > 1e-9 for joint in links.tree.joints):
        return "an axis that is no unit vector"
    rest, still = links.gravity_torque(q, p), np.zeros(len(q))
    mass = np.array([links.torques(q, still, unit, p) - rest for unit in np.eye(len(q))])
    scale = np.abs(mass).max() + np.abs(rest).max()
    if not (np.all(np.isfinite(mass)) and np.allclose(mass, mass.T, rtol=0.0, atol=1e-9 * scale)):
        return "a mass matrix that is not finite or not symmetric"
    return ""


def _toml_fault(robot: Robot, content: bytes) -> str:
    """Numbers of the robot against those of the file, read by another way."""
    rows = tomllib.loads(content.decode().replace("\r\n", "\n"))["joint"]
    for row in rows:
        stated = row["spring"]["stiffness"]
        value = stated["value"] if isinstance(stated, dict) else stated
        if isinstance(value, str):
            number, unit = value.split(" ", 1)
            known = SLIDING if row.get("kind") == "prismatic" else TURNING
            if unit not in known:
                return f"a stiffness in {unit!r} was taken"
            value = float(number) * known[unit]
            found = robot[per_joint("stiffness", row["name"], len(rows))].value
            value = found if np.isclose(found, value, rtol=1e-12, atol=0.0) else value
        drive = DRIVES.get(tuple(name in row["motor"] for name in CONSTANTS))
        if drive != robot.drive:
            return f"a robot driven by {robot.drive}, and not by {drive}"
        if robot[per_joint("stiffness", row["name"], len(rows))].value != value:
            return f"the stiffness of {row['name']!r} is not {value}"
    return ""


def _urdf_fault(robot: Robot, content: bytes) -> str:
    """Elements that stand twice; the mass that moves, axes and limits, against the file's as C reads its numbers."""
    root = ElementTree.fromstring(content.decode())
    for tag in ("link", "joint"):
        names = [one.get("name") for one in root.findall(tag)]
        if len(set(names)) < len(names):
            return f"two {tag}s of one name"
    for element in root.iter():
        if element.tag not in ("link", "joint", "inertial"):
            continue
        # Of inertials and origins the first one is read.
        several = {"link", "joint", "visual", "collision", "inertial", "origin"}
        read = [child for child in element if child.tag in READ - several]
        texts = {" ".join(ElementTree.tostring(child, encoding="unicode").split()) for child in read}
        if len({child.tag for child in read}) < len(texts):  # the same text twice says nothing else
            return f"an element stands twice in <{element.tag}>"
    ends = {
        next(one.get("link") for one in joint.iter("child")): (
            next(one.get("link") for one in joint.iter("parent")),
            joint.get("type"),
        )
        for joint in root.findall("joint")
    }
    total = 0.0
    for link in root.findall("link"):
        name, moves = link.get("name"), False
        while name in ends:
            name, kind = ends[name]
            moves |= kind != "fixed"
        if moves and link.find("inertial") is not None:
            total += _c_number(link.find("inertial/mass").attrib["value"])
    found = sum(p.value for p in robot.parameters if p.name.split("_")[0] == "mass")
    if not np.isclose(found, total, rtol=1e-12):
        return f"a mass of {found} instead of {total}"
    return _joint_fault(robot, root)


def _joint_fault(robot: Robot, root: ElementTree.Element) -> str:
    rows = {joint.get("name"): joint for joint in root.findall("joint")}
    for joint in robot.links.tree.joints if isinstance(robot.links, Arm) else ():
        axis, limit = rows[joint.name].find("axis"), rows[joint.name].find("limit")
        stated = [1.0, 0.0, 0.0] if axis is None else [_c_number(word) for word in axis.attrib["xyz"].split()]
        if not np.allclose(np.cross(joint.axis, stated / np.linalg.norm(stated)), 0.0, atol=1e-12):
            return f"an axis {joint.axis} instead of {stated}"
        if limit is not None and rows[joint.name].get("type") != "continuous":
            ends = tuple(_c_number(limit.get(key, "0")) for key in ("lower", "upper"))
            if joint.limits != (None if ends == (0.0, 0.0) else ends):
                return f"limits {joint.limits} instead of {ends}"
    return ""


def _mjcf_fault(robot: Robot, content: bytes) -> str:
    """The mass that moves, and the limits, against the file's; names of joints and bodies that stand twice."""
    root = ElementTree.fromstring(content.decode())
    for tag in ("joint", "body"):
        names = [
            one.get("name")
            for world in root.findall("worldbody")
            for one in world.iter(tag)
            if one.get("name")
        ]
        if len(set(names)) < len(names):
            return f"two elements <{tag}> of one name"
    total = 0.0
    ahead = [(world, False) for world in root.findall("worldbody")]
    while ahead:
        element, moves = ahead.pop()
        moves |= element.tag == "body" and any(
            element.find(place) is not None for place in ("joint", "frame/joint")
        )
        for child in element:
            if child.tag in ("body", "frame"):
                ahead.append((child, moves))
            elif child.tag == "inertial" and moves and element.tag == "body":
                total += _c_number(child.attrib["mass"])
    found = sum(p.value for p in robot.parameters if p.name.split("_")[0] == "mass")
    return "" if np.isclose(found, total, rtol=1e-12) else f"a mass of {found} instead of {total}"


def _c_number(text: str) -> float:
    """As strtod reads it, which is what other readers of URDF use; NaN where something is left over."""
    raw, end = text.strip(" \t\n\r").encode(), ctypes.c_char_p()
    value = STRTOD(raw, ctypes.byref(end))
    return float("nan") if end.value or not raw else value


#: Of each file: what is wrong with its robot, from the file's bytes.
FAULTS: dict[str, Callable[[Robot, bytes], str]] = {
    "arm.toml": _toml_fault,
    "arm.urdf": _urdf_fault,
    "arm.xml": _mjcf_fault,
}
