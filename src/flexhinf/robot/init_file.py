"""A robot file for a URDF or an MJCF file, with estimates of what nobody states."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.robot.actuators import gear_advice, gear_name, published_gears, published_joints
from flexhinf.robot.drive_text import DriveLines, drive_lines, electrical_lines
from flexhinf.robot.drives import DRIVES, TORQUE, VOLTAGE
from flexhinf.robot.dynamics import KINDS, Tree
from flexhinf.robot.estimates import EstimatedJoint, estimated_joints
from flexhinf.robot.faults import NO_BODY, NO_EXTENT, NO_KIND, NO_MASS, NO_ROOM, PartFault, collected_faults
from flexhinf.robot.mjcf import read_mjcf
from flexhinf.robot.mjcf_actuators import ON_JOINT
from flexhinf.robot.mjcf_couplings import Couplings
from flexhinf.robot.mjcf_joints import coupled_joints, driven_joints, first_keyframe
from flexhinf.robot.parameters import ESTIMATE
from flexhinf.robot.parts import file_warnings
from flexhinf.robot.rigid_arm import NEAREST, Correction, RigidArm, ball_inertia, toml_key
from flexhinf.robot.urdf import read_urdf, refuse_other_xml
from flexhinf.validation import one_of, read_xml, value_text

#: Attributes of <limit>, and what exporters write for those of a motor that they do not know.
LIMITS, NO_NUMBERS = ("effort", "velocity", "lower", "upper"), {0.0, -1.0}

#: So often what a reader refuses is worked around: each time it may find more.
ROUNDS = 10


@dataclass
class Description:
    """The links of a file, read with what helps where it cannot be read as it is."""

    path: Path
    root: Element
    joints: list[str] = field(default_factory=list[str])  # that move; by default those of `_moving`
    inertias: dict[str, Correction] = field(default_factory=dict[str, Correction])
    changes: list[str] = field(default_factory=list[str])  # what was done to read it, in sentences

    @property
    def is_mjcf(self) -> bool:
        """Whether it is a file of MuJoCo."""
        return self.root.tag == "mujoco"

    def read(self) -> RigidArm:
        """The moving joints with their links, as the file and the corrections of inertias state them."""
        if not self.joints:
            self.joints, still = _moving(self.root)
            self.changes += [f"{_listed(names)} stand still: {why}" for why, names in still.items() if names]
        read = read_mjcf if self.is_mjcf else read_urdf
        return read(self.root, self.joints, None, self.inertias)

    def arm(self) -> RigidArm:
        """What is read once faults are got round; InvalidInput for a fault that has no way round."""
        left = list[PartFault]()
        for _ in range(ROUNDS):
            with file_warnings(), collected_faults() as faults:
                arm = self.read()
            if arm.doubtful and not any(fault.kind == NO_BODY for fault in faults):
                # readers take the nearest inertia where little is missing; a file that is written says so
                faults.append(PartFault(NO_BODY, tuple(arm.doubtful), "", "", ""))
            if not faults:
                coils = {name: "inductance" in motor.electrical for name, motor in arm.dc_motors.items()}
                if len({*coils.values()}) > 1:
                    alone = [name for name, coil in coils.items() if coil]
                    self.changes.append(f"{_listed(alone)} alone state an inductance, which is left out")
                self.changes += [
                    f"of the <dcmotor> of {name!r} is left out: {', '.join(motor.left_out)}"
                    for name, motor in arm.dc_motors.items()
                    if motor.left_out
                ]
                return arm
            left = faults
            for fault in faults:
                self._work_around(fault, arm)
        raise _error(left[0])

    def _work_around(self, fault: PartFault, arm: RigidArm) -> None:
        if fault.kind == NO_BODY:
            self.inertias |= dict.fromkeys(fault.parts, NEAREST)
            self.changes.append(
                f"no body has the inertia of {_listed(fault.parts)}: the nearest that one has is taken"
            )
        elif fault.kind == NO_EXTENT:
            for link in fault.parts:
                moment = float(f"{ball_inertia(arm.mass_of(link)):.4g}")
                self.inertias[link] = (moment, 0.0, 0.0, moment, 0.0, moment)
            self.changes.append(
                f"no inertia of {_listed(fault.parts)} is stated: that of a plastic ball is taken"
            )
        elif fault.kind in (NO_MASS, NO_ROOM, NO_KIND) and len(self.joints) > len(fault.parts):
            still = [name for name in fault.parts if name in self.joints]
            refuse_if(not still, fault.what, fault.found, fault.advice)
            self.joints = [name for name in self.joints if name not in still]
            self.changes.append(f"{_listed(still)} stand still: {fault.what.rstrip('.')}")
        else:
            raise _error(fault)


def description_of(path: Path, joints: Sequence[str] = ()) -> Description:
    """A URDF or MJCF file, with the joints that move: by default those with a motor that nothing couples to others."""
    return Description(path, read_xml(path), list(joints))


def _moving(root: Element) -> tuple[list[str], dict[str, list[str]]]:
    """Joints with a motor that follow no other one and lead none, as those of grippers do, and that no loop or tendon
    holds, or all such without any motor; and those that stand still, by why."""
    if root.tag == "mujoco":
        driven, coupled = driven_joints(root), coupled_joints(root)
        every, motors = driven.every, driven.names
        held = Couplings(root, every).held()
    else:
        refuse_other_xml(root)
        held = dict[str, list[str]]()
        elements = {joint.get("name", ""): joint for joint in root.findall("joint")}
        every = [name for name, joint in elements.items() if joint.get("type") in KINDS]
        mimics = {name: mimic for name, joint in elements.items() for mimic in joint.findall("mimic")}
        coupled = {*mimics, *(str(mimic.get("joint")) for mimic in mimics.values())}
        acted = {str(joint.get("name")) for one in root.iter("transmission") for joint in one.iter("joint")}
        limits = {name: _limits(elements[name]) for name in every}
        motors = acted | {name for name, (effort, *_) in limits.items() if effort > 0.0}
        # exporters write a range alone where nobody stated a motor's numbers
        motors |= {
            name
            for name in _carriers(elements, motors - coupled)
            if name in limits and {*limits[name][:2]} <= NO_NUMBERS and limits[name][2] < limits[name][3]
        }
    still = {why: [name for name in names if name not in coupled] for why, names in held.items()}
    still |= {"they are coupled to other joints": [name for name in every if name in coupled]}
    free = [name for name in every if not any(name in names for names in still.values())]
    moving = [name for name in free if name in motors] or free
    still["nothing drives them"] = [name for name in free if name not in moving]
    whys = "; ".join(f"{_listed(names)} stand still: {why}" for why, names in still.items() if names)
    refuse_if(
        not moving,
        "No joint moves.",
        "expected joints that turn or slide alone, got " + (value_text(whys, 400) if whys else "none"),
        f"--move {every[0]}, which then moves alone" if every and not held else "a file of an arm",
    )
    return moving, still


def _carriers(joints: Mapping[str, Element], names: Iterable[str]) -> set[str]:
    """Joints between the base and those of these names."""
    ends = {
        end: {
            name: "" if (part := joint.find(end)) is None else part.get("link")
            for name, joint in joints.items()
        }
        for end in ("parent", "child")
    }
    above = {link: name for name, link in ends["child"].items()}
    found, ahead = set[str](), [*names]
    while ahead:
        carrier = above.get(ends["parent"].get(ahead.pop()))
        if carrier is not None and carrier not in found:
            found.add(carrier)
            ahead.append(carrier)
    return found


def _limits(joint: Element) -> tuple[float, ...]:
    """Effort, velocity, lower and upper of a joint's <limit>; 0 where it states none, or no numbers."""
    limit = joint.find("limit")
    try:
        return tuple(0.0 if limit is None else float(limit.get(key, "0")) for key in LIMITS)
    except ValueError:
        return (0.0,) * len(LIMITS)


