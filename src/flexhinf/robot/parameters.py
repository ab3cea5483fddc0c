"""Physical parameters of a robot: unit, tolerance, source and sign.

Numbers with units as text, ``"180deg"``, ``"10 kNm/rad"``: what a unit is in SI units, and what it measures.

A unit is a product of known ones with powers, over another such product: ``N·m·s/rad``, ``kg m^2``, ``g·cm²``,
``mNm/A``. Radians count: N·m is a torque, N·m/rad a stiffness. Large and small letters are those of the SI: MN are
meganewtons, mN millinewtons, and G is no gram. Only words that mean nothing else, as DEG, may be written in any.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.notebook import StatedRepr
from flexhinf.validation import (
    HUGE,
    checked_text,
    is_real,
    late_package,
    nearest,
    real_array,
    value_text,
    within_proportion,
)

if TYPE_CHECKING:
    import numpy as np
else:
    np = late_package("numpy")


class Quantity(NamedTuple):
    """A number of a robot, as its file has it.

    `unit`, `sliding_unit`: of a joint that turns and of one that slides. `sign`: "positive", "not negative" or "any".
    `default`: what a joint has that does not state it, where that is a number of the plant. `also`: what other programs
    and data sheets call it. `of_spring`: whether it stands in the table of a spring, which a rigid joint has not.
    `shared`: whether a table [tolerances] may state its tolerance.
    """

    unit: str
    sliding_unit: str
    sign: str = "any"
    default: float | None = None
    also: str = ""
    of_spring: bool = False
    shared: bool = True


#: Stands for the torque of a motor that has no limit within its drive, N·m: parameters are finite.
UNLIMITED = 1e9

#: Components of a centre of mass and of an inertia, in the order of their arrays.
VECTOR, INERTIA = ("x", "y", "z"), ("xx", "xy", "xz", "yy", "yz", "zz")

#: All numbers of robots, each stated once; those of joints are keys of their tables in a robot file, in this order.
QUANTITIES: dict[str, Quantity] = {
    "gravity": Quantity("m/s²", "m/s²", "not negative"),  # its size; "down" is its direction
    # links
    "mass": Quantity("kg", "kg", "not negative"),
    **{f"centre_of_mass_{axis}": Quantity("m", "m") for axis in VECTOR},
    **{f"inertia_{axes}": Quantity("kg·m²", "kg·m²") for axes in INERTIA},
    "length": Quantity("m", "m"),  # of a single link: from the axis to the centre of mass
    "link_inertia": Quantity("kg·m²", "kg·m²", "positive"),  # of a single link: about the axis
    "inertia_scale": Quantity("1", "1", "positive"),  # of a link's moments: a tolerance that keeps it a body
    # what a link carries
    "payload_mass": Quantity("kg", "kg", "not negative"),
    **{f"payload_centre_of_mass_{axis}": Quantity("m", "m") for axis in VECTOR},
    **{f"payload_inertia_per_mass_{axes}": Quantity("m²", "m²") for axes in INERTIA},
    # joints, seen from the link
    "stiffness": Quantity(
        "N·m/rad",
        "N/m",
        "positive",
        also="spring_constant spring_stiffness spring_rate joint_stiffness torsional_stiffness k",
        of_spring=True,
    ),
    "first_stiffness": Quantity(
        "N·m/rad", "N/m", "positive", also="k1 k_1 stiffness_1 stiffness_k1", of_spring=True
    ),
    "second_stiffness": Quantity(
        "N·m/rad", "N/m", "positive", also="k2 k_2 stiffness_2 stiffness_k2", of_spring=True
    ),
    "third_stiffness": Quantity(
        "N·m/rad", "N/m", "positive", also="k3 k_3 stiffness_3 stiffness_k3", of_spring=True
    ),
    "first_torque": Quantity(
        "N·m", "N", "not negative", also="t1 t_1 torque_1 limit_torque_1", of_spring=True
    ),
    "second_torque": Quantity(
        "N·m", "N", "not negative", also="t2 t_2 torque_2 limit_torque_2", of_spring=True
    ),
    "motor_inertia": Quantity("kg·m²", "kg", "positive", also="armature reflected_inertia inertia"),
    "friction": Quantity(
        "N·m·s/rad",
        "N·s/m",
        "not negative",
        also="viscous_friction viscous_damping viscous motor_friction motor_damping damping",
    ),
    # motors
    "rotor_inertia": Quantity("kg·m²", "kg·m²", "positive", shared=False),
    "hub_inertia": Quantity("kg·m²", "kg", "not negative", shared=False),
    "gear_ratio": Quantity(
        "1",
        "rad/m",
        "positive",
        also="reduction ratio gearing gear_reduction reduction_ratio transmission_ratio",
        shared=False,
    ),
    "gear_efficiency": Quantity("1", "1", "positive", also="efficiency"),
    "motor_efficiency": Quantity("1", "1", "positive"),
    "resistance": Quantity(
        "Ω", "Ω", "positive", also="armature_resistance winding_resistance coil_resistance r"
    ),
    "inductance": Quantity("H", "H", "positive", also="armature_inductance winding_inductance l"),
    "torque_constant": Quantity("N·m/A", "N/A", also="kt k_t motor_constant"),
    "back_emf_constant": Quantity("V·s/rad", "V·s/m", also="ke k_e kb back_emf emf_constant"),
    # the inner loop of a drive that takes velocities or positions, seen from the link
    "drive_bandwidth": Quantity("rad/s", "rad/s", "positive"),
    "drive_damping_ratio": Quantity("1", "1", "positive"),
    "drive_stiffness": Quantity("N·m/rad", "N/m", "positive"),
    "drive_damping": Quantity("N·m·s/rad", "N·s/m", "positive"),
    "load_share": Quantity("1", "1", "not negative"),
    # what a real joint adds
    "damping": Quantity(
        "N·m·s/rad",
        "N·s/m",
        "not negative",
        default=0.0,
        also="spring_damping joint_damping damping_coefficient",
        of_spring=True,
    ),
    "spring_hardening": Quantity("N·m/rad³", "N/m³", "not negative", default=0.0, of_spring=True),
    "backlash": Quantity("rad", "m", "not negative", default=0.0, of_spring=True),
    "coulomb_friction": Quantity(
        "N·m",
        "N",
        "not negative",
        default=0.0,
        also="dry_friction friction_torque frictionloss friction_loss stiction breakaway_torque",
    ),
    "static_friction": Quantity("N·m", "N", "not negative", default=0.0),
    "stribeck_velocity": Quantity("rad/s", "m/s", "positive", default=0.1),
    "friction_smoothing": Quantity("rad/s", "m/s", "positive", default=0.01, shared=False),
    "kinematic_error": Quantity("rad", "m", "not negative", default=0.0, of_spring=True),
    "kinematic_error_phase": Quantity("rad", "rad", default=0.0, of_spring=True),
    "torque_ripple": Quantity("N·m", "N", "not negative", default=0.0),
    "torque_ripple_phase": Quantity("rad", "rad", default=0.0),
    "load_friction": Quantity("1", "1", "not negative", default=0.0),
    "drive_torque_limit": Quantity("N·m", "N", "positive", default=UNLIMITED),
}


def unit_of(quantity: str, slides: bool = False) -> str:
    """Unit of a quantity at a joint that turns or slides."""
    known = QUANTITIES[quantity]
    return known.sliding_unit if slides else known.unit


def parameter_units(values: Mapping[str, Any], slides: Sequence[bool]) -> dict[str, str]:
    """Units of a plant's parameters: of a number by its name, of an array's elements by ``name[1]``, ``name[2]``, ….

    Arrays have one row per joint, and are counted row by row; `slides` says which joints are prismatic.
    """
    units = dict[str, str]()
    for name, value in values.items():
        size = int(np.size(value))
        sliding = slides if size == len(slides) else [False] * size
        names = [name] if size == 1 else [f"{name}[{k + 1}]" for k in range(size)]
        for quantity in [known for known in (name, f"{name}_x", f"{name}_xx") if known in QUANTITIES][:1]:
            units |= {label: unit_of(quantity, slide) for label, slide in zip(names, sliding, strict=True)}
    return units


def per_joint(quantity: str, joint: str, joints: int) -> str:
    """Name of one joint's number: with the joint's name behind it where there are several."""
    return quantity if joints == 1 else f"{quantity}_{joint}"


def payload_masses(parameters: Iterable[Parameter]) -> list[Parameter]:
    """Those of the parameters that are masses of payloads."""
    return [parameter for parameter in parameters if parameter.name.startswith("payload_mass")]


def whole_quantity(quantity: str) -> str:
    """The quantity that a component belongs to.

    Examples
    --------
    >>> whole_quantity("centre_of_mass_x"), whole_quantity("inertia_xx"), whole_quantity("mass")
    ('centre_of_mass', 'inertia', 'mass')
    """
    head, _, component = quantity.rpartition("_")
    return head if component in (*VECTOR, *INERTIA) else quantity


def check_parameters(robot: str, parameters: Sequence[Parameter], slides: Mapping[str, bool]) -> None:
    """Refuse parameters that are unknown, or have the wrong sign; `slides`: joints by name, whether prismatic."""
    known: dict[str, tuple[str, str]] = {}
    for joint in slides:
        for quantity in QUANTITIES:
            label = per_joint(quantity, joint, len(slides))
            other = known.setdefault(label, (quantity, joint))
            if other != (quantity, joint):  # friction of smoothing_a is friction_smoothing of a
                raise InvalidInput(
                    f"Two numbers of the robot {robot!r} have one name: {label!r}.",
                    f"expected distinct names, got {other[0]} of joint {other[1]!r} and {quantity} of joint {joint!r}",
                    f"another name for the joint {joint!r}",
                )
    known.setdefault("gravity", ("gravity", ""))
    values = {parameter.name: parameter.value for parameter in parameters}
    for joint in slides:
        low, high = (
            values.get(per_joint(name, joint, len(slides))) for name in ("first_torque", "second_torque")
        )
        if low is not None and high is not None and not low < high:
            raise InvalidInput(
                f"The torques of the stiffness curve of joint {joint!r} are not in order.",
                f"expected first_torque < second_torque, got {low:g} and {high:g}",
                "T₁ and T₂ of the gear's catalogue",
            )
    for parameter in parameters:
        if parameter.name not in known:
            raise InvalidInput(
                f"The robot {robot!r} has no use for a parameter {parameter.name!r}.",
                f"expected one of {list(QUANTITIES)}"
                + (f" with _JOINT for {list(slides)}" if slides else ""),
                nearest(parameter.name, known, "a name of the list"),
            )
        quantity, joint = known[parameter.name]
        sign, unit = QUANTITIES[quantity].sign, unit_of(quantity, slides.get(joint, False))
        positive, ends, unit = (
            sign == "positive",
            " at one end of its range",
            "" if unit == "1" else f" {unit}",
        )
        what = f"The parameter {parameter.name!r}{f' of joint {joint!r}' if joint else ''}"
        for value, where in ((parameter.value, ""), *((end, ends) for end in parameter.interval)):
            if (positive and not value > 0.0) or (sign != "any" and value < 0.0):
                raise InvalidInput(
                    f"{what} must {'be positive' if positive else 'not be negative'}.",
                    f"expected {'> 0' if positive else '>= 0'}{unit}, got {value:g}{unit}{where}",
                    (f"{abs(value):g}" if value and not where else "correct the value")
                    + ("; 'down' is the direction of gravity" if quantity == "gravity" else ""),
                )
            if not within_proportion(value, positive=positive):
                raise InvalidInput(
                    f"{what} is out of all proportion.",
                    f"expected {1 / HUGE:g} to {HUGE:g}{unit}, got {value:g}{unit}{where}",
                    "its value in SI units",
                )


def checked_limits(what: str, stated: Any, joints: Sequence[str], signals: Sequence[str] = ()) -> np.ndarray:
    """One positive limit per joint (n,); infinite where none is stated.

    Stated as a number or None for each joint, and with `signals` also as a number for all, or by the joints' names or
    those of their signals.
    """
    if stated is None:
        return np.full(len(joints), np.inf)
    listed = stated
    if isinstance(stated, Mapping):
        by_name = cast("Mapping[str, Any]", stated)
        named = {dict(zip(signals, joints)).get(name, name): value for name, value in by_name.items()}
        listed = [named.get(joint, np.nan) for joint in joints] if set(named) <= set(joints) else np.nan
    elif isinstance(stated, Sequence) and not isinstance(stated, (str, bytes)) and not signals:
        listed = [np.inf if limit is None else limit for limit in cast("Sequence[object]", stated)]
    limits = real_array(listed)
    if limits.size == 1 and signals:
        limits = np.full(len(joints), limits.item())
    usable = (limits == np.inf) | ((limits >= 1.0 / HUGE) & (limits <= HUGE))
    refuse_if(
        limits.shape != (len(joints),) or not usable.all(),
        f"{what} do not fit the joints.",
        f"expected a number > 0, or None, for each of {list(joints)}, got {value_text(cast(object, stated))}",
        f"[{', '.join(['10.0'] * len(joints))}]",
    )
    return limits


def checked_brakes(name: str, brakes: Sequence[bool], joints: Sequence[str]) -> tuple[bool, ...]:
    """Whether each joint of a robot has a brake; none has where nothing is stated. InvalidInput: they do not fit."""
    stated: tuple[object, ...] = tuple(brakes) or (False,) * len(joints)
    refuse_if(
        len(stated) != len(joints) or not all(type(brake) is bool for brake in stated),
        f"The brakes of the robot {name!r} do not fit its joints.",
        f"expected True or False for each of {list(joints)}, got {value_text(brakes)}",
        "brakes=() for a robot without any; in a robot file brakes = true of a [[joint]]",
    )
    return tuple(brake is True for brake in stated)


#: How the source of a number begins that nobody stated, and that is guessed from others.
ESTIMATE = "estimate"


class PlantValues(dict[str, Any]):
    """Parameters of a plant by name, and in `numbers` every parameter of the robot that they come from.

    A plant knows of a payload only that a link is heavier; the robot knows it by its own name.
    """

    def __init__(self, values: Mapping[str, Any], numbers: Mapping[str, Any]) -> None:
        super().__init__(values)
        self.numbers = dict(numbers)


@dataclass(frozen=True, repr=False)
class Parameter(StatedRepr):
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

    Raises InvalidInput: for a value that is not finite, a tolerance outside 0 ≤ tolerance < 100, or a range
    without the value.

    Examples
    --------
    >>> import flexhinf as fh
    >>> fh.Parameter("mass", 2.0, tolerance=5.0, unit="kg", source="data sheet").interval
    (1.9, 2.1)
    """

    name: str
    value: float
    tolerance: float = 0.0
    unit: str = ""
    source: str = "assumption"
    range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for kind in ("name", "unit", "source"):
            checked_text(f"the {kind} of the parameter {value_text(self.name, 60)}", getattr(self, kind))
        refuse_if(
            not (is_real(self.value) and abs(real_array(self.value)) <= HUGE),
            f"The parameter {self.name!r} is not finite, or out of all proportion.",
            f"expected a finite number of at most {HUGE:g} {self.unit}, got {value_text(self.value)}",
            "its value in SI units",
        )
        refuse_if(
            not (is_real(self.tolerance) and 0.0 <= self.tolerance < 100.0),
            f"The tolerance of {self.name!r} is not a percentage.",
            f"expected 0 to below 100 per cent, got {value_text(self.tolerance)}",
            "12 for ±12 %",
        )
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
            raise InvalidInput(
                f"The parameter {self.name!r} has a tolerance and a range.",
                f"got {self.tolerance:g} per cent and {value_text(self.range)}",
                "one of the two",
            )
        object.__setattr__(self, "range", tuple(ends.tolist()))

    def at(self, sign: float) -> float:
        """The value at −1 (lower end), 0 (nominal), 1 (upper end), or linearly between two of these."""
        if self.range is None:
            return self.value + sign * abs(self.value) * self.tolerance / 100.0
        return (1.0 - abs(sign)) * self.value + abs(sign) * self.range[sign > 0.0]  # the ends to the last bit

    @property
    def interval(self) -> tuple[float, float]:
        """Smallest and largest possible value."""
        return self.at(-1.0), self.at(1.0)

    @property
    def estimated(self) -> bool:
        """Whether the value is guessed from other numbers: its source begins with `ESTIMATE`."""
        return self.source.strip().lower().startswith(ESTIMATE)

    @property
    def spread(self) -> str:
        """The interval as text: "± 12 %", "0 to 3"; empty for an exact number."""
        if self.range is not None:
            return f"{self.range[0]:g} to {self.range[1]:g}"
        return f"± {self.tolerance:g} %" if self.tolerance else ""


