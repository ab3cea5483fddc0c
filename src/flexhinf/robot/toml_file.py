"""One robot file in TOML: the whole robot, or the elastic joints for links that another file states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from flexhinf.errors import InvalidInput, located, refuse_if
from flexhinf.plant import Penalty
from flexhinf.robot.arm import SHAPES, Frame, Payload, Pendulum, inertia_of_shape, payload_from_text
from flexhinf.robot.drive_limits import OF_COMMANDS, per_second
from flexhinf.robot.drives import DRIVES
from flexhinf.robot.dynamics import ZERO, Joint, Placement, Tree
from flexhinf.robot.faults import collects_faults, refuse_part
from flexhinf.robot.file_keys import (
    NESTING,
    TABLES,
    Key,
    Place,
    Unusable,
    is_dict,
    is_table,
    key_advice,
    number_in,
    place_text,
)
from flexhinf.robot.gears import CURVE
from flexhinf.robot.joint_sensors import file_sensors
from flexhinf.robot.kinematics import check_geometry, check_load
from flexhinf.robot.layout import coupling_rows
from flexhinf.robot.mjcf import read_mjcf
from flexhinf.robot.parameters import INERTIA, Parameter, Stated, per_joint, unit_of
from flexhinf.robot.parts import (
    ElasticJoint,
    Link,
    SingleLink,
    ask,
    assembled,
    interval_of,
    single_link_robot,
    value_of,
)
from flexhinf.robot.rigid_arm import GRAVITY, MOST_JOINTS, RigidArm, check_count, check_turns, selection
from flexhinf.robot.robot import Robot
from flexhinf.robot.urdf import read_urdf
from flexhinf.validation import distinct, read_toml, read_xml, unknown_name, value_text

#: How names of MJCF files end; a URDF may end so too, its root element decides.
MJCF = (".xml", ".mjcf")

#: Numbers whose tolerance in a table [tolerances] has another name.
KEYS = {"rotor_inertia": "motor_inertia", "axis_inertia": "inertia", "length": "centre_of_mass"}


#: What to write for a table that is missing.
MISSING = {
    "spring": "[joint.spring] with stiffness = … (N·m/rad; N/m for a prismatic joint)",
    "joint": "one [[joint]] table per joint, with name, link, spring and motor",
    "weights": "weights = {link_position = 60, link_position_integral = 300}",
    "name": "name = 'shoulder'",
}


class RobotFile:
    """One robot file: `root` has the keys of `TABLES` that are stated or have a default.

    Of its mistakes the first one is raised, with the number of the others. A number takes its tolerance from itself,
    else from its joint, else from the whole file.
    """

    def __init__(self, path: Path) -> None:
        try:
            self.data = read_toml(path)
        except InvalidInput as error:
            if "joint" not in error.found and "overwrite" not in error.found:
                raise
            raise InvalidInput(error.what, error.found, f"correct that line; a joint is {NESTING}") from error
        self.file = path.name
        if isinstance(self.data.get("joint"), list):
            with located(self.file):
                check_count("joints", len(self.data["joint"]), MOST_JOINTS)
        self.stated: list[tuple[Place, tuple[str, ...], Stated]] = []
        self._mistakes: list[tuple[str, str, str]] = []
        self.root = self.table(self.data, TABLES[""], ())
        for what, found, advice in self._mistakes if collects_faults() else ():
            refuse_part(True, "", (), f"{self.file}: {what}.", found, advice)
        if self._mistakes:
            what, found, advice = self._mistakes[0]
            others = f" (and {len(self._mistakes) - 1} more)" if len(self._mistakes) > 1 else ""
            raise InvalidInput(f"{self.file}: {what}{others}.", found, advice)
        self.name = self.root["name"] or path.stem
        self._tolerances: dict[str | None, dict[str, float]] = {
            None: self.root["tolerances"],
            **{row["name"]: row["tolerances"] for row in self.root["joint"]},
        }
        self._used: set[tuple[str | None, str]] = set()

    # Keys -----------------------------------------------------------------------------------------
    def table(self, data: object, keys: Mapping[str, Key], place: Place) -> dict[str, Any]:
        """The keys of a table that are stated or have a default."""
        if not is_dict(data):
            raise Unusable("a table", "")
        where, values = place_text(place, self.data), dict[str, Any]()
        unknown = [name for name in data if name not in keys]
        self._mistakes += [
            (
                f"{where} has an unknown key {name!r}",
                f"expected keys out of {list(keys)}, got {name!r}",
                key_advice(name, keys, is_table(data[name])),
            )
            for name in unknown
        ]
        for name, key in keys.items():
            if name in data:
                values[name] = self._value(data[name], key, (*place, name))
            elif key.required and not unknown:
                unit = f" ({key.units[0]})" if key.units else ""
                self._mistakes.append(
                    (
                        f"{where} has no {name!r}",
                        f"expected {name!r}{unit}, got only {list(data)}",
                        MISSING.get(name, f"{name} = …{unit}"),
                    )
                )
            elif key.default is not None:
                values[name] = key.default
        return values

    def _value(self, value: object, key: Key, place: Place) -> object:
        try:
            parsed = key.read(self, value, key, place)
            if not key.usable(parsed):
                raise Unusable(key.expected, "")
            return parsed
        except Unusable as wrong:
            *before, name = place if place[-1] != "value" else place[:-1]
            expected, advice = wrong.args
            self._mistakes.append(
                (
                    f"{place_text(tuple(before), self.data)} has a value of {name!r} that cannot be used",
                    f"expected {expected}, got {value_text(value, 60)}",
                    f"{name} = {advice}" if advice else NESTING if is_table(value) else "correct the value",
                )
            )
            return None

    def check_units(self, robot: Robot) -> Robot:
        """Return the robot; refuse units of a joint that turns where it slides, and of another drive."""
        slides = dict(zip(robot.joint_names, robot.links.slides))
        for place, units, number in self.stated:
            kinds = set(slides.values()) if place[0] == "home" else set[bool]()
            if place[0] == "joint" and len(place) > 2:
                name = self.data["joint"][place[1]].get("name")
                kinds = {slides[name]} if name in slides else set[bool]()
            order = next((k for k, name in enumerate(OF_COMMANDS) if name in place), None)
            own = robot.drive_kind.units
            choices = units if order is None else [per_second(unit, order) for unit in own]
            fitting = sorted({choices[kind if len(choices) > 1 else 0] for kind in kinds})
            if fitting and number.si not in fitting:
                *before, key = (part for part in place if part not in ("value", "range"))
                stated = f"{number.number} {number.unit}"
                expected, advice = number_in(stated, fitting)
                raise InvalidInput(
                    f"{self.file}: {place_text(tuple(before), self.data)} has a value of {key!r} in another unit.",
                    f"expected {expected}, got {value_text(stated, 60)}",
                    f"{key} = {advice}",
                )
        return robot

    # Robots ---------------------------------------------------------------------------------------
    def whole_robot(
        self, chosen: Sequence[str] | None, locked: Mapping[str, float] | None, payload: object
    ) -> Robot:
        """The robot of a TOML file that states its links too."""
        table, file = self.root, self.file
        refuse_if(
            chosen is not None or locked or "joints" in table or table["locked"] or table["links"],
            f"{file}: joints are chosen or locked, and links corrected, in a URDF only.",
            "expected neither joints, locked nor links without urdf",
            "leave the joint out of the file; state the link's inertia in [joint.link]",
        )
        joints = list[Joint]()
        for row in table["joint"]:
            angles = row.get("rpy", [0.0, 0.0, 0.0])
            check_turns(f"{file}: joint {row['name']!r}", angles, "rpy = [{}, {}, {}]")
            stated = {key: row[key] for key in ("kind", "axis", "limits", "parent") if key in row}
            with located(file):
                joints.append(
                    Joint(row["name"], placement=Placement.of(row.get("xyz", ZERO), angles), **stated)
                )
        links = [self._link(row) for row in table["joint"]]
        springs = [self._elastic(row, joint.slides) for row, joint in zip(table["joint"], joints)]
        settings = self._settings(table["joint"])
        if isinstance(links[0], SingleLink) and len(links) == 1 and "down" not in settings:
            with located(file):
                robot = single_link_robot(self.name, joints[0], links[0], springs[0], **settings)
        elif any(isinstance(link, SingleLink) for link in links):
            raise InvalidInput(
                f"{file}: axis_inertia is for a single link about a horizontal axis.",
                f"expected one joint and no 'down', got {len(joints)} joints",
                "mass, centre_of_mass and inertia of each link",
            )
        else:
            bodies = [link for link in links if isinstance(link, Link)]
            self._ask_places(joints, bodies)
            with located(file):
                robot = assembled(self.name, joints, bodies, springs, **settings)
        # A file states no shapes: a payload without a place of its own is where the link is drawn to end, at twice the
        # distance of the centre of mass.
        frames = dict[str, Frame]()
        for joint, link in zip(joints, links):
            centre = (link.length, 0.0, 0.0) if isinstance(link, SingleLink) else link.centre_of_mass
            x, y, z = (2.0 * value_of(x) for x in centre)
            frames[joint.name] = Frame(joint.name, Placement(), tip=(x, y, z))
        tips = [joint.name for i, joint in enumerate(joints) if i not in robot.links.tree.parents]
        return self._finished(robot, frames, tips, payload)

    def robot_with(
        self, rigid: Path, chosen: Sequence[str] | None, locked: Mapping[str, float] | None, payload: object
    ) -> Robot:
        """The robot whose links another file states."""
        table, file = self.root, self.file
        rows = {row["name"]: row for row in table["joint"]}
        for row in table["joint"]:
            for key in [key for key in ("kind", "axis", "xyz", "rpy", "parent", "link") if key in row]:
                raise InvalidInput(
                    f"{file}: the joint {row['name']!r} states {key!r}, which the URDF states too.",
                    f"expected name, spring, motor (and limits) only, got {list(row)}",
                    f"leave it out; {rigid.name} decides",
                )
        root = read_xml(rigid)
        read = read_mjcf if rigid.suffix.lower() in MJCF and root.tag == "mujoco" else read_urdf
        chosen = table.get("joints") if chosen is None else chosen
        with located(rigid.name):
            inertias = {name: row["inertia"] for name, row in table["links"].items()}
            arm = read(root, chosen, {**table["locked"], **(locked or {})}, inertias)
        distinct(f"{file}: the joint", [row["name"] for row in table["joint"]])
        names = [joint.name for joint in arm.joints]
        for name in [name for name in rows if name not in arm.movable]:
            refuse_if(
                any(joint.get("name") == name for joint in root.iter("joint")),
                f"{file}: the joint {name!r} of {rigid.name} does not move.",
                f"expected one of {list(arm.movable)}, got a joint of another kind",
                f"leave out the [[joint]] of {name!r}",
            )
            raise unknown_name(f"{file}: there is no joint {name!r} in {rigid.name}.", name, arm.movable)
        missing, stated = ([name for name in names if (name in rows) == known] for known in (False, True))
        refuse_if(
            missing,
            f"{file}: joints of {rigid.name} have no stiffness: {', '.join(map(repr, missing))}.",
            f"expected a [[joint]] for each of {names}, got {list(rows)}",
            f"a [[joint]] for each; or {selection(stated, arm.movable)}",
        )
        kept = [rows[name] for name in names]
        placed = [replace(j, limits=row.get("limits", j.limits)) for j, row in zip(arm.joints, kept)]
        springs = [
            self._elastic(row, joint.slides, arm.motors.get(row["name"], {}), rigid.name)
            for row, joint in zip(kept, placed)
        ]
        tell_friction(file, kept, arm, rigid.name)
        links = list[Link]()
        for link, name in zip(arm.links, names):
            mass, centre = (self._tolerance(name, quantity) for quantity in ("mass", "centre_of_mass"))
            tolerances = (mass, *[centre] * 3, *[0.0] * 6)
            numbers = [
                Parameter("of a link", value_of(value), tolerance, source=rigid.name)
                for value, tolerance in zip((link.mass, *link.centre_of_mass, *link.inertia), tolerances)
            ]
            links.append(Link(numbers[0], numbers[1:4], numbers[4:]))
        # <limit effort> is a torque: it says nothing about a motor whose input is a voltage or a current.
        efforts = arm.efforts if DRIVES[springs[0].drive].takes_torques else None
        settings = self._settings(kept, arm.gravity, arm.down, efforts, arm.speeds)
        with located(file):
            robot = assembled(self.name, placed, links, springs, **settings)
        return self._finished(robot, arm.frames, arm.tips, payload)

    def _settings(
        self,
        rows: Sequence[Mapping[str, Any]],
        fall: float = GRAVITY,
        direction: Sequence[float] | None = None,
        efforts: Sequence[float] | None = None,
        speeds: Sequence[float] | None = None,
    ) -> dict[str, Any]:
        table, nothing = self.root, [None] * len(rows)
        known = {"effort_limit": efforts, "speed_limit": speeds}  # of a description, where no row states it
        settings = {key: table.get(key) for key in ("home", "description")}
        if "penalty" in table:
            settings["penalty"] = Penalty(table["penalty"]["weights"], effort=table["penalty"]["effort"])
        if (down := table.get("down", direction)) is not None:
            settings["down"] = down
        coupled = {row["name"]: row["coupling"] for row in rows if "coupling" in row}
        with located(self.file):
            settings["coupling"] = coupling_rows(coupled, [row["name"] for row in rows])
        return settings | {
            "gravity": self._number(table["gravity"], "gravity") if "gravity" in table else fall,
            **{
                key.field: [row.get(name, other) for row, other in zip(rows, known.get(name) or nothing)]
                for name, key in TABLES["joint"].items()
                if key.field
            },
        }

    def _finished(
        self, robot: Robot, frames: Mapping[str, Frame], tips: Sequence[str], loads: object
    ) -> Robot:
        """The robot with its payloads (those of `loads`, or the file's), its tolerances and units checked.

        Payloads are in `frames`; where one does not say in which, that of the only one of the `tips` is meant.
        """
        names, count = robot.joint_names, len(robot.joint_names)
        rows = cast("Sequence[object]", loads) if isinstance(loads, (list, tuple)) else [loads]
        usable = [row for row in rows if isinstance(row, (str, Payload))]
        refuse_if(
            loads is not None and len(usable) < len(rows),
            "The payload is none.",
            f"expected text, a Payload or several, got {value_text(cast(object, loads))}",
            "payload='0..3kg@hand'",
        )
        payloads = (
            [self._payload(row) for row in self.root["payload"]]
            if loads is None
            else [row if isinstance(row, Payload) else payload_from_text(row) for row in usable]
        )
        places = list[Frame]()
        for payload in payloads:
            at = tips[0] if not payload.at and len(tips) == 1 else payload.at
            refuse_if(
                at not in frames,
                f"{self.file}: the payload is at {value_text(at, 60)}, which carries nothing."
                if at
                else f"{self.file}: the payload does not say what carries it, of several ends.",
                f"expected one of {list(frames)}",
                "at = '{0}', or --payload 0..3kg@{0}".format(*tips, *frames),
            )
            places.append(frames[at])
        distinct(f"{self.file}: a payload of the link of joint", [frame.joint for frame in places])
        for payload in payloads if isinstance(robot.links, Pendulum) else ():
            # A link that states no frame of its own carries on the line from its axis to its centre of mass.
            beside = [x.value for x in (payload.centre_of_mass or ())[1:]]
            refuse_if(
                any(beside),
                f"{self.file}: the payload is beside a link that states axis_inertia and length only.",
                f"expected its centre of mass at [x, 0, 0], x along the link, got y, z = {beside}",
                "mass, centre_of_mass and inertia of the link instead of axis_inertia",
            )
        added = [number for load, frame in zip(payloads, places) for number in load.parameters(frame, count)]
        # A factor of all moments of a link whose inertia has a tolerance in a table [tolerances].
        scales = list[Parameter]()
        stated = {row["name"]: row.get("link", {}) for row in self.root["joint"]}
        for joint in names:
            link = stated.get(joint, {})
            own = "tolerance" in link.get("inertia", {}) or "axis_inertia" in link
            if not own and (tolerance := self._tolerance(joint, "inertia")):
                label, unit = per_joint("inertia_scale", joint, count), unit_of("inertia_scale")
                scales.append(Parameter(label, 1.0, tolerance, unit, "tolerance of its inertia"))
        robot = robot.with_parameters(*scales, *added)
        slides = robot.links.slides
        robot = replace(
            robot, sensors=file_sensors(self.file, self.root["joint"], names, slides, robot.nominal)
        )
        moving = {joint for joint, _ in self._used}
        for joint in [joint for joint in self._tolerances if joint in moving]:
            known = sorted(key for owner, key in self._used if owner == joint)
            for key in [key for key in self._tolerances[joint] if key not in known]:
                raise InvalidInput(
                    f"{self.file}: [tolerances] has {key!r}, which no joint states."
                    if joint is None
                    else f"{self.file}: [joint.tolerances] of {joint!r} has {key!r}, which the joint does not state.",
                    f"expected keys out of {known}, got {key!r}",
                    f"state {key!r} with its value first, or leave out its tolerance",
                )
        check_geometry(robot, self.file)
        check_load(robot, self.file)
        return self.check_units(robot)

    # Numbers --------------------------------------------------------------------------------------
    def _tolerance(self, joint: str, quantity: str) -> float:
        """Tolerance, per cent, that the tables [tolerances] state for a number without one of its own."""
        key = KEYS.get(quantity, quantity)
        self._used |= {(None, key), (joint, key)}
        return self._tolerances.get(joint, {}).get(key, self._tolerances[None].get(key, 0.0))

    def _vector(
        self, table: Mapping[str, Any], quantity: str, joint: str | None = None
    ) -> tuple[Parameter, ...]:
        """Parameters from the table of a vector, with the same tolerance and source."""
        return tuple(self._number({**table, "value": entry}, quantity, joint) for entry in table["value"])

    def _number(self, table: Mapping[str, Any], quantity: str, joint: str | None = None) -> Parameter:
        """A parameter from the table of a number."""
        tolerance, ends = table.get("tolerance"), table.get("range")
        usual = (
            0.0 if joint is None else self._tolerance(joint, quantity)
        )  # a table may state more than is used
        if tolerance is None:
            tolerance = usual if ends is None else 0.0
        return Parameter(quantity, table["value"], tolerance, source=table["source"], range=ends)

    # Parts ----------------------------------------------------------------------------------------
    def _ask_places(self, joints: Sequence[Joint], links: Sequence[Link]) -> None:
        """Warn of joints whose place is not stated: a wrist would then stand in the elbow."""
        tree, missing, ends = Tree(tuple(joints)), list[str](), [0.0, 0.0, 0.0]
        for joint, parent, row in zip(joints, tree.parents, self.root["joint"]):
            if parent < 0 or "xyz" in row or joint.slides or joints[parent].slides:
                continue
            if not missing:
                ends = [float(f"{2.0 * value_of(x):.4g}") for x in links[parent].centre_of_mass]
            missing.append(joint.name)
        ask(
            missing,
            f"{self.file}: joints stand where the joint before stands: {', '.join(map(repr, missing))}.",
            "expected xyz, m, their place in the frame of the link that carries them, got none: taken as [0, 0, 0]",
            f"xyz = {ends} at the end of that link; xyz = [0.0, 0.0, 0.0] if they do",
        )

    def _elastic(
        self, row: Mapping[str, Any], slides: bool, motor: Mapping[str, float] | None = None, source: str = ""
    ) -> ElasticJoint:
        with located(f"{self.file}: joint {row['name']!r}"):
            own = {**row.get("spring", {}), **row["motor"]}
            for key in [key for key in ("actuator", "gear") if key in row]:
                refuse_if(
                    slides,
                    f"Its {key!r} turns, and the joint slides.",
                    "expected numbers of a spring in N/m and of a motor in kg, got N·m/rad and kg·m²",
                    f"without {key}: its stiffness / r², N/m, with what it moves per radian, r",
                )
                if {"gear_ratio"} <= {*own} & {*row[key].numbers}:
                    published, stated = (x["gear_ratio"]["value"] for x in (row[key].numbers, own))
                    ask(
                        abs(stated - published) > 1.5,  # a ratio N is N + 1 where the flexspline stands still
                        f"{self.file}: joint {row['name']!r} has another gear ratio than its 'gear'.",
                        f"expected {published:g}, got {stated:g}; the curve is that of the 'gear'",
                        f"gear_ratio = {published:g}, or the name of the gear with that ratio",
                    )
                own |= row[key].beside(set(own), row["rigid"])
            refuse_if(
                row["rigid"] == ("spring" in row or bool({"stiffness", CURVE[0]} & set(own))),
                "It is rigid and has a 'spring'."
                if row["rigid"]
                else "It has no 'spring', and is not declared rigid.",
                "expected [joint.spring] with stiffness = … (N·m/rad; N/m for a prismatic joint), or rigid = true",
                "one of the two",
            )
            numbers: dict[str, Any] = {
                key: self._number(value, key, row["name"]) if is_dict(value) else value
                for key, value in own.items()
            }
            for quantity, value in (motor or {}).items():
                if quantity not in numbers and not (
                    quantity == "motor_inertia" and "rotor_inertia" in numbers
                ):
                    numbers[quantity] = Parameter(
                        quantity, value, self._tolerance(row["name"], quantity), source=source
                    )
            joint = ElasticJoint(**numbers)
        if joint.slopes and joint.stiffness is not None:
            ends = [interval_of(number) for number in (*joint.slopes, joint.stiffness)]
            low, high = min(end[0] for end in ends[:-1]), max(end[1] for end in ends[:-1])
            ask(
                ends[-1][1] < low or ends[-1][0] > high,
                f"{self.file}: the stiffness of joint {row['name']!r} is not that of its stiffness curve.",
                f"expected {low:g} to {high:g} {unit_of('stiffness', slides)}, its slopes, got "
                f"{value_of(joint.stiffness):g}; designs reckon with it, and are tested with the curve",
                "the curve alone; or the stiffness alone, of a gear and a spring in series",
            )
        return joint

    def _link(self, row: Mapping[str, Any]) -> Link | SingleLink:
        refuse_if(
            "link" not in row,
            f"{self.file}: the joint {row['name']!r} has no link.",
            "expected [joint.link], or urdf = '…' at the top of the file",
            "mass, centre_of_mass and inertia",
        )
        stated, name = row["link"], row["name"]
        with located(f"{self.file}: joint {name!r}"):
            if "axis_inertia" in stated and not {"inertia", "centre_of_mass"} & set(stated):
                numbers = {k: self._number(value, k, name) for k, value in whole_weight(stated).items()}
                return SingleLink(numbers.pop("axis_inertia"), **numbers)
            whole = ("mass", "centre_of_mass", "inertia")
            missing = [key for key in whole if key not in stated]
            refuse_if(
                missing or len(stated) > len(whole),
                "A link is stated in part, or twice.",
                f"expected {list(whole)}, or axis_inertia with mass and length, got {list(stated)}",
                f"add {missing}" if missing else "one of the two ways",
            )
            six = stated["inertia"]
            moments = [
                Parameter("inertia", six[axes], six.get("tolerance", 0.0), source=six["source"])
                for axes in INERTIA
            ]
            mass = self._number(stated["mass"], "mass", name)
            return Link(mass, self._vector(stated["centre_of_mass"], "centre_of_mass", name), moments)

    # Payload --------------------------------------------------------------------------------------
    def _payload(self, table: Mapping[str, Any]) -> Payload:
        shapes = {kind: table[kind] for kind in ("inertia", *SHAPES) if kind in table}
        refuse_if(
            len(shapes) > 1,
            f"{self.file}: a payload has two shapes.",
            f"expected one of {['inertia', *SHAPES]}, got {list(shapes)}",
            "one of them",
        )
        mass = self._number(table["mass"], "mass")
        place = "centre_of_mass"
        centre = self._vector(table[place], place) if place in table else None
        per_mass: tuple[float, ...] = (0.0,) * 6
        for kind, sizes in shapes.items():
            per_mass = (
                tuple(sizes[axes] / max(mass.interval[1], 1e-30) for axes in INERTIA)
                if kind == "inertia"
                else inertia_of_shape(kind, [sizes] if isinstance(sizes, float) else sizes)
            )
        with located(f"{self.file}: payload"):
            return Payload(mass, table.get("at", ""), centre, per_mass)


def whole_weight(stated: Mapping[str, Any]) -> Mapping[str, Any]:
    """What is stated of a single link; refuses one of which mass or length was forgotten: it would weigh nothing."""
    half = {"mass", "length"} & set(stated)
    if len(half) == 1:
        has = half.pop()
        inertia, other = (abs(stated[key]["value"]) for key in ("axis_inertia", has))
        # of a uniform rod, I = 4/3 m l²
        most = 0.75 * inertia / max(other**2 if has == "length" else other, 1e-30)
        number = min(1.0, most) if has == "length" else min(0.1, most**0.5)
        lacks = "mass" if has == "length" else "length"
        raise InvalidInput(
            f"A link has a {has} and no {lacks}.",
            "expected both, whose product is its weight about the axis, or none for a vertical axis; got "
            f"{list(stated)}",
            f"add {lacks} = {float(f'{number:.3g}')}",
        )
    return stated


def tell_friction(file: str, rows: Sequence[Mapping[str, Any]], arm: RigidArm, source: str) -> None:
    """Warn of frictions that come from <dynamics> of a URDF, a guess in many files: the elastic file states none."""
    taken = [
        (row["name"], key, value)
        for row in rows
        for key, value in arm.motors.get(row["name"], {}).items()
        if key not in row["motor"] and arm.down is None  # a file of MuJoCo states it
    ]
    ask(
        taken,
        f"{file} does not state every friction: {source} does.",
        f"taken from <dynamics>: {', '.join(f'{key} {value:g} of {name}' for name, key, value in taken)}",
        "state it in [joint.motor], which is then taken instead",
    )