def _error(fault: PartFault) -> InvalidInput:
    return InvalidInput(fault.what, fault.found, fault.advice)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(map(repr, names))


def _either(names: Sequence[str]) -> str:
    return " or ".join(", ".join(names).rsplit(", ", 1))


def branches_text(arm: RigidArm, path: Path, options: Sequence[str] = ()) -> str:
    """That the joints form several branches, such as two arms, and how one is taken alone, with more options; "" for a
    chain."""
    branches = Tree(tuple(arm.joints)).branches
    if len(branches) < 2:
        return ""
    ends = _listed([branch[-1] for branch in branches])
    alone = " ".join(f"--move {shlex.quote(name)}" for name in max(branches, key=len))
    return (
        f"{len(arm.joints)} joints form {len(branches)} branches, which end with {ends}, and a design moves all; "
        f"for one alone: flexhinf init {shlex.join([str(path), *options])} {alone}"
    )


def drive_of(arm: RigidArm, wanted: str | None) -> str:
    """What the motors of an arm take: what is wanted, else voltages where each joint has a <dcmotor> that takes them,
    else torques."""
    motors = [arm.dc_motors.get(joint.name) for joint in arm.joints]
    others = [kind.name for kind in DRIVES.values() if not kind.constants]
    unknown = [joint.name for joint, motor in zip(arm.joints, motors) if motor is None]
    refuse_if(
        wanted and DRIVES[wanted].constants and unknown,
        "The constants of motors are not known.",
        f"expected --drive {_either(others)} where no <dcmotor> drives {_listed(unknown[:5])}, got {wanted}",
        "torque_constant (and resistance, back_emf_constant) in [joint.motor] of the file that is written",
    )
    by_voltage = all(motor is not None and motor.takes_voltage for motor in motors)
    return wanted or (VOLTAGE if by_voltage else TORQUE).name