def random_signs(parameters: int, count: int, seed: Any) -> np.ndarray:
    """Signs (count, parameters) of random corners, −1 or 1; `seed` is a number or several."""
    return np.random.default_rng(seed).choice([-1.0, 1.0], (count, parameters))


def corner_groups(uncertain: Sequence[Parameter]) -> tuple[list[str], np.ndarray]:
    """Names of the groups of quantities that go to their ends together, and the signs (groups, quantities) of each
    group alone.

    All moments of inertia of a link are at their large or at their small ends: otherwise they may be those of no rigid
    body.
    """
    names = [re.sub("inertia(_per_mass)?_[xyz]{2}", "inertia", p.name) for p in uncertain]
    groups = list(dict.fromkeys(names))
    turned = [-1.0 if p.value < 0.0 and p.name != name else 1.0 for p, name in zip(uncertain, names)]
    members = np.array([[name == group for name in names] for group in groups], dtype=float)
    return groups, members.reshape(len(groups), len(names)) * turned


#: Units of times, angles and lengths, and what one is in the SI unit that stands first.
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
TURNING = {
    "rad": 1.0,
    "mrad": 1e-3,
    "deg": math.pi / 180.0,
    "°": math.pi / 180.0,
    "arcmin": math.pi / 10800.0,
    "arcsec": math.pi / 648000.0,
}
SLIDING = {"m": 1.0, "mm": 1e-3}

