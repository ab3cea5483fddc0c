"""The physical numbers a robot is made of: unit, tolerance and source, and what they must be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.validation import (
    HUGE,
    checked_text,
    is_real,
    nearest,
    real_array,
    value_text,
    within_proportion,
)


class Quantity(NamedTuple):
    """Unit of a number of a joint that turns, of one that slides, and its sign: "positive", "not negative" or "any"."""

    unit: str
    sliding_unit: str
    sign: str = "any"


def _same(unit: str, sign: str = "any") -> Quantity:
    return Quantity(unit, unit, sign)


#: Components of a centre of mass and of an inertia, in the order of their arrays.
VECTOR, INERTIA = ("x", "y", "z"), ("xx", "xy", "xz", "yy", "yz", "zz")

QUANTITIES: dict[str, Quantity] = {
    "gravity": _same("m/s²"),
    # links
    "mass": _same("kg", "not negative"),
    **{f"centre_of_mass_{axis}": _same("m") for axis in VECTOR},
    **{f"inertia_{axes}": _same("kg·m²") for axes in INERTIA},
    "length": _same("m"),  # of a single link: from the axis to the centre of mass
    "link_inertia": _same("kg·m²", "positive"),  # of a single link: about the axis
    "inertia_scale": _same("1", "positive"),  # factor of a link's moments: a tolerance that keeps it a body
    # what a link carries
    "payload_mass": _same("kg", "not negative"),
    **{f"payload_centre_of_mass_{axis}": _same("m") for axis in VECTOR},
    **{f"payload_inertia_per_mass_{axes}": _same("m²") for axes in INERTIA},
    # joints, seen from the link
    "stiffness": Quantity("N·m/rad", "N/m", "positive"),
    "motor_inertia": Quantity("kg·m²", "kg", "positive"),
    "friction": Quantity("N·m·s/rad", "N·s/m", "not negative"),
    # motors
    "rotor_inertia": Quantity("kg·m²", "kg·m²", "positive"),
    "hub_inertia": Quantity("kg·m²", "kg", "not negative"),
    "gear_ratio": Quantity("1", "rad/m", "positive"),
    "gear_efficiency": _same("1", "positive"),
    "motor_efficiency": _same("1", "positive"),
    "resistance": _same("Ω", "positive"),
    "inductance": _same("H", "positive"),
    "torque_constant": Quantity("N·m/A", "N/A"),
    "back_emf_constant": Quantity("V·s/rad", "V·s/m"),
    # what a real joint adds
    "damping": Quantity("N·m·s/rad", "N·s/m", "not negative"),
    "spring_hardening": Quantity("N·m/rad³", "N/m³", "not negative"),
    "backlash": Quantity("rad", "m", "not negative"),
    "coulomb_friction": Quantity("N·m", "N", "not negative"),
    "static_friction": Quantity("N·m", "N", "not negative"),
    "stribeck_velocity": Quantity("rad/s", "m/s", "positive"),
    "friction_smoothing": Quantity("rad/s", "m/s", "positive"),
}


def unit_of(quantity: str, slides: bool = False) -> str:
    """Unit of a quantity at a joint that turns or slides."""
    known = QUANTITIES[quantity]
    return known.sliding_unit if slides else known.unit


def parameter_units(values: Mapping[str, Any], slides: Sequence[bool]) -> dict[str, str]:
    """Units of a plant's parameters: of a number by its name, of an array's elements by ``name[1]``, ``name[2]``, ….

    Arrays have one row per joint, and are counted row by row; `slides` says which joints are prismatic.
    """
    units = {}
    for name, value in values.items():
        quantity = next((known for known in (name, f"{name}_x", f"{name}_xx") if known in QUANTITIES), None)
        if quantity is None:
            continue
        size = int(np.size(value))
        sliding = [bool(slide) for slide in slides] if size == len(slides) else [False] * size
        names = [name] if size == 1 else [f"{name}[{k + 1}]" for k in range(size)]
        units |= {label: unit_of(quantity, slide) for label, slide in zip(names, sliding, strict=True)}
    return units


def per_joint(quantity: str, joint: str, joints: int) -> str:
    """Name of one joint's number: with the joint's name behind it where there are several."""
    return quantity if joints == 1 else f"{quantity}_{joint}"


def check_parameters(robot: str, parameters: Sequence[Parameter], slides: Mapping[str, bool]) -> None:
    """Refuse parameters that mean nothing, or have the wrong sign; `slides`: joints by name, whether prismatic."""
    known: dict[str, tuple[str, bool]] = {"gravity": ("gravity", False)}
    for joint, sliding in slides.items():
        known |= {per_joint(quantity, joint, len(slides)): (quantity, sliding) for quantity in QUANTITIES}
    meaning: dict[str, tuple[str, str]] = {}
    for joint in slides if len(slides) > 1 else ():
        for quantity in QUANTITIES:
            label = per_joint(quantity, joint, len(slides))
            other = meaning.setdefault(label, (quantity, joint))
            if other != (quantity, joint):  # friction of smoothing_a is friction_smoothing of a
                raise InvalidInput(
                    f"Two numbers of the robot {robot!r} have one name: {label!r}.",
                    f"expected distinct names, got {other[0]} of joint {other[1]!r} and {quantity} of joint {joint!r}",
                    f"another name for the joint {joint!r}",
                )
    for parameter in parameters:
        if parameter.name not in known:
            raise InvalidInput(
                f"The robot {robot!r} has no use for a parameter {parameter.name!r}.",
                f"expected one of {list(QUANTITIES)}"
                + (f" with _JOINT for {list(slides)}" if slides else ""),
                nearest(parameter.name, known, "a name of the list"),
            )
        quantity, sliding = known[parameter.name]
        sign, unit = QUANTITIES[quantity].sign, unit_of(quantity, sliding)
        positive, ends = sign == "positive", " at one end of its range"
        for value, where in ((parameter.value, ""), *((end, ends) for end in parameter.interval)):
            if (positive and not value > 0.0) or (sign != "any" and value < 0.0):
                raise InvalidInput(
                    f"The parameter {parameter.name!r} must {'be positive' if positive else 'not be negative'}.",
                    f"expected {'> 0' if positive else '>= 0'} {unit}, got {value:g} {unit}{where}",
                    "correct the value",
                )
            if not within_proportion(value, positive=positive):
                raise InvalidInput(
                    f"The parameter {parameter.name!r} is out of all proportion.",
                    f"expected {1 / HUGE:g} to {HUGE:g} {unit}, got {value:g} {unit}{where}",
                    "its value in SI units",
                )


def checked_limits(what: str, stated: Any, joints: Sequence[str], signals: Sequence[str] = ()) -> np.ndarray:
    """One positive limit per joint (n,); infinite where none is stated.

    Stated as a number or None for each joint, and with `signals` also as a number for all, or by the joints' names or
    those of their signals.
    """
    listed = stated
    if isinstance(stated, Mapping):
        named = {dict(zip(signals, joints)).get(name, name): value for name, value in stated.items()}
        listed = [named.get(joint, np.nan) for joint in joints] if set(named) <= set(joints) else np.nan
    elif isinstance(stated, Sequence) and not isinstance(stated, (str, bytes)) and not signals:
        listed = [np.inf if limit is None else limit for limit in stated]
    limits = real_array(np.inf if stated is None else listed)
    if (limits.ndim == 0 and stated is None) or (limits.size == 1 and signals):
        limits = np.full(len(joints), limits.item())
    usable = (limits == np.inf) | ((limits >= 1.0 / HUGE) & (limits <= HUGE))
    if limits.shape != (len(joints),) or not np.all(usable):
        found = f"expected a number > 0, or None, for each of {list(joints)}, got {value_text(stated)}"
        raise InvalidInput(f"{what} do not fit the joints.", found, f"[{', '.join(['10.0'] * len(joints))}]")
    return limits


class PlantValues(dict[str, Any]):
    """Parameters of a plant by name, and in `numbers` every parameter of the robot that they come from.

    A plant knows of a payload only that a link is heavier; the robot knows it by its own name.
    """

    def __init__(self, values: Mapping[str, Any], numbers: Mapping[str, float]) -> None:
        super().__init__(values)
        self.numbers = dict(numbers)


@dataclass(frozen=True)
class Parameter:
    """One row of a table like the paper's Tables 1 and 2.

    Parameters
    ----------
    value : float
        Nominal value, in `unit` (SI).
    tolerance : float
        Half width of the interval of possible values, in per cent of the nominal value.
    unit, source : str
        Where the number comes from, or "assumption".
    range : (lower, upper), optional
        Instead of a tolerance: the interval itself, in `unit`. It need not be symmetric, and the nominal value may be
        zero or at an end: a payload of 0 to 3 kg.

    Raises
    ------
    InvalidInput
        For a value that is not finite, a tolerance outside 0 ≤ tolerance < 100, or a range without the value.
    """

    name: str
    value: float
    tolerance: float = 0.0
    unit: str = ""
    source: str = "assumption"
    range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        checked_text("the name of a parameter", self.name)
        checked_text(f"the unit of {self.name!r}", self.unit)
        checked_text(f"the source of {self.name!r}", self.source)
        if not (is_real(self.value) and abs(real_array(self.value)) <= HUGE):
            found = f"expected a finite number of at most {HUGE:g} {self.unit}, got {value_text(self.value)}"
            what = f"The parameter {self.name!r} is not finite, or out of all proportion."
            raise InvalidInput(what, found, "its value in SI units")
        if not (is_real(self.tolerance) and 0.0 <= self.tolerance < 100.0):
            found = f"expected 0 to below 100 per cent, got {value_text(self.tolerance)}"
            raise InvalidInput(f"The tolerance of {self.name!r} is not a percentage.", found, "12 for ±12 %")
        if self.range is None:
            return
        ends = real_array(self.range)
        if ends.shape != (2,) or not -HUGE <= ends[0] <= self.value <= ends[1] <= HUGE:
            raise InvalidInput(
                f"The range of {self.name!r} does not hold its value.",
                f"expected [lower, upper] with lower <= {self.value:g} <= upper, got {value_text(self.range)}",
                f"a range about the nominal value, in {self.unit or 'SI units'}",
            )
        if self.tolerance:
            found = f"expected one of them, got {self.tolerance:g} per cent and {value_text(self.range)}"
            raise InvalidInput(
                f"The parameter {self.name!r} has a tolerance and a range.", found, "one of the two"
            )
        object.__setattr__(self, "range", tuple(ends.tolist()))

    def at(self, sign: float) -> float:
        """The value at −1 (lower end), 0 (nominal), 1 (upper end), or linearly between two of these."""
        if self.range is None:
            return self.value + sign * abs(self.value) * self.tolerance / 100.0
        share = abs(sign)
        return (1.0 - share) * self.value + share * self.range[sign > 0.0]  # the ends to the last bit

    @property
    def interval(self) -> tuple[float, float]:
        """Smallest and largest possible value."""
        return self.at(-1.0), self.at(1.0)

    @property
    def spread(self) -> str:
        """The interval as text: "± 12 %", "0 to 3"; empty for an exact number."""
        if self.range is not None:
            return f"{self.range[0]:g} to {self.range[1]:g}"
        return f"± {self.tolerance:g} %" if self.tolerance else ""