def gears_named(arm: RigidArm, texts: Sequence[str]) -> dict[str, str]:
    """Names of published gears by joint, of texts "joint=name", or "name" for all joints that turn."""
    gears, turning = dict[str, str](), [joint.name for joint in arm.joints if not joint.slides]
    for text in texts:
        joint, equals, stated = text.rpartition("=")
        name = gear_name(stated)
        if name not in published_gears():
            expected, advice = gear_advice(name, "CSG-25-100")
            what = f"There is no published gear {value_text(stated, 60)}."
            raise InvalidInput(what, f"expected {expected}", advice)
        if equals:
            one_of(f"There is no joint {value_text(joint, 60)} that turns.", joint, turning)
        gears |= dict.fromkeys([joint] if equals else [name for name in turning if name not in gears], name)
    return gears


# Text ---------------------------------------------------------------------------------------------
def robot_file_text(
    found: Description,
    arm: RigidArm,
    out: Path,
    drive: str = TORQUE.name,
    rigid: Sequence[str] = (),
    gears: Mapping[str, str] | None = None,
) -> str:
    """A robot file beside which `out` is: every joint that moves, numbers of the file, estimates of the others.

    `drive`: what the motors take; one that needs their constants only where each joint has a <dcmotor>. `rigid`:
    joints without a spring. `gears`: names of published gears by joint, beside those that the file names.
    """
    file, key = found.path.name, "mjcf" if found.is_mjcf else "urdf"
    beside = Path(os.path.relpath(found.path.absolute(), out.absolute().parent)).as_posix()
    home = _home(found, arm)
    lines = [
        f"# Numbers whose source begins with “{ESTIMATE}” are guesses from masses and limits, with wide tolerances:",
        "# nobody measured them. Replace them by those of data sheets, or by `flexhinf identify`.",
        *(f"# {change[:1].upper()}{change[1:]}." for change in (*found.changes, *arm.repeated)),
        f"name = {_text(found.path.stem)}",
        f"{key} = {_text(beside)}",
        f"joints = {json.dumps(found.joints, ensure_ascii=False)}",
        f"home = {[home[joint.name] for joint in arm.joints]}  # rad, or m: "
        + ("the keyframe, or " if found.is_mjcf else "")
        + "the middle of each range",
    ]
    for link, inertia in found.inertias.items():
        value = _text(NEAREST) if isinstance(inertia, str) else _moments(inertia)
        lines += ["", f"[links.{toml_key(link)}]", f"inertia = {value}"]
    stated = {} if found.is_mjcf else transmissions(found.root)
    coupled = {} if found.is_mjcf else couplings(found.root, found.joints)
    named = gears_of(found.root) | dict(gears or {})
    kind, coils = DRIVES[drive], all("inductance" in motor.electrical for motor in arm.dc_motors.values())
    for joint, speed, (name, guess) in zip(
        arm.joints, arm.speeds, estimated_joints(arm).items(), strict=True
    ):
        torque = guess.effort if guess.stated else None
        loop = drive_lines(kind, joint.limits, speed, joint.slides, torque, file) if kind.inner else None
        if kind.constants:
            loop = electrical_lines(arm.dc_motors[name], kind, guess, file, coils)
        lines += ["", "[[joint]]", f"name = {_text(name)}"]
        if name in coupled:
            row = ", ".join(f"{toml_key(joint)} = {factor:g}" for joint, factor in coupled[name].items())
            lines += [f"coupling = {{ {row} }}  # <transmission> of {file}"]
        own, shaft = arm.motors.get(name, {}), stated.get(name, {})
        if (motor := arm.dc_motors.get(name)) is not None:
            shaft = {"gear_ratio": motor.gear_ratio}
            if motor.rotor_inertia:
                shaft["rotor_inertia"] = motor.rotor_inertia
                shaft |= {"hub_inertia": motor.hub_inertia} if motor.hub_inertia else {}
                own = {quantity: value for quantity, value in own.items() if quantity != "motor_inertia"}
        gear = "" if name in rigid or joint.slides else named.get(name, "")
        lines += _joint(name, guess, own, shaft, file, loop, name in rigid, gear)
    return "\n".join(lines) + "\n"