#: Nothing is looked at twice: a text of any length is read or refused at once.
_NUMBER = re.compile(r"\s*+([-+]?(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?+|[-+]?inf|nan)\s*+")
#: Longest unit that is looked at.
_LONGEST = 40
#: Most spellings that are looked at where letters are others.
_MOST_SPELLED = 16

#: Powers of kg, m, s, rad and A.
Dimension = tuple[int, ...]
_MASS, _LENGTH, _TIME, _ANGLE, _CURRENT = ((0,) * i + (1,) + (0,) * (4 - i) for i in range(5))
_FORCE, _TORQUE = (1, 1, -2, 0, 0), (1, 2, -2, 0, 0)
_VOLT, _OHM, _HENRY = (1, 2, -3, 0, -1), (1, 2, -3, 0, -2), (1, 2, -2, 0, -2)
_ALONE = (0, 0, 0, 0, 0)


#: Units that are not made of others: their names, what they measure, what one is in SI units, and prefixes.
_FAMILIES = (
    ("g", _MASS, 1e-3, "mk"),
    ("m", _LENGTH, 1.0, "cµu"),
    ("N", _FORCE, 1.0, "mkM"),
    ("Nm", _TORQUE, 1.0, "mkM"),
    ("V", _VOLT, 1.0, "mk"),
    ("A", _CURRENT, 1.0, "m"),
    *((name, _OHM, 1.0, "mk") for name in ("Ω", "Ω", "Ohm", "ohm")),
    ("H", _HENRY, 1.0, "mµμu"),
    ("rpm", (0, 0, -1, 1, 0), math.pi / 30.0, "k"),
)
_PREFIXES = {"": 1.0, "m": 1e-3, "k": 1e3, "M": 1e6, "c": 1e-2, "µ": 1e-6, "μ": 1e-6, "u": 1e-6}

