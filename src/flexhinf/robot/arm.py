"""The links of an arm of n joints, with parameters that are arrays: perturbing them compiles nothing.

A single link in closed form, as in Sec. 6: its inertia is stated about the joint's axis.

Payloads: bodies of unknown mass that are fixed to links, and their masses identified from motor torques at rest.

A payload is part of its link's mass, centre of mass and inertia in every plant (`Arm.packed`), so that dynamics,
estimator, MuJoCo and feedforward see it. Its numbers are parameters of the robot: a mass of 0 to 3 kg is one uncertain
number, and the inertia of the payload is in proportion to its mass.

A robot that stands still is held by its motors, and with an integral of the position error it stands where it was
commanded to, whatever its payload. So the input there is u = u0(q) + Σ m_i s_i(q), where u0 holds the robot itself and
s_i is what a kilogram of the payload i adds: the masses follow by least squares. Errors of the links' own masses are
attributed to the payload; two measurements at one pose, before and after the load step, cancel them. Dry friction
holds a part of the weight that the input does not show, and limits the accuracy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from flexhinf.arrays import Elements, Vector
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.robot.dynamics import (
    Joint,
    Placement,
    Tree,
    bodies_of,
    forward_dynamics,
    inverse_dynamics,
    lumped,
    matrix_of,
    six_of,
)
from flexhinf.robot.parameters import INERTIA, VECTOR, Parameter, payload_masses, per_joint, unit_of
from flexhinf.scalars import Symbol
from flexhinf.validation import HUGE, checked_array, real_array, value_text, within_proportion


def is_loaded(load: Any) -> bool:
    """Whether a payload counts: a mass that is not zero, or a symbol, whose value is not known yet."""
    return isinstance(load, Symbol) or bool(load)


class JointTree(ABC):
    """Joints of a robot's links: which of them slide, ranges (rad, m); and the direction of free fall."""

    tree: Tree
    down: Any

    @property
    def slides(self) -> tuple[bool, ...]:
        """Whether each joint is prismatic."""
        return tuple(joint.slides for joint in self.tree.joints)

    @property
    def position_units(self) -> tuple[str, ...]:
        """The unit of each joint's position, rad or m."""
        return tuple("m" if slides else "rad" for slides in self.slides)

    @property
    def limits(self) -> tuple[tuple[float, float] | None, ...]:
        """Range of each joint, rad or m."""
        return tuple(joint.limits for joint in self.tree.joints)

    @abstractmethod
    def packed(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The links' parameters as the plant has them, with their payloads, from the robot's by name."""

    def packed_columns(self, values: Mapping[str, Vector]) -> dict[str, np.ndarray]:
        """`packed` of N robots, (N, …), from columns (N,): one by one where they carry something."""
        load = "payload_mass"
        if any(np.any(column) for name, column in values.items() if name.startswith(load)):
            rows = [
                self.packed(dict(zip(values, numbers)))
                for numbers in np.column_stack(list(values.values())).tolist()
            ]
            return {name: np.array([row[name] for row in rows]) for name in rows[0]}
        bare = {name: column for name, column in values.items() if not name.startswith(load)}
        return {name: np.moveaxis(column, -1, 0) for name, column in self.packed(bare).items()}

    def fall(self, p: Any) -> tuple[Any, ...]:
        """Acceleration of free fall, m/s²: in the world's frame, of a `Pendulum` in that of `rigid`."""
        return tuple(p.gravity * entry if entry else 0.0 for entry in self.down)


@dataclass(frozen=True)
class Pendulum(JointTree):
    """I q̈1 + m g l sin q1 = spring torque + disturbance; q1 = 0 hangs. Its tree is of one joint that turns.

    Parameters of the plant are plain numbers with the names of the paper's Tables 1 and 2.
    """

    tree: Tree = field(default_factory=lambda: Tree((Joint("joint"),)))
    down: ClassVar[Any] = (1.0, 0.0, 0.0)  # of free fall, in the frame of `rigid`

    def required(self) -> tuple[str, ...]:
        """Names of the parameters that the link must have."""
        return ("mass", "length", "gravity", "link_inertia")

    def packed(self, values: Any) -> dict[str, Any]:
        """The link's parameters as the plant has them, with its payload.

        Of a payload only what is in the plane of motion counts: its distance x from the axis along the link, and its
        moment zz.
        """
        own = {name: values[name] for name in self.required()}
        own["link_inertia"] = own["link_inertia"] * values.get("inertia_scale", 1.0)
        if is_loaded(load := values.get("payload_mass", 0.0)):
            arm, about = (
                values.get(f"payload_{name}", 0.0) for name in ("centre_of_mass_x", "inertia_per_mass_zz")
            )
            mass = own["mass"] + load
            own["length"] = (own["mass"] * own["length"] + load * arm) / mass
            own["link_inertia"] += load * (arm * arm + about)
            own["mass"] = mass
        return own

    def accelerations(self, q: Any, dq: Any, torque: Any, p: Any, armature: Any = None) -> Elements:
        """q̈1 = (τ − m g l sin q1) / I."""
        assert armature is None  # a single joint is elastic
        inverse, weight = 1.0 / p.link_inertia, p.mass * p.gravity * p.length / p.link_inertia
        return inverse * torque - weight * np.sin(q)

    def torques(self, q: Any, dq: Any, ddq: Any, p: Any) -> Elements:
        """I q̈1 + m g l sin q1, (1,) of any element."""
        return p.link_inertia * ddq + p.mass * p.gravity * p.length * np.sin(q)

    def gravity_torque(self, q: Any, p: Any) -> Elements:
        """M g l sin q1, (1,), N·m, of any element; of N robots (1, N)."""
        return p.mass * p.gravity * p.length * np.sin(np.asarray(q))

    def rigid(self, p: Any) -> tuple[Tree, np.ndarray, np.ndarray, np.ndarray]:
        """A rigid link that moves alike, about z with x pointing down: tree, mass, centre of mass, inertia.

        Only m l and I count. Half the lever with twice the mass keeps both, and leaves an inertia about the centre
        of mass, I − m l²/2, that is positive even for a point mass.
        """
        mass, length = float(p.mass), float(p.length)
        about = float(p.link_inertia) - 0.5 * mass * length**2
        return (
            self.tree,
            np.array([2.0 * mass or 1.0]),
            np.array([[0.5 * length, 0.0, 0.0]]),
            np.array([[about, 0.0, 0.0, about, 0.0, about]]),
        )


@dataclass(frozen=True)
class Arm(JointTree):
    """A tree of rigid links.

    Parameters of the plant: ``gravity``, ``mass`` (n,), ``centre_of_mass`` (n, 3) in each link's frame, and
    ``inertia`` (n, 6), xx xy xz yy yz zz about the centre of mass in axes parallel to the link's frame.

    The tree is constant; `down` is the direction of free fall in the world's frame, made a unit vector.
    """

    tree: Tree
    down: Sequence[float] = (0.0, 0.0, -1.0)

    def __post_init__(self) -> None:
        vector = real_array(self.down)
        length = float(np.linalg.norm(vector))
        refuse_if(
            vector.shape != (3,) or not 1.0 / HUGE < length < HUGE,
            "The direction of gravity is none.",
            f"expected three numbers, got {value_text(self.down)}",
            "[0, 0, -1]",
        )
        object.__setattr__(self, "down", tuple(float(entry) / length for entry in vector))

    def _names(self, joint: str, quantity: str, components: tuple[str, ...]) -> list[str]:
        return [per_joint(f"{quantity}_{component}", joint, len(self.tree)) for component in components]

    def required(self) -> tuple[str, ...]:
        """Names of the parameters that the links must have."""
        quantities = ("mass", *(f"centre_of_mass_{x}" for x in VECTOR), *(f"inertia_{xx}" for xx in INERTIA))
        of_links = (
            per_joint(name, joint, len(self.tree)) for joint in self.tree.names for name in quantities
        )
        return ("gravity", *of_links)

    def packed(self, values: Mapping[str, float]) -> dict[str, Any]:
        """The links' parameters as the plant has them: each link with its payload."""
        rows, count = self.tree.names, len(self.tree)
        mass = np.array([values[per_joint("mass", row, count)] for row in rows])
        centre, inertia = (
            np.array([[values[name] for name in self._names(row, quantity, components)] for row in rows])
            for quantity, components in (("centre_of_mass", VECTOR), ("inertia", INERTIA))
        )
        for i, row in enumerate(rows):
            inertia[i] = inertia[i] * values.get(per_joint("inertia_scale", row, count), 1.0)
            load = values.get(per_joint("payload_mass", row, count), 0.0)
            if is_loaded(load):
                place, per_mass = (
                    [values.get(name, 0.0) for name in self._names(row, f"payload_{quantity}", components)]
                    for quantity, components in (("centre_of_mass", VECTOR), ("inertia_per_mass", INERTIA))
                )
                mass[i], centre[i], whole = lumped(
                    [
                        (mass[i], centre[i].copy(), matrix_of(inertia[i])),
                        (load, np.array(place), load * matrix_of(per_mass)),
                    ]
                )
                inertia[i] = six_of(whole)
        return {"gravity": values["gravity"], "mass": mass, "centre_of_mass": centre, "inertia": inertia}

    # Dynamics -------------------------------------------------------------------------------------
    def rigid(self, p: Any) -> tuple[Tree, np.ndarray, np.ndarray, np.ndarray]:
        """Tree, mass (n,), centre of mass (n, 3) and inertia (n, 6) of the links, for other tools."""
        return self.tree, p.mass, p.centre_of_mass, p.inertia

    def accelerations(self, q: Any, dq: Any, torque: Any, p: Any, armature: Any = None) -> Elements:
        """q̈1, (n,) of any element; `armature` as for `forward_dynamics`."""
        return np.array(
            forward_dynamics(self.tree, bodies_of(*self.rigid(p)), q, dq, torque, self.fall(p), armature)
        )

    def torques(self, q: Any, dq: Any, ddq: Any, p: Any) -> Elements:
        """M(q) q̈ + C(q, q̇) q̇ + G(q) by the recursive Newton–Euler algorithm, (n,) of any element."""
        return np.array(inverse_dynamics(self.tree, bodies_of(*self.rigid(p)), q, dq, ddq, self.fall(p)))

    def gravity_torque(self, q: Any, p: Any) -> Elements:
        """G(q1), (n,), N·m or N, of any element; of N robots (n, N), where `q` and `p` have them in a last axis."""
        still = [0.0] * len(self.tree)
        parts = inverse_dynamics(self.tree, bodies_of(*self.rigid(p)), q, still, still, self.fall(p))
        return np.array(
            parts if np.ndim(q) < 2 else [np.broadcast_to(part, np.shape(q)[1:]) for part in parts]
        )


#: The links' side of a robot: what it is made of, and how torques move it. Frozen, so that it is a key.
Links = Pendulum | Arm


#: Shapes of uniform bodies and the numbers that state them, m; a cylinder's axis is z.
SHAPES = {
    "sphere": ("radius",),
    "box": ("length in x", "length in y", "length in z"),
    "cylinder": ("radius", "height"),
}


@dataclass(frozen=True)
class Frame:
    """A place that can carry a payload: fixed to the link of a joint, `placement` in that link's frame.

    A payload that states no centre of mass is at `tip`, m, in this frame.
    """

    joint: str
    placement: Placement
    tip: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Payload:
    """A body fixed to a link, in a frame of that link.

    Parameters
    ----------
    mass : Parameter
        kg; its range or tolerance is the uncertainty, and zero an empty hand.
    at : str
        Name of the frame: a joint, standing for the link behind it, or a link of a URDF.
    centre_of_mass : three Parameter, optional
        m; None for the frame's own place for payloads.
    inertia_per_mass : six numbers
        xx, xy, xz, yy, yz, zz about its centre of mass over its mass, m²; zero for a point. Refused if no body has it.
    """

    mass: Parameter
    at: str = ""
    centre_of_mass: tuple[Parameter, ...] | None = None
    inertia_per_mass: tuple[float, ...] = (0.0,) * 6

    def __post_init__(self) -> None:
        lower, upper = self.mass.interval
        refuse_if(
            lower < 0.0 or not within_proportion(upper, positive=True),
            "The mass of a payload is not usable.",
            f"expected 0 kg, or at least 1e-30 kg at the upper end, got {lower:g} to {upper:g} kg",
            "mass = { value = 0.0, range = [0.0, 3.0] }",
        )
        moments = np.linalg.eigvalsh(matrix_of(self.inertia_per_mass))
        slack = 1e-9 * abs(moments[2])
        refuse_if(
            moments[0] < -slack or moments[2] > moments[0] + moments[1] + slack,
            "The inertia of a payload is that of no rigid body.",
            "expected principal moments >= 0 of which none exceeds the sum of the others, got "
            f"{[float(f'{moment * upper:.6g}') for moment in moments]} kg·m²",
            "inertia = {xx, yy, zz, xy, xz, yz} about the payload's centre of mass, or a shape",
        )

    def parameters(self, frame: Frame, joints: int) -> list[Parameter]:
        """The robot's parameters for this payload, in the frame of the link that carries it."""
        turn, centre = np.array(frame.placement.rotation), self.centre_of_mass
        if centre is None:
            centre = [
                Parameter("", x, source="assumption: where the link is drawn to end") for x in frame.tip
            ]
        place = np.array(frame.placement.translation) + turn @ [entry.value for entry in centre]
        numbers = {"mass": self.mass}
        for axis, value in zip(VECTOR, place):
            numbers[f"centre_of_mass_{axis}"] = Parameter(
                "", float(value), max(entry.tolerance for entry in centre), source=centre[0].source
            )
        for axes, value in zip(INERTIA, six_of(turn @ matrix_of(self.inertia_per_mass) @ turn.T)):
            if value:
                numbers[f"inertia_per_mass_{axes}"] = Parameter("", value, source=self.mass.source)
        return [
            replace(
                number,
                name=per_joint(f"payload_{quantity}", frame.joint, joints),
                unit=unit_of(f"payload_{quantity}"),
            )
            for quantity, number in numbers.items()
        ]


def inertia_of_shape(kind: str, sizes: Sequence[float]) -> tuple[float, ...]:
    """Moments of a uniform body over its mass, m²: xx, xy, xz, yy, yz, zz about its centre; sizes as in `SHAPES`."""
    names = SHAPES[kind]
    refuse_if(
        len(sizes) != len(names) or not all(0.0 < size < np.inf for size in sizes),
        f"The {kind} of a payload has no size.",
        f"expected {' and '.join(names)} in m, all > 0, got {value_text(list(sizes))}",
        f"{kind} = {0.05 if len(names) == 1 else [0.05] * len(names)}",
    )
    x = y = z = 0.4 * sizes[0] ** 2
    if kind == "box":
        a, b, c = (size**2 / 12.0 for size in sizes)
        x, y, z = b + c, a + c, a + b
    elif kind == "cylinder":
        x = y = sizes[0] ** 2 / 4.0 + sizes[1] ** 2 / 12.0
        z = sizes[0] ** 2 / 2.0
    return (x, 0.0, 0.0, y, 0.0, z)


def payload_from_text(text: str) -> Payload:
    """The payload of a command line: ``3kg@hand``, ``0..3kg@hand``, ``0..1..3@hand:0,0,0.1``.

    One number is a known mass. Two are its range, with the lower end as the nominal mass; three are lower end,
    nominal mass and upper end. Behind ``@`` stands what carries it, behind ``:`` its centre of mass there (m).
    """
    head, colon, place = text.partition(":")
    amount, at, link = (part.strip() for part in head.partition("@"))
    try:
        # A number without the underscores that Python allows.
        numbers = [float(word.replace("_", "x")) for word in amount.removesuffix("kg").split("..")]
        centre = [float(word.replace("_", "x")) for word in place.split(",")] if colon else None
        whole = len(numbers) <= 3 and (centre is None or len(centre) == 3) and (link or not at)
        if not whole or not all(np.isfinite([*numbers, *(centre or ())])):
            raise ValueError
    except ValueError:
        raise InvalidInput(
            "The payload cannot be read.",
            f"expected MASS, LOWER..UPPER or LOWER..NOMINAL..UPPER in kg, then @LINK and :x,y,z (m), got "
            f"{value_text(text, 60)}",
            "0..3kg@hand, or 0..3kg@hand:0,0,0.1",
        ) from None
    source, ends = "option --payload", (numbers[0], numbers[-1]) if len(numbers) > 1 else None
    offset = None if centre is None else tuple(Parameter("centre", x, source=source) for x in centre)
    mass = Parameter("mass", numbers[max(len(numbers) - 2, 0)], range=ends, source=source)
    return Payload(mass, link, offset)


def payload_ends(uncertain: Sequence[Parameter]) -> list[dict[str, float]]:
    """Masses (kg) by name of a robot's uncertain payloads at the lower, and at the upper ends of their ranges.

    Ends that are the nominal masses are left out.
    """
    masses = payload_masses(uncertain)
    ends = ({p.name: p.interval[end] for p in masses} for end in (0, 1))
    return [values for values in ends if values != {p.name: p.value for p in masses}]


#: A payload whose lever arm is shorter than this, m, loads no motor: its weight is lost in rounding.
SHORTEST_LEVER = 1e-6


@dataclass(frozen=True)
class Weighing:
    """Payload masses, kg, identified from motor torques at rest, by parameter name as for ``robot.with_values``.

    `hidden` are their largest errors by dry friction, kg: all of it at every joint, in the worst directions.
    `unexplained` (n,) is the torque of each motor that these masses do not explain, N·m (N).
    """

    masses: dict[str, float]
    hidden: dict[str, float]
    unexplained: np.ndarray


def weigh_payload(robot: Any, pose: Any, effort: Any, unloaded: Any = None) -> Weighing:
    """The masses of the robot's payloads, whose places are known, from what its motors give at rest.

    Parameters
    ----------
    pose : (n,)
        Link positions at rest, rad or m.
    effort : (n,)
        Input of each motor there, V, A, or N·m (N): a mean over the noise.
    unloaded : (n,), optional
        Input at this pose with the masses that the robot states (its nominal ones); by default what the model says.

    Raises InvalidInput: for a robot without a payload, numbers that do not fit the joints, or a pose at which the
    weight of a payload cannot be told from that of another, or does not load any motor.
    """
    names = [p.name for p in payload_masses(robot.parameters)]
    refuse_if(
        not names,
        f"The robot {robot.name!r} has no payload to weigh.",
        "expected [[payload]] in its file, got none",
        "load_robot(..., payload='0..3kg@LINK')",
    )
    _, model = robot.operating_point(pose)
    measured, base = (
        checked_array(
            f"The {name} does not fit the joints of the robot {robot.name!r}.",
            values,
            (len(model),),
            f"{len(model)} finite numbers ({robot.drive_kind.quantity})",
            "one mean of each motor's input at rest",
        )
        for name, values in (("effort", effort), ("unloaded", model if unloaded is None else unloaded))
    )
    p = robot.plant_parameters()
    per_input = np.broadcast_to(
        np.asarray(robot.drive_kind.torque_per_input(SimpleNamespace(**p)), dtype=float),
        len(robot.joint_names),
    )
    extra = per_input * (measured - base)
    heavier = [robot.plant_parameters({**robot.nominal, name: robot[name].value + 1.0}) for name in names]
    per_kilogram = np.array([per_input * (robot.operating_point(pose, (), p)[1] - model) for p in heavier]).T
    refuse_if(
        np.linalg.matrix_rank(per_kilogram, tol=SHORTEST_LEVER * abs(robot["gravity"].value)) < len(names),
        "The motors do not show the mass of every payload at this pose.",
        f"expected a pose at which each of {names} loads a motor in its own way, got {value_text(pose)}",
        "a pose with a lever arm across gravity",
    )
    inverse = np.linalg.pinv(per_kilogram)
    dry = np.maximum(
        *(np.broadcast_to(p.get(kind, 0.0), len(base)) for kind in ("coulomb_friction", "static_friction"))
    )
    hidden = np.abs(inverse) @ dry * (1.0 if unloaded is None else 2.0)
    added = inverse @ extra
    return Weighing(
        {name: float(robot[name].value + more) for name, more in zip(names, added)},
        dict(zip(names, hidden.tolist())),
        extra - per_kilogram @ added,
    )