def _joint(
    name: str,
    guess: EstimatedJoint,
    numbers: Mapping[str, float],
    gear: Mapping[str, float],
    file: str,
    loop: DriveLines | None,
    rigid: bool,
    catalogue: str,
) -> Iterator[str]:
    own, known = dict(numbers), published_as(name)
    published = published_joints()[known].numbers if known else {}
    if known:
        yield f"actuator = {_text(known)}"
    if catalogue:
        yield f"gear = {_text(catalogue)}  # its stiffness is that of the catalogue"
    if loop is not None:
        yield from filter(None, [loop.limit])
    elif not guess.stated:
        yield f"effort_limit = {guess.effort:g}  # {ESTIMATE}: twice what weight asks for"
    if rigid:
        yield f"rigid = true  # {ESTIMATE}: its spring vibrates faster than samples of 1 ms show"
    elif not catalogue and "stiffness" not in published:
        yield from ("[joint.spring]", f"stiffness = {_number(vars(guess.stiffness))}")
    yield "[joint.motor]"
    if "rotor_inertia" in gear and "gear_ratio" in gear and "motor_inertia" not in own:
        own |= gear
    elif loop is not None and loop.before_gear:
        own |= gear
        if "motor_inertia" not in own:
            yield f"motor_inertia = {_number(vars(guess.motor_inertia))}"
    elif not {"motor_inertia"} & {*own, *published}:
        yield f"motor_inertia = {_number(vars(guess.motor_inertia))}"
    if not {"friction"} & {*own, *published}:
        yield f"friction = {_number(vars(guess.friction))}"
    for quantity, value in own.items():
        yield f"{quantity} = {_number({'value': value, 'source': file})}"
    yield from loop.motor if loop is not None else ()


def _number(row: Mapping[str, Any]) -> str:
    tolerance = f", tolerance = {row['tolerance']:g}" if row.get("tolerance") else ""
    return f"{{ value = {float(row['value']):.6g}{tolerance}, source = {_text(row['source'])} }}"


