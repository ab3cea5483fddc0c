"""Which fields of a specification have a control on the page, and over what range a slider moves each.

A control's text is what the command line takes; empty text restores the default. A slider writes such a text.
"""

# Values of settings have no types.
# pyright: reportUnknownArgumentType=false, reportUnknownVariableType=false

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from flexhinf.designs.design_file import plain
from flexhinf.designs.specification import FIELDS, Specification, SpecificationError
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.plant import Penalty
from flexhinf.robot import Robot
from flexhinf.validation import value_text

#: Headings of the groups, in order.
MOVE, WEIGHTS, BEHAVIOUR, SENSORS, ROBOTS = (
    "Step",
    "Weights",
    "Behaviour",
    "Sensors and noise",
    "Robots and limits",
)
GROUPS = (MOVE, WEIGHTS, BEHAVIOUR, SENSORS, ROBOTS)

#: Fields that give way when one is stated, as where an option of the command line contradicts a design file.
GIVES_WAY = {
    "penalty": ("bandwidth", "damping", "preset"),
    "effort": ("bandwidth", "damping", "preset"),
    "bandwidth": ("penalty", "effort", "preset"),
    "damping": ("penalty", "effort", "preset"),
}

#: Weights of the penalty that have a slider.
PENALISED = ("link_position", "link_position_integral", "link_velocity")

#: Weights where neither specification nor robot states any.
USUAL_PENALTY = {"link_position": 60.0, "link_position_integral": 300.0}

#: The field that is none of a specification: a factor of all tolerances of the robot.
TOLERANCES = "tolerances"


@dataclass(frozen=True)
class Control:
    """One row of the page: a text, and a slider where there is a range."""

    key: str  # a field; of a weight ``penalty.NAME``
    label: str
    group: str
    low: float = 0.0  # in the unit of the field, as are `high` and `usual`
    high: float = 0.0  # of the slider; none where it is not above `low`
    logarithmic: bool = False
    whole: bool = False  # whole numbers alone
    usual: float = math.nan  # where the slider stands while the field has its default
    choices: tuple[str, ...] = ()  # buttons instead of text; "" is the default
    steps: int = 100

    @property
    def field(self) -> str:
        """The field of the specification."""
        return self.key.partition(".")[0]

    @property
    def help(self) -> str:
        """The help of the field, as on the command line."""
        if self.key == TOLERANCES:
            return "Factor of the tolerances that the robot's file states; 0: every robot is the nominal one."
        about = FIELDS[self.field].about
        return f"{about.text} Unit: {about.unit}." if about.unit else about.text

    @property
    def has_slider(self) -> bool:
        """Whether there is a range for a slider."""
        return self.high > self.low

    def position(self, value: float) -> float:
        """Place of a value on the slider, 0 to `steps`."""
        if not math.isfinite(value):
            value = self.usual if math.isfinite(self.usual) else self.low
        low, high, value = self.low, self.high, min(max(value, self.low), self.high)
        if self.logarithmic:
            low, high, value = math.log(low), math.log(high), math.log(value)
        return round(self.steps * (value - low) / (high - low))

    def text(self, position: float) -> str:
        """Text of a place on the slider."""
        share = min(max(position / self.steps, 0.0), 1.0)
        if self.logarithmic:
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + share * (self.high - self.low)
        return f"{round(value)}" if self.whole else f"{value:.4g}"


CONTROLS = (
    Control("pose", "Goal", MOVE),
    Control("start", "Start", MOVE),
    Control("duration", "Duration, s", MOVE),
    Control("gamma_ratio", "H∞ level γ/γ*", WEIGHTS, 1.02, 5.0, logarithmic=True, usual=1.5),
    Control("degrees", "Degree of V, law one less", WEIGHTS, choices=("", "2", "4", "6")),
    Control("penalty.link_position", "Weight of position", WEIGHTS, 0.1, 1e5, logarithmic=True),
    Control("penalty.link_position_integral", "Weight of integral", WEIGHTS, 0.1, 1e5, logarithmic=True),
    Control("penalty.link_velocity", "Weight of velocity", WEIGHTS, 0.01, 1e4, logarithmic=True),
    Control("effort", "Cost of input R₂", WEIGHTS, 1e-3, 1e3, logarithmic=True, usual=1.0),
    Control("bandwidth", "Bandwidth, rad/s", BEHAVIOUR, 0.2, 40.0, logarithmic=True, usual=2.0),
    Control("damping", "Damping ratio", BEHAVIOUR, 0.05, 0.9, usual=0.2),
    Control("estimator", "Estimator", SENSORS, choices=("ukf", "ekf", "observer", "none")),
    Control("measured", "Measured", SENSORS),
    Control("torque_noise", "Process noise Rᵛ", SENSORS, 1e-12, 1e-3, logarithmic=True, usual=1e-7),
    Control("measurement_noise", "Sensor noise Rⁿ", SENSORS, 1e-12, 1e-4, logarithmic=True, usual=1e-8),
    Control("unknown_delay", "Unknown delay, s", SENSORS, 0.0, 0.05, usual=0.0, steps=50),
    Control(TOLERANCES, "Tolerances ×", ROBOTS, 0.0, 3.0, usual=1.0, steps=60),
    Control("draws", "Robots", ROBOTS, 0.0, 500.0, whole=True, usual=200.0, steps=50),
    Control("saturation", "Limit of input", ROBOTS, 1.0, 1e3, logarithmic=True, usual=1e3),
    Control("seed", "Seed", ROBOTS),
)


