"""MJCF: the rigid part of a robot that is described for MuJoCo, and its motors' inertia and friction where it has them.

MuJoCo itself reads the file and compiles it, without shapes of bodies that state an inertia; what is read of its model
are bodies, hinge and slide joints, gravity, and the largest forces of actuators. An actuator's own control is not part
of the robot. What would change the dynamics and is not read is refused by name, and no other file is opened. Bodies of
a scene that no chosen joint moves are left out.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, cast
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.robot.arm import Frame
from flexhinf.robot.dynamics import Placement, matrix_of
from flexhinf.robot.faults import collects_faults
from flexhinf.robot.mjcf_actuators import ON_JOINT, dc_motor, largest_effort, motor_numbers, warn_of_actuators
from flexhinf.robot.mjcf_couplings import check_couplings, number_of
from flexhinf.robot.parts import ask
from flexhinf.robot.rigid_arm import (
    MOST_LINKS,
    NEAREST,
    Correction,
    RigidArm,
    check_count,
    locked_joints,
    moved,
    nearest_inertia,
    range_of,
    selection,
)
from flexhinf.validation import HUGE, checked_name, extra_package, one_of, value_text

KINDS = {"mjJNT_HINGE": "revolute", "mjJNT_SLIDE": "prismatic"}

#: What is wrong where the extra is not installed.
NO_MUJOCO = "MJCF is read by MuJoCo, which is not installed."

#: How MuJoCo writes a file with all that it takes from others, and with the masses of its shapes.
WHOLE = (
    "s = mujoco.MjSpec.from_file('this.xml'); s.compiler.saveinertial = True; s.compile(); "
    "pathlib.Path('whole.xml').write_text(s.to_xml()) writes it in one file, every mass stated"
)

#: How Python writes a file without an attribute, in whichever quotes.
PLAIN = (
    "pathlib.Path('plain.xml').write_text(re.sub(r'\\s{key}\\s*=\\s*(.).*?\\1', '', "
    "pathlib.Path('this.xml').read_text()))"
)

#: Elements that add bodies or forces which are not read, and what to do instead.
REFUSED = {
    "include": WHOLE,
    "attach": WHOLE,
    "replicate": WHOLE,
    "composite": "bodies and joints",
    "flexcomp": "bodies and joints",
    "plugin": "the robot without it",
}

#: What is handed to MuJoCo of a file: the elements below <mujoco>, and those of bodies and default classes.
READ = {"compiler", "option", "default", "worldbody", "actuator"}
INSIDE = {"body", "frame", "joint", "freejoint", "inertial", "geom", "default", "flag"}

#: What stands in the world and is no body.
SCENERY = {"geom", "site", "light", "camera"}

#: Kinds of actuators, whose defaults stand in default classes too.
ACTUATORS = {
    "general",
    "motor",
    "position",
    "velocity",
    "intvelocity",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
    "dcmotor",
}

#: Arrays of a compiled model of joints and actuators that are read, that are refused elsewhere, or that change nothing
#: within the limits of the joints; what else a version of MuJoCo has must be as in `NEUTRAL`.
KNOWN = {
    "jnt": "type qposadr dofadr bodyid group limited actfrclimited actgravcomp solref solimp pos axis range "
    "actfrcrange margin user actuatorid stiffness",
    "dof": "bodyid jntid parentid treeid Madr simplenum solref solimp frictionloss armature damping invweight0 M0 "
    "length",
    "actuator": "trntype dyntype gaintype biastype trnid actadr actnum group ctrllimited forcelimited actlimited "
    "dynprm gainprm biasprm actearly ctrlrange forcerange actrange gear cranklength acc0 length0 lengthrange user "
    "plugin history historyadr delay ctrladr ctrlnum outadr outnum ctrlspec armature damping",
}
NEUTRAL = (
    '<mujoco><worldbody><body><joint name="a"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>'
    '<actuator><motor joint="a"/></actuator></mujoco>'
)

#: Shapes whose mass needs no other file.
SOLID = ("sphere", "capsule", "cylinder", "ellipsoid", "box")

#: Springs that act on joints, and what they would be.
SPRING = "a spring that pulls the link to a place; that behind the motor stands in the elastic file"
ACTING = ("stiffness", "springdamper")

_NOT_FINITE = re.compile(r"(^|\s)[+-]?(nan|inf)", re.IGNORECASE)


def read_mjcf(
    root: Element,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
    inertias: Mapping[str, Correction] | None = None,
) -> RigidArm:
    """The moving joints of an MJCF file, of its root <mujoco>, and their links. Needs the extra ``mujoco``.

    `joints`, `locked` and `inertias` as for `flexhinf.robot.urdf.read_urdf`; what is not read and would change the
    dynamics is refused.
    """
    mujoco = extra_package("mujoco", "mujoco", NO_MUJOCO)
    check_whole(root)
    check_count("bodies", sum(1 for _ in root.iter("body")), MOST_LINKS)
    scene = scene_of(root)
    movable = tuple(joint.name for joint in scene.joints if joint.type.name in KINDS)
    arm = RigidArm(movable, locked_joints(movable, joints, locked))
    moving = [name for name in movable if name not in arm.locked]
    root = _arm_of(root, set(moving))
    _check_elements(root, REFUSED)
    spec = _by_mujoco(mujoco.MjSpec.from_string, ElementTree.tostring(_kept(root), encoding="unicode"))
    _check(spec, moving)
    _check_still(spec, moving, joints is not None or bool(locked))
    spec.compiler.fusestatic = spec.compiler.discardvisual = False
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)  # shapes may overlap
    _correct(spec, inertias or {})
    check_couplings(root, moving)
    _use_shapes(spec, set(moving))
    model = _by_mujoco(spec.compile)
    _check_arrays(mujoco, model, moving)
    warn_of_actuators(root, moving)
    arm.locked = _with_followers(root, arm.locked, model)
    return _filled(arm, model)


def _correct(spec: Any, inertias: Mapping[str, Correction]) -> None:
    """Put other inertias in the place of those of bodies: MuJoCo refuses a file with one that no body has."""
    bodies = {body.name: body for body in spec.bodies}
    for name, six in inertias.items():
        one_of(f"There is no body {value_text(name, 60)} whose inertia could be corrected.", name, bodies)
        body, full = bodies[name], np.array(bodies[name].fullinertia)
        if six != NEAREST:
            xx, xy, xz, yy, yz, zz = map(float, six)
            body.fullinertia, body.iquat = [xx, yy, zz, xy, xz, yz], [1.0, 0.0, 0.0, 0.0]
        elif np.isfinite(full[0]):
            whole = nearest_inertia(matrix_of([full[k] for k in (0, 3, 4, 1, 5, 2)]))
            body.fullinertia = [whole[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        else:
            body.inertia = np.diag(nearest_inertia(np.diag(body.inertia)))


def check_whole(root: Element) -> None:
    """Refuse a file that takes the arm, or parts of it, from elsewhere."""
    _check_elements(root, ("include", "attach", "replicate"))


def _check_elements(root: Element, refused: Collection[str]) -> None:
    for element in root.iter():
        included = element.get("file") if element.tag == "include" else None
        refuse_if(
            element.tag in refused,
            f"<{element.tag}> is not read.",
            "expected bodies, joints and inertials in this file"
            + (f", got {value_text(included, 60)}" if included else ""),
            ("the file that it includes, if the arm is in it; or " if included else "")
            + REFUSED.get(element.tag, ""),
        )


def _arm_of(root: Element, moving: Collection[str]) -> Element:
    """The file without what the world carries beside the moving joints, and without its actuators; says which bodies
    that could move are left out."""
    root, left, gone = copy.deepcopy(root), list[str](), set[str]()
    for world in root.findall("worldbody"):
        for part in [part for part in world if part.tag not in SCENERY]:
            names = {joint.get("name", "") for joint in part.iter("joint")}
            if not names & {*moving}:
                world.remove(part)
                gone |= names
                left += (
                    [part.get("name", part.tag)] if names or any(True for _ in part.iter("freejoint")) else []
                )
    for group in root.findall("actuator"):
        for actuator in [part for part in group if any(part.get(key) in gone for key in ON_JOINT)]:
            group.remove(actuator)
    ask(
        left,
        f"Bodies of the scene are left out: {value_text(', '.join(left), 120)}.",
        "expected the arm, and what its joints carry",
        "the joints that move them, in joints = [...], where they belong to the arm",
    )
    return root


def _check_still(spec: Any, moving: Sequence[str], chosen: bool) -> None:
    """Let balls and a base that floats stand still where some joints were chosen to move; refuse them else."""
    free, balls = (
        [(body.name, joint) for body in spec.bodies for joint in body.joints if joint.type.name == kind]
        for kind in ("mjJNT_FREE", "mjJNT_BALL")
    )
    base = ", ".join(repr(name) for name, _ in free)
    refuse_if(
        free and not chosen,
        f"the base {base} floats: its joint is of type 'free'.",
        "expected a robot on a fixed base",
        f"{selection(moving, moving)}: the base then stands where it is drawn",
    )
    ask(
        free,
        f"The base {base}, which floats, stands still as it is drawn.",
        "expected a robot on a fixed base",
        "the file without its joint of type 'free'",
    )
    names = ", ".join(repr(joint.name or f"of body {name}") for name, joint in balls)
    refuse_if(
        balls and not chosen,
        f"the joint {names} is of type 'ball'.",
        "expected hinge or slide",
        selection(moving, moving),
    )
    ask(
        balls,
        f"The ball joint {names} stands still as it is drawn.",
        "expected hinge or slide joints",
        "the file without it",
    )


def _by_mujoco(read: Callable[..., Any], *texts: str) -> Any:
    try:
        return read(*texts)
    except Exception as error:  # whatever MuJoCo's parser and compiler refuse
        raise InvalidInput(
            "MuJoCo does not read it.",
            f"got: {' '.join(str(error).split())}",
            "a file that MuJoCo's own viewer opens",
        ) from error


# Before MuJoCo reads it ---------------------------------------------------------------------------


def _kept(root: Element) -> Element:
    """The elements that are handed to MuJoCo: no other files, and nothing that does not act on a joint."""
    kept = _pruned(root, READ)
    kept.attrib.clear()
    for element in kept.iter():
        stated = element.findall("inertial")
        keys = set(stated[0].attrib) if stated else {"pos", "mass", "diaginertia"}
        whole = {"pos", "mass"} <= keys and len(keys & {"diaginertia", "fullinertia"}) == 1
        refuse_if(
            len(stated) > 1 or not whole,
            f"the inertia of the body {value_text(element.get('name', ''), 60)} is incomplete or stands twice.",
            f"expected one <inertial> with pos, mass, and diaginertia or fullinertia, got {len(stated)} with "
            f"{value_text(sorted(keys), 120)}",
            '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>',
        )
        for key, text in element.attrib.items():
            if key in ("name", "class", "childclass", "joint"):
                continue
            lowest = 0.0 if key in ("mass", "density") else -HUGE
            outside = any(number < lowest or number > HUGE for number in map(number_of, text.split()))
            refuse_if(
                outside or _NOT_FINITE.search(text),
                f"{key} of <{element.tag}> cannot be read.",
                f"expected numbers from {lowest:g} to {HUGE:g}, got {value_text(text, 60)}",
                "correct the value",
            )
    return kept


def _pruned(element: Element, inside: Collection[str] = INSIDE) -> Element:
    kept = Element(element.tag, {key: text for key, text in element.attrib.items() if key != "material"})
    if element.tag == "actuator":
        kept.extend(child for child in element if any(child.get(key) is not None for key in ON_JOINT))
    else:
        inside = {*inside, *ACTUATORS} if element.tag == "default" else inside
        kept.extend(_pruned(child) for child in element if child.tag in inside)
    return kept


def _check_arrays(mujoco: Any, model: Any, moving: Sequence[str]) -> None:
    """Refuse numbers of moving joints, and of their actuators, that this reader does not know and that are not neutral.

    Versions of MuJoCo add such numbers, as the coefficients of a damping that grows with the speed.
    """
    neutral = mujoco.MjModel.from_xml_string(NEUTRAL)
    joints = [model.joint(name).id for name in moving]
    acting = [k for k, (joint, _) in enumerate(model.actuator_trnid.tolist()) if joint in joints]
    places = {"jnt": joints, "dof": [int(model.jnt_dofadr[j]) for j in joints], "actuator": acting}
    owners = {"jnt": joints, "dof": joints, "actuator": [int(model.actuator_trnid[k, 0]) for k in acting]}
    for kind, known in KNOWN.items():
        names = {name for name in dir(model) if name.startswith(f"{kind}_")}
        for name in sorted(names - {f"{kind}_{word}" for word in known.split()}):
            usual, values = np.asarray(getattr(neutral, name)), np.asarray(getattr(model, name))
            for place, joint in zip(places[kind], owners[kind]):
                refuse_if(
                    not np.array_equal(values[place], usual[0]),
                    f"{name.removeprefix(f'{kind}_')} of the {'actuator' if kind == 'actuator' else 'joint'} of "
                    f"{model.joint(joint).name!r} is not read.",
                    f"expected {usual[0].tolist()}, got {values[place].tolist()}",
                    "one coefficient of damping, and armature and damping on the joint itself",
                )


def _check(spec: Any, moving: Sequence[str]) -> None:
    compiler = spec.compiler
    for key in ("boundmass", "boundinertia", "settotalmass", "balanceinertia"):
        acts = getattr(compiler, key) > 0.0
        advice = "the file without it, with the masses that it would make written out"
        refuse_if(acts, f"<compiler {key}> is not read.", "expected masses as they are stated", advice)
    refuse_if(
        spec.option.density != 0.0 or spec.option.viscosity != 0.0,
        "<option> has a medium.",
        f"expected density and viscosity 0, got {spec.option.density:g} and {spec.option.viscosity:g}",
        "<option> without density and viscosity",
    )
    joints = [joint for joint in spec.joints if joint.name in moving]
    for bits, key in ((_NO_FRICTION, "frictionloss"), (_NO_DAMPING, "damping")):
        refuse_if(
            bool(spec.option.disableflags & bits) and any(np.any(getattr(joint, key)) for joint in joints),
            f"<option><flag> switches off the {key} that joints state.",
            f"expected joints without {key}, or no such flag",
            f"the file without this flag, or without {key}",
        )
    for kind, named in (("joint", joints), ("body", [body for body in spec.bodies[1:] if body.name])):
        for part in named:
            checked_name(f"a {kind}", part.name, spaces=True)
    own = [
        (body.name, [joint.name for joint in body.joints if joint.name in moving]) for body in spec.bodies[1:]
    ]
    others = {name for _, names in own for name in names[:-1]}
    # where faults are collected, each joint without a mass of its own is one
    for body, names in [row for row in own if len(row[1]) > 1 and not collects_faults()][:1]:
        raise InvalidInput(
            f"the body {value_text(body, 60)} has {len(names)} joints: {', '.join(map(repr, names))}.",
            "expected at most one joint for each body: a link between two joints has a mass",
            selection([name for name in moving if name not in others], moving),
        )
    parts = [(f"the joint {joint.name!r}", joint) for joint in joints]
    for key in ACTING:
        values = {
            where.removeprefix("the joint "): np.asarray(getattr(part, key, 0.0)) for where, part in parts
        }
        acting = {where: value.tolist() for where, value in values.items() if np.any(value != 0.0)}
        refuse_if(
            acting,
            f"{', '.join(acting)}: {key} is not read.",
            f"expected none, got {key} = {', '.join(map(str, acting.values()))}: {SPRING}",
            f"{key}='0' in each of them, or: {PLAIN.format(key=key)} writes a file where none has it",
        )
    moved_bodies = [body.name for body in spec.bodies if body.gravcomp and _moves_with(body, moving)]
    ask(
        moved_bodies,
        "gravcomp is left out: the motors carry the whole weight of "
        f"{value_text(', '.join(moved_bodies), 160)}.",
        "expected links whose weight the motors carry, got a share of it that nothing carries",
        "a file without gravcomp; where a counterweight or a spring carries it, this is another robot",
    )
    for where, part in [
        *parts,
        *((f"the actuator of {actuator.target!r}", actuator) for actuator in spec.actuators),
    ]:
        for key in ("", "actfrc", "force", "ctrl"):
            low, high = getattr(part, f"{key}range", (0.0, 0.0))
            switch = getattr(part, f"{key}limited", 0)
            acts = switch == 1 or (switch == 2 and compiler.autolimits and (low or high))
            refuse_if(
                acts and not low < high,
                f"the {key}range of {where} is none.",
                f"expected two ends in order, got {low:g} to {high:g}",
                f'{key}range="-1 1"',
            )


def _moves_with(body: Any, moving: Collection[str]) -> bool:
    """Whether a moving joint is between a body and the world."""
    while body is not None and not any(joint.name in moving for joint in body.joints):
        body = body.parent
    return body is not None


def _use_shapes(spec: Any, moving: Collection[str]) -> None:
    """Leave out shapes without mass, and those of bodies whose inertia is stated; refuse a mesh that has a mass."""
    for geom in spec.geoms:
        body, kind = geom.parent, geom.type.name.removeprefix("mjGEOM_").lower()
        stated = body.explicitinertial and spec.compiler.inertiafromgeom.name != "mjINERTIAFROMGEOM_TRUE"
        light = geom.mass == 0.0 or (not geom.mass > 0.0 and geom.density == 0.0)
        solid = kind in SOLID and not geom.meshname
        if stated or light or kind == "plane" or not (solid or _moves_with(body, moving)):
            kinds = cast("Any", type(geom.type))
            geom.type, geom.meshname, geom.hfieldname = kinds.mjGEOM_SPHERE, "", ""
            geom.mass, geom.density, geom.size = 0.0, 0.0, (1.0, 0.0, 0.0)
            geom.fromto = (np.nan,) * 6
        elif not solid:
            raise InvalidInput(
                f"the mass of the geom {value_text(geom.name, 60)} of {body.name!r} would have to come from its shape.",
                f"expected <inertial> in its body, or a solid {', '.join(SOLID)}, got type {kind!r}",
                f'{WHOLE}; or mass="0" for a shape that is only drawn',
            )


def _with_followers(root: Element, locked: Mapping[str, float | None], model: Any) -> dict[str, float | None]:
    """Locked joints; those that nobody placed and <equality> couples to one of them stand where it takes them."""
    placed, names = dict(locked), {model.joint(j).name for j in range(model.njnt)}
    parts = [part for group in root.findall("equality") for part in group.iter("joint")]
    active = [part for part in parts if part.get("active") != "false" and part.get("joint1") in names]
    coupled = {} if model.opt.disableflags & _NO_COUPLING else {part.get("joint1"): part for part in active}

    def stand(name: str, behind: Collection[str] = ()) -> float:
        if (value := placed.get(name)) is not None:
            return value
        (zero,), place = model.qpos0[model.joint(name).qposadr], 0.0
        if name in coupled and name not in behind:
            stated, leader, off = coupled[name].get("polycoef", "").split(), coupled[name].get("joint2"), 0.0
            if leader is not None and leader in names:
                off = stand(leader, {*behind, name}) - float(model.qpos0[model.joint(leader).qposadr[0]])
            terms = [*map(number_of, stated), *(0.0, 1.0, 0.0, 0.0, 0.0)[len(stated) :]]
            place = zero + sum(term * off**power for power, term in enumerate(terms[:5]))
            found = f"expected up to 5 numbers, got {value_text(stated, 60)}"
            unclear = len(stated) > 5 or not abs(place) <= HUGE
            refuse_if(unclear, f"polycoef of {name!r} cannot be read.", found, 'polycoef="0 1"')
        low, high = model.joint(name).range if model.joint(name).limited[0] else (place, place)
        return float(min(max(place, low), high))

    return {name: stand(name) if name in coupled else value for name, value in placed.items()}


def scene_of(root: Element) -> Any:
    """MuJoCo's own reading of a file, without what shows or touches; a mistake that it finds is refused."""
    mujoco = extra_package("mujoco", "mujoco", NO_MUJOCO)
    return _by_mujoco(mujoco.MjSpec.from_string, ElementTree.tostring(_kept(root), encoding="unicode"))