_ATOMS: dict[str, tuple[float, Dimension]] = {
    **{name: (size, _TIME) for name, size in SECONDS.items()},
    **{name: (size, _ANGLE) for name, size in TURNING.items()},
    **{name: (size, _LENGTH) for name, size in SLIDING.items()},
    **{
        prefix + name: (_PREFIXES[prefix] * size, dimension)
        for name, dimension, size, prefixes in _FAMILIES
        for prefix in ("", *prefixes)
    },
    **{"Ncm": (1e-2, _TORQUE), "Nmm": (1e-3, _TORQUE), "%": (1e-2, _ALONE), "1": (1.0, _ALONE)},
}
_FACTOR = re.compile(
    rf"({'|'.join(sorted(map(re.escape, _ATOMS), key=len, reverse=True))})(?:\^?(-?[1-4])|([²³]))?[·⋅*. ]?"
)
#: Words that are units in any letters, a prefix before them in its own.
_WORD = re.compile(r"(?<![^\W\d_])([mk]?)((?i:rad|deg|arcmin|arcsec|rpm|ohm|hz))(?![^\W\d_])")
_FOLDED = re.compile(_FACTOR.pattern.partition("(?:")[0], re.IGNORECASE)
_POWERS = {"": 1, "²": 2, "³": 3}