def _moments(six: Sequence[float]) -> str:
    axes = ("xx", "xy", "xz", "yy", "yz", "zz")
    return "{ " + ", ".join(f"{axis} = {value:g}" for axis, value in zip(axes, six)) + " }"


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _home(found: Description, arm: RigidArm) -> dict[str, float]:
    """Where each joint rests: at the keyframe of an MJCF file, else in the middle of its range."""
    keyed = first_keyframe(found.root) if found.is_mjcf else {}
    home = dict[str, float]()
    for joint in arm.joints:
        low, high = joint.limits or (0.0, 0.0)
        place = keyed.get(joint.name, 0.5 * (low + high))
        inside = joint.limits is None or low <= place <= high
        home[joint.name] = float(f"{place if inside else 0.5 * (low + high):.6g}")
    return home


def transmissions(root: Element) -> dict[str, dict[str, float]]:
    """Gear ratio and rotor inertia (kg·m², before the gear) by joint, of <transmission> with Drake's elements."""
    gears: dict[str, dict[str, float]] = {}
    for one in root.iter("transmission"):
        numbers: dict[str, float] = {}
        for element in one.iter():
            key = {"mechanicalReduction": "gear_ratio"}.get(element.tag) or element.tag.rpartition("}")[2]
            if key in ("gear_ratio", "rotor_inertia"):
                try:
                    value = float(element.get("value") or element.text or "")
                except ValueError:
                    continue
                if 0.0 < abs(value) < float("inf"):
                    numbers[key] = abs(value)
        joints = list(one.iter("joint"))
        for joint in joints if len(joints) == 1 else ():  # two motors of one have numbers of their own
            gears[joint.get("name", "")] = numbers
    return gears


def gears_of(root: Element) -> dict[str, str]:
    """Published gears by joint, that the <transmission> of one joint, or an actuator of MJCF, names: CSG-25-100."""
    named: dict[str, str] = {}
    for one in (*root.iter("transmission"), *root.findall("actuator/*")):
        texts = [text for part in one.iter() for text in (part.text or "", *part.attrib.values())]
        tokens = [word.strip(".,;:()[]\"'") for text in texts for word in text.split()]
        known = {gear_name(word) for word in tokens} & {*published_gears()}
        joints = {str(joint.get("name")) for joint in one.findall("joint")} or {
            str(one.get(key)) for key in ON_JOINT if one.get(key)
        }
        if len(known) == len(joints) == 1:
            named[joints.pop()] = known.pop()
    return named


def couplings(root: Element, moving: Sequence[str]) -> dict[str, dict[str, float]]:
    """What the motors of two joints turn by, of differential and four-bar <transmission>s: rows of θ = T q by joint.

    ROS states joints by actuators a behind their gears, and gears n of joints. Of a differential q₁ = (a₁ + a₂)/2n₁ and
    q₂ = (a₁ − a₂)/2n₂: motors are seen from the first joint, θ = a/n₁. Of a four-bar linkage q₁ = a₁/n₁ and
    q₂ = (a₂ − q₁)/n₂: each is seen from its own.
    """
    found: dict[str, dict[str, float]] = {}
    for one in root.iter("transmission"):
        kind = (one.findtext("type") or one.get("type") or "").strip().rpartition("/")[2]
        joints = one.findall("joint")
        pair = [joint.get("name", "") for joint in joints]
        if len(pair) != 2 or not {*pair} <= {*moving}:
            continue
        first, second = (_positive(joint.findtext("mechanicalReduction")) for joint in joints)
        if kind == "DifferentialTransmission":
            found[pair[0]] = {pair[0]: 1.0, pair[1]: second / first}
            found[pair[1]] = {pair[0]: 1.0, pair[1]: -second / first}
        elif kind == "FourBarLinkageTransmission":
            found[pair[1]] = {pair[0]: 1.0 / second, pair[1]: 1.0}
    return found


def published_as(joint: str) -> str:
    """The published joint that a vendor's files call so; "" for any other."""
    return next((name for name, row in published_joints().items() if joint in row.joints), "")


def _positive(text: str | None) -> float:
    """A gear's ratio from a file; 1 where it states none."""
    try:
        value = abs(float(text or "1"))
    except ValueError:
        return 1.0
    return value if 0.0 < value < float("inf") else 1.0