# From MuJoCo's model ------------------------------------------------------------------------------
def _filled(arm: RigidArm, model: Any) -> RigidArm:
    places: list[tuple[int | None, Placement]] = [(None, Placement())]
    for k in range(1, model.nbody):
        name = model.body(k).name
        carrier, above = places[int(model.body_parentid[k])]
        place = above.then(_placement(model.body_pos[k], model.body_quat[k]))
        for j in range(model.body_jntadr[k], model.body_jntadr[k] + model.body_jntnum[k]):
            if model.jnt_type[j] < 2:
                continue  # a ball, which stands still
            joint, axis = model.joint(j).name, tuple(model.jnt_axis[j].tolist())
            at = int(model.jnt_qposadr[j])
            kind = "revolute" if model.jnt_type[j] == 3 else "prismatic"
            limits: Any = range_of(*model.jnt_range[j].tolist()) if model.jnt_limited[j] else None
            a, b, c = model.jnt_pos[j].tolist()
            place = place.then(Placement(translation=(a, b, c))).then(
                moved(kind, axis, -float(model.qpos0[at]))
            )
            kind = "continuous" if kind == "revolute" and limits is None else kind
            carrier, place = arm.add_joint(carrier, joint, kind, axis, place, limits)
            if joint not in arm.locked:
                arm.efforts.append(largest_effort(model, j))
                arm.motors[joint] = motor_numbers(model, j)
                if (motor := dc_motor(model, j)) is not None:
                    arm.dc_motors[joint] = motor
                arm.frames[joint] = Frame(joint, Placement())
            place = place.then(Placement(translation=(-a, -b, -c)))
        places.append((carrier, place))
        if carrier is not None:
            centre = place.then(_placement(model.body_ipos[k], model.body_iquat[k]))
            arm.add_body(carrier, name, float(model.body_mass[k]), np.diag(model.body_inertia[k]), centre)
            if name:
                arm.frames[name] = Frame(arm.joints[carrier].name, place)
    gravity = np.array(model.opt.gravity) * (not model.opt.disableflags & _NO_GRAVITY)
    arm.gravity = float(np.linalg.norm(gravity))
    x, y, z = (gravity / arm.gravity if arm.gravity else np.array([0.0, 0.0, -1.0])).tolist()
    arm.down, arm.speeds = (x, y, z), [np.inf] * len(arm.joints)
    ends = set(range(1, model.nbody)) - set(model.body_parentid[1:].tolist())
    arm.tips = [name for name in (model.body(k).name for k in sorted(ends)) if name in arm.frames]
    return arm.merge()


_NO_GRAVITY, _NO_COUPLING = 1 << 7, 1 | 1 << 1  # mjDSBL_GRAVITY; mjDSBL_CONSTRAINT, mjDSBL_EQUALITY
_NO_FRICTION, _NO_DAMPING = 1 | 1 << 2, 1 << 6  # mjDSBL_CONSTRAINT, mjDSBL_FRICTIONLOSS; mjDSBL_DAMPER


def _placement(position: np.ndarray, quaternion: np.ndarray) -> Placement:
    refuse_if(
        not np.all(np.abs(position) <= HUGE),
        "a body is out of all proportion.",
        f"expected at most {HUGE:g} m, got {position.tolist()}",
        "metres",
    )
    w, *axis = quaternion.tolist()
    place = Placement(translation=tuple(position.tolist()))
    length = float(np.linalg.norm(axis))  # 0 where nothing turns, for w = -1 too
    return place.then(moved("revolute", axis, 2.0 * float(np.arctan2(length, w)))) if length else place
