"""What a robot carries: a body of unknown mass that is fixed to one of its links; and its mass, weighed by the motors.

A payload is part of its link's mass, centre of mass and inertia in every plant (`Arm.packed`), so that dynamics,
estimator, MuJoCo and feedforward see it. Its numbers are parameters of the robot: a mass of 0 to 3 kg is one uncertain
number, and the inertia of the payload is in proportion to its mass.

A robot that stands still is held by its motors, and with an integral of the position error it stands where it was
commanded to, whatever it carries. So what the motors give there is u = u0(q) + Σ m_i s_i(q), where u0 holds the robot
itself and s_i is what a kilogram of the payload i adds: the masses follow by least squares. What the links' own masses
are uncertain by falls on the payload; two weighings at one pose, before and after it is gripped, cancel that. Dry
friction holds a part of the weight that the motors do not show, and bounds what can be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.robot.dynamics import Placement, matrix_of, six_of
from flexhinf.robot.elastic import DRIVES, torque_per_input
from flexhinf.robot.parameters import INERTIA, VECTOR, Parameter, per_joint, unit_of
from flexhinf.validation import checked_array, value_text, within_proportion

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
        kg; its range or tolerance is the uncertainty.
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
        if lower < 0.0 or not upper > 0.0 or not within_proportion(upper, positive=True):
            raise InvalidInput(
                "The mass of a payload is not usable.",
                f"expected 0 kg or more, and at least 1e-30 kg at the upper end, got {lower:g} to {upper:g} kg",
                "mass = { value = 0.0, range = [0.0, 3.0] }",
            )
        moments = np.linalg.eigvalsh(matrix_of(self.inertia_per_mass))
        slack = 1e-9 * abs(moments[2])
        if moments[0] < -slack or moments[2] > moments[0] + moments[1] + slack:
            raise InvalidInput(
                "The inertia of a payload is that of no rigid body.",
                "expected principal moments >= 0 of which none exceeds the sum of the others, got "
                f"{[float(f'{moment * upper:.6g}') for moment in moments]} kg·m²",
                "inertia = {xx, yy, zz, xy, xz, yz} about the payload's centre of mass, or a shape",
            )

    def parameters(self, frame: Frame, joints: int) -> list[Parameter]:
        """The robot's parameters for it, in the frame of the link that carries it."""
        turn, centre = np.array(frame.placement.rotation), self.centre_of_mass
        if centre is None:
            centre = [
                Parameter("", x, source="assumption: where the link is drawn to end") for x in frame.tip
            ]
        place = np.array(frame.placement.translation) + turn @ [one.value for one in centre]
        six = six_of(turn @ matrix_of(self.inertia_per_mass) @ turn.T)
        numbers = {"mass": self.mass}
        for axis, value in zip(VECTOR, place):
            tolerance = max(one.tolerance for one in centre)
            numbers[f"centre_of_mass_{axis}"] = Parameter(
                "", float(value), tolerance, source=centre[0].source
            )
        for axes, value in zip(INERTIA, six):
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
    if len(sizes) != len(names) or not all(0.0 < size < np.inf for size in sizes):
        raise InvalidInput(
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
    words, at, link = (part.strip() for part in head.partition("@"))
    try:
        # A number without the underscores that Python allows.
        numbers = [float(word.replace("_", "x")) for word in words.removesuffix("kg").split("..")]
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
    mass = Parameter("mass", numbers[max(len(numbers) - 2, 0)], range=ends, source=source)
    offset = None if centre is None else tuple(Parameter("centre", x, source=source) for x in centre)
    return Payload(mass, link, offset)


def payload_ends(uncertain: Sequence[Parameter]) -> list[dict[str, float]]:
    """Masses (kg) by name of a robot's uncertain payloads at the lower, and at the upper ends of their ranges.

    Where those are the nominal ones they are left out.
    """
    masses = [p for p in uncertain if p.name.startswith("payload_mass")]
    ends = ({p.name: p.interval[end] for p in masses} for end in (0, 1))
    return [found for found in ends if found != {p.name: p.value for p in masses}]


#: A payload whose lever arm is shorter than this, m, loads no motor: its weight is lost in rounding.
SHORTEST_LEVER = 1e-6


@dataclass(frozen=True)
class Weighing:
    """What the motors say of payloads: masses, kg, by the robot's parameters, as for ``robot.with_values``.

    `hidden` are kg that dry friction may hide, at most: with every joint held by all of it, in the worst directions.
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
        What each motor gives there, V, A, or N·m (N): a mean over the noise.
    unloaded : (n,), optional
        The same at this pose with the masses that the robot states (its nominal ones); by default what the model says.

    Raises
    ------
    InvalidInput
        For a robot without a payload, numbers that do not fit the joints, or a pose at which the weight of a payload
        cannot be told from that of another, or does not load any motor.
    """
    names = [p.name for p in robot.parameters if p.name.startswith("payload_mass")]
    if not names:
        raise InvalidInput(
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
            f"{len(model)} finite numbers ({DRIVES[robot.drive]})",
            "one mean of each motor's input at rest",
        )
        for name, values in (("effort", effort), ("unloaded", model if unloaded is None else unloaded))
    )
    p = robot.plant_parameters()
    each = torque_per_input(robot.drive, SimpleNamespace(**p))
    per_input = np.broadcast_to(np.asarray(each, dtype=float), len(robot.joint_names))
    extra = per_input * (measured - base)
    heavier = [robot.plant_parameters({**robot.nominal, name: robot[name].value + 1.0}) for name in names]
    per_kilogram = np.array([per_input * (robot.operating_point(pose, (), p)[1] - model) for p in heavier]).T
    if np.linalg.matrix_rank(per_kilogram, tol=SHORTEST_LEVER * abs(robot["gravity"].value)) < len(names):
        raise InvalidInput(
            "The motors do not show the mass of every payload at this pose.",
            f"expected a pose at which each of {names} loads a motor in its own way, got {value_text(pose)}",
            "a pose with a lever arm across gravity",
        )
    inverse = np.linalg.pinv(per_kilogram)
    friction = (p.get(kind, 0.0) for kind in ("coulomb_friction", "static_friction"))
    dry = np.max([np.broadcast_to(force, len(base)) for force in friction], axis=0)
    hidden = np.abs(inverse) @ dry * (1.0 if unloaded is None else 2.0)
    added = inverse @ extra
    return Weighing(
        {name: float(robot[name].value + more) for name, more in zip(names, added)},
        dict(zip(names, hidden.tolist())),
        extra - per_kilogram @ added,
    )
