"""What a robot file may say, key by key."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

Two = Annotated[list[float], Field(min_length=2, max_length=2)]
Three = Annotated[list[float], Field(min_length=3, max_length=3)]
Percent = Annotated[float, Field(ge=0.0, lt=100.0)]


class _Table(BaseModel):
    """A table whose unknown keys are mistakes, and whose numbers are numbers (not text)."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class NumberTable(_Table):
    """``4.0`` or ``{value = 4.0, tolerance = 12, source = "data sheet"}``; the tolerance is in per cent.

    A range is stated instead of a tolerance where the interval is not symmetric: ``{value = 0.0, range = [0.0, 3.0]}``.
    """

    value: float
    tolerance: Percent | None = None
    range: Two | None = None
    source: str = "assumption"


class VectorTable(_Table):
    """``[x, y, z]`` or ``{value = [x, y, z], tolerance = 3, source = "CAD"}``."""

    value: Three
    tolerance: Percent | None = None
    source: str = "assumption"


def _spelled_out(value: Any) -> Any:
    return value if isinstance(value, (dict, BaseModel)) else {"value": value}


Number = Annotated[NumberTable, BeforeValidator(_spelled_out)]
Vector = Annotated[VectorTable, BeforeValidator(_spelled_out)]


class InertiaTable(_Table):
    """Moments about the centre of mass, kg·m²: ``{xx = 1e-3, yy = 1e-3, zz = 5e-4}``; products are zero if left out."""

    xx: float
    yy: float
    zz: float
    xy: float = 0.0
    xz: float = 0.0
    yz: float = 0.0
    tolerance: Percent | None = None
    source: str = "assumption"


class LinkTable(_Table):
    """mass, centre_of_mass, inertia; or, for a single link, axis_inertia with mass and length."""

    mass: Number | None = None
    centre_of_mass: Vector | None = None
    inertia: InertiaTable | None = None
    axis_inertia: Number | None = None
    length: Number | None = None


class SpringTable(_Table):
    """The joint's elasticity, seen from the link."""

    stiffness: Number
    damping: Number | None = None
    spring_hardening: Number | None = None
    backlash: Number | None = None


class MotorTable(_Table):
    """The motor, its gear and its friction; its constants say what its input is."""

    motor_inertia: Number | None = None
    rotor_inertia: Number | None = None
    hub_inertia: Number | None = None
    gear_ratio: Number | None = None
    gear_efficiency: Number | None = None
    motor_efficiency: Number | None = None
    friction: Number | None = None
    coulomb_friction: Number | None = None
    static_friction: Number | None = None
    stribeck_velocity: Number | None = None
    friction_smoothing: Number | None = None
    resistance: Number | None = None
    inductance: Number | None = None
    torque_constant: Number | None = None
    back_emf_constant: Number | None = None


class TolerancesTable(_Table):
    """Tolerances in per cent of numbers that state none themselves: of one joint and its link, or of all.

    That of the inertia is one number for all moments of a link, so that what is drawn is the inertia of a body; that of
    the motor inertia holds for a rotor inertia too.
    """

    mass: Percent | None = None
    centre_of_mass: Percent | None = None
    inertia: Percent | None = None
    stiffness: Percent | None = None
    damping: Percent | None = None
    spring_hardening: Percent | None = None
    backlash: Percent | None = None
    motor_inertia: Percent | None = None
    gear_efficiency: Percent | None = None
    motor_efficiency: Percent | None = None
    friction: Percent | None = None
    coulomb_friction: Percent | None = None
    static_friction: Percent | None = None
    stribeck_velocity: Percent | None = None
    resistance: Percent | None = None
    inductance: Percent | None = None
    torque_constant: Percent | None = None
    back_emf_constant: Percent | None = None


class JointTable(_Table):
    """One joint with its link, spring, motor and limits. With a URDF only name, limits, spring, motor, tolerances."""

    name: str
    kind: Literal["revolute", "continuous", "prismatic"] | None = None
    axis: Three | None = None
    xyz: Three | None = None
    rpy: Three | None = None
    limits: Two | None = None
    speed_limit: Annotated[float, Field(gt=0.0)] | None = None
    effort_limit: Annotated[float, Field(gt=0.0)] | None = None
    parent: str | None = None
    link: LinkTable | None = None
    rigid: bool = False
    spring: SpringTable | None = None
    motor: MotorTable
    tolerances: TolerancesTable = Field(default_factory=TolerancesTable)


class PayloadTable(_Table):
    """What a link carries: mass, where, and its inertia (of its largest mass) or a shape; a point without both."""

    at: str | None = None
    mass: Number
    centre_of_mass: Vector | None = None
    inertia: InertiaTable | None = None
    sphere: float | None = None
    box: Three | None = None
    cylinder: Two | None = None


class PenaltyTable(_Table):
    """``weights = {link_position = 60, link_position_integral = 300}`` and ``effort = 10`` (R2)."""

    weights: dict[str, float | list[float]]
    effort: float | list[float] = 1.0


class RobotTable(_Table):
    """The whole file."""

    name: str = ""
    description: str = ""
    gravity: Number | None = None
    down: Three | None = None
    home: list[float] | None = None
    urdf: str | None = None
    mjcf: str | None = None
    joints: list[str] | None = None
    locked: dict[str, float] = Field(default_factory=dict)
    penalty: PenaltyTable | None = None
    tolerances: TolerancesTable = Field(default_factory=TolerancesTable)
    payload: list[PayloadTable] = Field(default_factory=list)
    joint: Annotated[list[JointTable], Field(min_length=1)]


#: The table behind each key, to name what is allowed there.
TABLES: dict[str, type[BaseModel]] = {
    "": RobotTable, "joint": JointTable, "link": LinkTable, "spring": SpringTable, "motor": MotorTable,
    "tolerances": TolerancesTable, "payload": PayloadTable, "inertia": InertiaTable, "penalty": PenaltyTable,
    "centre_of_mass": VectorTable,
}  # fmt: skip