class Stated(float):
    """A number in SI units that was stated in a unit; everything computed with it is a plain float.

    `number` and `unit` are as they were written, "30" and "mm"; `si` is the SI unit that it has.
    """

    number: str
    unit: str
    si: str

    def __new__(cls, value: float, number: str = "", unit: str = "", si: str = "") -> Stated:
        """The number, and how it was written."""
        stated = super().__new__(cls, value)
        stated.number, stated.unit, stated.si = number, unit, si
        return stated


def split(text: str) -> tuple[str, str] | None:
    """Number and unit of a text, as they are written; None where it does not begin with a number."""
    match = _NUMBER.match(text)
    return None if match is None else (match[1], text[match.end() :].strip())


def measured(text: str, *si: str) -> Stated:
    """A finite number with a unit, in the first of these SI units that measures the same; ValueError for other text.

    Examples
    --------
    >>> measured("10 kNm/rad", "N·m/rad", "N/m")
    10000.0
    >>> measured("90deg", "rad") == math.pi / 2
    True
    """
    parts = split(text)
    known = _unit(parts[1]) if parts is not None and len(parts[1]) <= _LONGEST else None
    if parts is not None and known is not None:
        for unit in si:
            size, dimension = _unit(unit) or (1.0, ())
            value = float(parts[0]) * (known[0] / size)
            if dimension == known[1] and math.isfinite(value):
                return Stated(value, *parts, unit)
    raise ValueError(text)


