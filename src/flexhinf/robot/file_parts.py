"""From the tables of a robot file to parts: numbers with their tolerances, links, joints and payloads.

From parts to a robot: every number becomes a parameter with its joint's name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty
from flexhinf.robot.arm import Arm, Pendulum
from flexhinf.robot.dynamics import Joint, Placement, Tree
from flexhinf.robot.parameters import INERTIA, VECTOR, Parameter, per_joint, unit_of
from flexhinf.robot.parts import ElasticJoint, Link, Number, SingleLink
from flexhinf.robot.payload import SHAPES, Frame, Payload, inertia_of_shape, payload_from_text
from flexhinf.robot.robot import Robot
from flexhinf.robot.schema import (
    JointTable,
    LinkTable,
    NumberTable,
    PayloadTable,
    RobotTable,
    VectorTable,
    check_tolerance,
)
from flexhinf.validation import distinct, value_text

#: Numbers whose tolerance in a table [tolerances] has another name.
KEYS = {"rotor_inertia": "motor_inertia", "axis_inertia": "inertia", "length": "centre_of_mass"}

Made = TypeVar("Made")


class PartsReader:
    """Makes parts of one file; a number takes its tolerance from itself, its joint or the whole file, in this order.

    Parameters
    ----------
    file : str
        Name of the file, for messages.
    """

    def __init__(self, table: RobotTable, file: str) -> None:
        self.file, self._table = file, table
        self._all = _stated(table.tolerances)
        self._own = {row.name: _stated(row.tolerances) for row in table.joint}
        self._used: set[tuple[str | None, str]] = set()
        for where, stated in ((None, self._all), *self._own.items()):
            for key, value in stated.items():
                check_tolerance(file, f"{key} in {_table_name(where)}", value)

    # Tolerances -----------------------------------------------------------------------------------
    def tolerance(self, joint: str, quantity: str) -> float:
        """What the tables [tolerances] say of a number that states none itself, per cent."""
        key = KEYS.get(quantity, quantity)
        self._used |= {(None, key), (joint, key)}
        return self._own.get(joint, {}).get(key, self._all.get(key, 0.0))

    def check_tolerances(self) -> None:
        """Refuse tolerances of numbers that no joint has.

        Raises
        ------
        InvalidInput
            With the table and the key.
        """
        moving = {joint for joint, _ in self._used}
        for joint, stated in ((None, self._all), *self._own.items()):
            for key in stated if joint in moving else ():
                if (joint, key) not in self._used:
                    raise InvalidInput(
                        f"{self.file}: {_table_name(joint)} has {key!r}, which "
                        + ("no joint states." if joint is None else f"the joint {joint!r} does not state."),
                        f"expected keys out of {sorted(k for one, k in self._used if one == joint)}, got {key!r}",
                        f"state {key!r} with its value first, or leave out its tolerance",
                    )

    # Numbers --------------------------------------------------------------------------------------
    def number(self, table: NumberTable, quantity: str, joint: str | None = None) -> Parameter:
        """One number with tolerance, or range, and source."""
        where = quantity if joint is None else f"{joint}, {quantity}"
        check_tolerance(self.file, where, table.tolerance or 0.0)
        tolerance = table.tolerance
        if tolerance is None:
            ranged = table.range is not None or joint is None
            tolerance = 0.0 if ranged else self.tolerance(joint or "", quantity)
        ends: Any = None if table.range is None else tuple(table.range)
        return Parameter(quantity, table.value, tolerance, source=table.source, range=ends)

    def vector(self, table: VectorTable, quantity: str, joint: str | None = None) -> tuple[Parameter, ...]:
        """Three numbers that share tolerance and source."""
        one = NumberTable(value=0.0, tolerance=table.tolerance, source=table.source)
        shared = self.number(one, quantity, joint)
        return tuple(Parameter(quantity, x, shared.tolerance, source=table.source) for x in table.value)

    # Parts ----------------------------------------------------------------------------------------
    def elastic(
        self, row: JointTable, motor: Mapping[str, float] | None = None, source: str = ""
    ) -> ElasticJoint:
        """Spring and motor of a joint, over what another file (`source`) says of the motor."""

        def made() -> ElasticJoint:
            if row.rigid == (row.spring is not None):
                raise InvalidInput(
                    "It is rigid and has a 'spring'."
                    if row.rigid
                    else "It has no 'spring', and is not declared rigid.",
                    "expected [joint.spring] with stiffness = … (N·m/rad; N/m for a prismatic joint), or rigid = true",
                    "one of the two",
                )
            stated = {**dict(row.spring or {}), **dict(row.motor)}
            numbers = {k: self.number(v, k, row.name) for k, v in stated.items() if v is not None}
            for quantity, value in (motor or {}).items():
                inertia = quantity == "motor_inertia" and "rotor_inertia" in numbers
                if quantity not in numbers and not inertia:
                    numbers[quantity] = Parameter(
                        quantity, value, self.tolerance(row.name, quantity), source=source
                    )
            return ElasticJoint(**numbers)

        return self._blamed(row.name, made)

    def link(self, row: JointTable) -> Link | SingleLink:
        """The link of a joint, stated in this file."""
        if row.link is None:
            raise InvalidInput(
                f"{self.file}: the joint {row.name!r} has no link.",
                "expected [joint.link], or urdf = '…' at the top of the file",
                "mass, centre_of_mass and inertia",
            )
        table = row.link
        return self._blamed(row.name, lambda: self._link(table, row.name))

    def _link(self, table: LinkTable, joint: str) -> Link | SingleLink:
        whole = {"mass": table.mass, "centre_of_mass": table.centre_of_mass, "inertia": table.inertia}
        single = {"axis_inertia": table.axis_inertia, "length": table.length}
        if table.axis_inertia is not None and table.inertia is None and table.centre_of_mass is None:
            stated = {"axis_inertia": table.axis_inertia, "mass": table.mass, "length": table.length}
            numbers = {k: self.number(v, k, joint) for k, v in stated.items() if v is not None}
            return SingleLink(numbers.pop("axis_inertia"), **numbers)
        missing = [name for name, value in whole.items() if value is None]
        if missing or any(value is not None for value in single.values()):
            raise InvalidInput(
                "A link is stated in part, or twice.",
                f"expected {list(whole)}, or axis_inertia with mass and length, got "
                f"{[name for name, value in {**whole, **single}.items() if value is not None]}",
                f"add {missing}" if missing else "one of the two ways",
            )
        assert table.mass is not None
        assert table.inertia is not None
        assert table.centre_of_mass is not None
        six = table.inertia
        check_tolerance(self.file, f"{joint}, link, inertia", six.tolerance or 0.0)
        return Link(
            self.number(table.mass, "mass", joint),
            self.vector(table.centre_of_mass, "centre_of_mass", joint),
            [
                Parameter("inertia", getattr(six, axes), six.tolerance or 0.0, source=six.source)
                for axes in INERTIA
            ],
        )

    def tolerated(self, link: Link, joint: str, source: str) -> Link:
        """A link of another file, with the tolerances that this one states."""

        def with_tolerance(value: Any, quantity: str) -> Parameter:
            return Parameter(quantity, float(value), self.tolerance(joint, quantity), source=source)

        return Link(
            with_tolerance(link.mass, "mass"),
            [with_tolerance(x, "centre_of_mass") for x in link.centre_of_mass],
            [Parameter("inertia", float(x), source=source) for x in link.inertia],  # type: ignore[arg-type]
        )

    def inertia_scales(self, joints: Sequence[str]) -> list[Parameter]:
        """A factor of all moments of a link, of those whose inertia has a tolerance in a table [tolerances]."""
        links = {row.name: row.link for row in self._table.joint}
        found = []
        for joint in joints:
            link = links.get(joint)
            stated = link is not None and link.inertia is not None and link.inertia.tolerance is not None
            if stated or (link is not None and link.axis_inertia is not None):
                continue
            if tolerance := self.tolerance(joint, "inertia"):
                name = per_joint("inertia_scale", joint, len(joints))
                found.append(
                    Parameter(name, 1.0, tolerance, unit_of("inertia_scale"), "tolerance of its inertia")
                )
        return found

    # Payload --------------------------------------------------------------------------------------
    def loaded(self, robot: Robot, frames: Mapping[str, Frame], tips: Sequence[str], given: Any) -> Robot:
        """The robot with its payloads.

        Parameters
        ----------
        frames : mapping of str to Frame
            What can carry a payload.
        tips : sequence of str
            Those at the ends: the only one is meant where a payload does not say what carries it.
        given : str, Payload, sequence of these, or None
            Instead of the file's.

        Raises
        ------
        InvalidInput
            For a place that there is not, or two payloads of one link.
        """
        payloads = [self._payload(row) for row in self._table.payload] if given is None else _payloads(given)
        where = [self._frame(payload, frames, tips) for payload in payloads]
        distinct(f"{self.file}: a payload of the link of joint", [frame.joint for frame in where])
        if isinstance(robot.links, Pendulum):
            self._check_plane(payloads)
        count = len(robot.joint_names)
        added = [
            number for payload, frame in zip(payloads, where) for number in payload.parameters(frame, count)
        ]
        return robot.with_parameters(*self.inertia_scales(robot.joint_names), *added)

    def _payload(self, table: PayloadTable) -> Payload:
        shapes = {
            kind: getattr(table, kind) for kind in ("inertia", *SHAPES) if getattr(table, kind) is not None
        }
        if len(shapes) > 1:
            raise InvalidInput(
                f"{self.file}: a payload has two shapes.",
                f"expected one of {['inertia', *SHAPES]}, got {list(shapes)}",
                "one of them",
            )
        mass = self.number(table.mass, "mass")
        centre = None if table.centre_of_mass is None else self.vector(table.centre_of_mass, "centre_of_mass")
        per_mass: tuple[float, ...] = (0.0,) * 6
        if table.inertia is not None:
            largest = max(mass.interval[1], 1e-30)
            per_mass = tuple(getattr(table.inertia, axes) / largest for axes in INERTIA)
        elif shapes:
            ((kind, sizes),) = shapes.items()
            per_mass = inertia_of_shape(kind, [sizes] if isinstance(sizes, float) else sizes)
        return self._blamed("payload", lambda: Payload(mass, table.at or "", centre, per_mass))

    def _check_plane(self, payloads: Sequence[Payload]) -> None:
        """A link that states no frame of its own carries on the line from its axis to its centre of mass."""
        for payload in payloads:
            beside = [] if payload.centre_of_mass is None else [x.value for x in payload.centre_of_mass[1:]]
            if any(beside):
                raise InvalidInput(
                    f"{self.file}: the payload is beside a link that states axis_inertia and length only.",
                    f"expected its centre of mass at [x, 0, 0], x along the link, got y, z = {beside}",
                    "mass, centre_of_mass and inertia of the link instead of axis_inertia",
                )

    def _frame(self, payload: Payload, frames: Mapping[str, Frame], tips: Sequence[str]) -> Frame:
        if not payload.at and len({frames[tip].joint for tip in tips}) == 1 and len(tips) == 1:
            return frames[tips[0]]
        if payload.at not in frames:
            raise InvalidInput(
                f"{self.file}: the payload is at {value_text(payload.at, 60)}, which carries nothing."
                if payload.at
                else f"{self.file}: the payload does not say what carries it, and there are several ends.",
                f"expected one of {list(frames)}",
                f"at = {tips[0]!r}, or --payload 0..3kg@{tips[0]}",
            )
        return frames[payload.at]

    def _blamed(self, joint: str, make: Callable[[], Made]) -> Made:
        """What `make` makes; its error says which joint of which file is meant."""
        try:
            return make()
        except InvalidInput as error:
            where = joint if joint == "payload" else f"joint {joint!r}"
            raise InvalidInput(f"{self.file}: {where}: {error.what}", error.found, error.advice) from error


def own_frames(joints: Sequence[Joint], links: Sequence[Any]) -> tuple[dict[str, Frame], list[str]]:
    """Frames of a robot file's own links by joint, and those at the ends.

    A file states no shapes: a payload without a place of its own is where the link is drawn to end, at twice the
    distance of the centre of mass.
    """
    frames = {}
    for joint, link in zip(joints, links):
        if isinstance(link, SingleLink):
            centre: Any = (link.length, 0.0, 0.0)
        else:
            centre = link.centre_of_mass
        numbers = [2.0 * (x.value if isinstance(x, Parameter) else float(x)) for x in centre]
        frames[joint.name] = Frame(joint.name, Placement(), tip=(numbers[0], numbers[1], numbers[2]))
    carriers = set(Tree(tuple(joints)).parents)
    return frames, [joint.name for i, joint in enumerate(joints) if i not in carriers]


def _payloads(given: Any) -> list[Payload]:
    rows = given if isinstance(given, (list, tuple)) else [given]
    if not all(isinstance(row, (str, Payload)) for row in rows):
        raise InvalidInput(
            "The payload is none.",
            f"expected text, a Payload or several, got {value_text(given)}",
            "payload='0..3kg@hand'",
        )
    return [row if isinstance(row, Payload) else payload_from_text(row) for row in rows]


def _stated(table: Any) -> dict[str, float]:
    return {key: value for key, value in table if value is not None}


def _table_name(joint: str | None) -> str:
    return "[tolerances]" if joint is None else f"[joint.tolerances] of {joint!r}"


def assembled(
    name: str,
    joints: Sequence[Joint],
    links: Sequence[Link],
    elastic: Sequence[ElasticJoint],
    *,
    gravity: Number = 9.81,
    down: Sequence[float] = (0.0, 0.0, -1.0),
    penalty: Penalty | None = None,
    home: Sequence[float] | None = None,
    description: str = "",
    effort_limits: Sequence[float | None] | None = None,
    speed_limits: Sequence[float | None] | None = None,
) -> Robot:
    """A robot of one link and one elastic joint per joint.

    Parameters
    ----------
    joints, links, elastic : sequence
        One each, in the same order.
    gravity : number
        m/s².
    down : (3,)
        Direction of free fall in the world's frame.
    penalty, home, description, effort_limits, speed_limits
        As for `Robot`.

    Raises
    ------
    InvalidInput
        If the numbers of parts differ, some joints are driven by voltage, others by current or torque, or the parts do
        not make a robot.
    """
    if not len(joints) == len(links) == len(elastic):
        raise InvalidInput(
            f"The parts of the robot {name!r} do not fit each other.",
            f"expected one link and one elastic joint per joint, got {len(joints)} joints, {len(links)} links and "
            f"{len(elastic)} elastic joints",
            "one of each",
        )
    tree = Tree(tuple(joints))
    parameters = [_parameter("gravity", gravity, "gravity")]
    for joint, link, spring in zip(joints, links, elastic):
        numbers: dict[str, Any] = {"mass": link.mass}
        numbers |= {f"centre_of_mass_{axis}": value for axis, value in zip(VECTOR, link.centre_of_mass)}
        numbers |= {f"inertia_{axes}": value for axes, value in zip(INERTIA, link.inertia)}
        numbers |= spring.stated
        for quantity, number in numbers.items():
            label = per_joint(quantity, joint.name, len(joints))
            parameters.append(_parameter(label, number, quantity, joint.slides))
    direction: Any = tuple(down)
    drive = _common_drive(name, [joint.name for joint in joints], elastic)
    rigid = tuple(joint.name for joint, spring in zip(joints, elastic) if spring.rigid)
    limits = effort_limits, speed_limits
    return Robot(
        name, tuple(parameters), penalty, Arm(tree, direction), drive, home, description, *limits, rigid
    )


def single_link_robot(
    name: str,
    joint: Joint,
    link: SingleLink,
    elastic: ElasticJoint,
    *,
    gravity: Number = 9.81,
    penalty: Penalty | None = None,
    home: Sequence[float] | None = None,
    description: str = "",
    effort_limits: Sequence[float | None] | None = None,
    speed_limits: Sequence[float | None] | None = None,
) -> Robot:
    """A robot of a single link about a horizontal axis, in closed form; position zero hangs.

    Raises
    ------
    InvalidInput
        For a prismatic joint, or parts that do not make a robot.
    """
    if joint.slides:
        raise InvalidInput(
            f"The joint {joint.name!r} slides, so its link has no inertia about an axis.",
            "expected a revolute joint, got a prismatic one",
            "mass, centre_of_mass and inertia of the link",
        )
    if elastic.rigid:
        raise InvalidInput(
            f"The only joint of the robot {name!r} is rigid.",
            "expected an elastic joint, got none",
            "[joint.spring] with stiffness = … (N·m/rad)",
        )
    numbers = {"mass": link.mass, "length": link.length, "gravity": gravity, "link_inertia": link.inertia}
    numbers |= elastic.stated
    parameters = tuple(_parameter(quantity, number, quantity) for quantity, number in numbers.items())
    links = Pendulum(joint.name, joint.limits)
    limits = effort_limits, speed_limits
    return Robot(name, parameters, penalty, links, elastic.drive, home, description, *limits)


def _common_drive(robot: str, joints: Sequence[str], elastic: Sequence[ElasticJoint]) -> str:
    drives = {joint: spring.drive for joint, spring in zip(joints, elastic)}
    if len(set(drives.values())) > 1:
        found = " and by ".join(f"{drive}s" for drive in sorted(set(drives.values())))
        raise InvalidInput(
            f"The robot {robot!r} is driven by {found}.",
            f"expected the same motor constants for all joints, got {drives}",
            "resistance, torque_constant and back_emf_constant of every motor (voltages), torque_constant alone "
            "(currents), or none (torques)",
        )
    return next(iter(drives.values()))


def _parameter(label: str, number: Number, quantity: str, slides: bool = False) -> Parameter:
    unit = unit_of(quantity, slides)
    if isinstance(number, Parameter):
        return replace(number, name=label, unit=number.unit or unit)
    return Parameter(label, float(number), unit=unit)