def current_text(control: Control, s: Specification, tolerances: float, slides: Sequence[bool]) -> str:
    """Text of a control; empty where the field has its default of None. `slides`: which joints do."""
    if control.key == TOLERANCES:
        return f"{tolerances:.4g}"
    value: Any = getattr(s, control.field)
    if control.field == "penalty":
        weights = stated_weights(value)
        value = None if weights is None else weights.get(control.key.partition(".")[2])
    if value is None:
        return ""
    if control.field in ("pose", "start") and s.in_degrees:
        own = zip(np.atleast_1d(value).tolist(), slides)
        return ",".join(f"{each:.6g}m" if sliding else f"{np.degrees(each):.6g}deg" for each, sliding in own)
    value = plain(control.field, value)
    return ",".join(map(_text, [*value] if isinstance(value, (list, tuple)) else [value]))


def _text(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def current_value(control: Control, s: Specification, tolerances: float, robot: Robot) -> float:
    """Number that the slider stands for; NaN where it is not known before the design is made."""
    if control.key == TOLERANCES:
        return tolerances
    if control.field == "penalty":
        value = weights_of(robot, s).get(control.key.partition(".")[2])
    else:
        value = getattr(s, control.field)
        if value is None and control.field == "effort" and robot.penalty is not None:
            value = robot.penalty.effort
    try:
        return float(np.max(np.asarray(value, dtype=float)))
    except (TypeError, ValueError):
        return math.nan


#: Fields and lists in an advice, as Python writes them; and what is said to those who write Python.
_FIELD = re.compile(rf"(?<![\w.])({'|'.join(FIELDS)})=('[^']*'|\"[^\"]*\"|\([^()]*\)|\[[^\[\]]*\]|[^\s,;)]+)")
_LIST = re.compile(r"[\[(]([-+.\de]+(?:, ?[-+.\de]+)+),?[\])]")
_OF_PYTHON = re.compile(r" in commands and specifications, np\.\w+\([^()]*\) elsewhere")


def advice_text(error: FlexhinfError) -> str:
    """What to try, with the labels of the page and in the syntax of its fields."""
    labels = {control.field: control.label.partition(",")[0] for control in reversed(CONTROLS)}

    def labelled(match: re.Match[str]) -> str:
        return f"{labels.get(match[1], match[1].replace('_', ' '))} {_plain(match[2])}"

    text = _OF_PYTHON.sub("", error.advice)
    if isinstance(error, SpecificationError) and error.example:
        text = f"{error.field}={error.example!r}"
    return _LIST.sub(lambda match: _plain(match[1]), _FIELD.sub(labelled, text))


def _plain(value: str) -> str:
    """A value of Python as a field takes it: without brackets and quotes, and a number without an exponent."""
    end = "." * value.endswith(".")
    parts = [part.strip(" '\"") for part in value.rstrip(".").strip("()[]").split(",")]
    return ",".join(f"{float(x):.6g}" if re.fullmatch(r"[-+.\de]*\d", x) else x for x in parts if x) + end


def stated_weights(penalty: Any) -> dict[str, Any] | None:
    """Weights by name of a penalty, None for rows, code and no penalty."""
    states: Any = penalty.states if isinstance(penalty, Penalty) else penalty
    return {str(name): weight for name, weight in states.items()} if isinstance(states, Mapping) else None


def weights_of(robot: Robot, s: Specification) -> dict[str, Any]:
    """Weights by name: the specification's, else the robot's, else `USUAL_PENALTY`."""
    return stated_weights(s.penalty) or stated_weights(robot.penalty) or dict(USUAL_PENALTY)


def changed(s: Specification, control: Control, text: str, robot: Robot) -> Specification:
    """The specification with another value of a control; what contradicts it gives way.

    Raises InvalidInput: for a text that the field does not take.
    """
    name, value = control.field, text.strip() or FIELDS[control.field].default
    if name == "penalty" and text.strip():
        parts: list[str] = text.split(",")
        weight = {control.key.partition(".")[2]: parts[0] if len(parts) == 1 else parts}
        read: Mapping[str, float | tuple[float, ...]] = {}
        with suppress(InvalidInput):
            read = cast(
                "Mapping[str, float | tuple[float, ...]]", FIELDS[name].read(weight)
            )  # as of `Weights`
        refuse_if(
            not read
            or not all(np.all(np.isfinite(each) & (np.asarray(each) >= 0.0)) for each in read.values()),
            f"{control.label}: this is no weight.",
            f"expected a number >= 0, got {value_text(text, 60)}",
            "60",
        )
        value = {**weights_of(robot, s), **read}
    stated = value is not None and value != FIELDS[name].default
    away = dict.fromkeys(GIVES_WAY.get(name, ()) if stated else ())
    fields: dict[str, Any] = {**away, name: value}
    if name in ("pose", "start") and text.strip():
        fields["angle_unit"] = None  # from the text again, see `Specification`
    return replace(s, **fields)