def lettered(unit: str) -> str:
    """A unit with rad, deg, arcmin, arcsec, rpm, ohm and Hz in their usual case; prefixes and symbols stay as written.

    Examples
    --------
    >>> lettered("N·m/RAD"), lettered("1/S"), lettered("MM")
    ('N·m/rad', '1/S', 'MM')
    """
    return _WORD.sub(lambda match: match[1] + match[2].lower().replace("hz", "Hz"), unit)


def respelled(text: str, *si: str) -> list[str]:
    """Possible readings of a number whose unit has the wrong case, in units of the dimension of one of `si`.

    Examples
    --------
    >>> respelled("45 KNm/rad", "N·m/rad"), respelled("45 MNM", "N·m")
    (['45 kNm/rad'], ['45 mNm', '45 MNm'])
    """
    parts = split(text)
    if parts is None or len(parts[1]) > _LONGEST:
        return []
    spellings, at = [""], 0
    for match in _FOLDED.finditer(parts[1]):
        atoms = sorted((atom for atom in _ATOMS if atom.lower() == match[1].lower()), reverse=True)
        between = parts[1][at : match.start()]
        spellings = [before + between + atom for before in spellings for atom in atoms][:_MOST_SPELLED]
        at = match.end()
    fitting = [unit[1] for name in si if (unit := _unit(name))]
    whole = [spelling + parts[1][at:] for spelling in spellings]
    return [
        f"{parts[0]} {name}"
        for name in whole
        if name != parts[1] and (unit := _unit(name)) and unit[1] in fitting
    ]


@lru_cache(256)
def _unit(text: str) -> tuple[float, Dimension] | None:
    """Size of a unit in SI units, and its dimension; None for text that is no unit."""
    above, *below = lettered(text).split("/")
    size, total = 1.0, [0] * 5
    for part, sign in [(above.strip(), 1), *((divisor.strip(), -1) for divisor in below)]:
        factor, at = 1.0, 0
        while at < len(part):
            match = _FACTOR.match(part, at)
            if match is None:
                return None
            power = int(match[2]) if match[2] else _POWERS[match[3] or ""]
            scale, dimension = _ATOMS[match[1]]
            factor *= scale**power
            total = [a + sign * power * b for a, b in zip(total, dimension)]
            at = match.end()
        if not part:
            return None
        size *= factor**sign
    return size, tuple(total)


def estimated_quantities(
    parameters: Sequence[Parameter], joints: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Joints whose numbers are estimates and were not measured, by quantity; no joint for gravity."""
    n, found = len(joints), dict[str, list[str]]()
    homes = {per_joint(quantity, joint, n): (quantity, joint) for quantity in QUANTITIES for joint in joints}
    for parameter in parameters:
        if parameter.estimated:
            quantity, joint = homes.get(parameter.name, (parameter.name, ""))
            found.setdefault(whole_quantity(quantity), []).append(joint)
    return {quantity: tuple(dict.fromkeys(filter(None, names))) for quantity, names in found.items()}
