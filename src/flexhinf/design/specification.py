"""The specification of a design: every field with its unit, range, default, help and example, declared once.

The options of the command line (`flexhinf.cli.arguments`), the design file (`flexhinf.design.design_file`), its JSON
schema and the table of options in docs/design.md derive from this class.

A field of a specification as people read it: help, unit, range, example, and its option at the command line.
"""

from __future__ import annotations

import dataclasses
import difflib
import functools
from typing import Annotated, Any, Literal, get_args, get_type_hints

from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from flexhinf.design.units import (
    AboveOne,
    Allowed,
    Count,
    Degrees,
    Distances,
    Duration,
    Flag,
    Frequencies,
    Names,
    NotNegative,
    Number,
    Period,
    PerJoint,
    PerJointSpeed,
    Pose,
    Poses,
    Positive,
    Quanta,
    Ratio,
    Seconds,
    Seed,
    Stated,
    Tolerances,
    Unreadable,
    Weights,
    angle_unit_of,
    choice,
)
from flexhinf.design.waypoint_table import Move, WaypointError
from flexhinf.errors import InvalidInput
from flexhinf.validation import value_text


@dataclasses.dataclass(frozen=True)
class About:
    """What people read about a field.

    Attributes
    ----------
    group : str
        Heading of its option in the help.
    example : str
        As on the command line; the same text is understood in Python and in a design file.
    zero : str
        What 0 stands for at the command line, where it is not a number of the range.
    default : str
        What is chosen where the default is None.
    """

    group: str
    help: str
    example: str
    unit: str = ""
    zero: str = ""
    default: str = ""


@dataclasses.dataclass(frozen=True)
class FieldInfo:
    """One field, as the command line, the design file and the docs see it.

    Attributes
    ----------
    allowed : str
        Its range in words.
    option : str
        Its option, which has its name; of a flag both, ``--mujoco/--no-mujoco``.
    """

    name: str
    about: About
    allowed: str
    default: Any
    option: str


def info_of(field: dataclasses.Field, annotation: Any) -> FieldInfo:
    """What is declared in the annotation of a field: its `About`, and the first range in words of its type."""
    about = next(part for part in annotation.__metadata__ if isinstance(part, About))
    option = f"--{field.name.replace('_', '-')}"
    option += f"/--no-{option[2:]}" if isinstance(field.default, bool) else ""
    return FieldInfo(field.name, about, _allowed(annotation), field.default, option)


def _allowed(annotation: Any) -> str:
    """The first range in words that stands in a type."""
    for part in getattr(annotation, "__metadata__", ()):
        if isinstance(part, Allowed):
            return part.words
    return next((words for part in get_args(annotation) if (words := _allowed(part))), "")


Preset = Literal["paper", "damped", "robust", "proved"]
Estimator = Literal["ukf", "ekf", "observer", "none"]
PRESETS: tuple[str, ...] = get_args(Preset)
ESTIMATORS: tuple[str, ...] = get_args(Estimator)
Shaping = Literal["jump", "quintic", "jerk-limited"]
SHAPINGS: tuple[str, ...] = get_args(Shaping)

#: Default variance of the velocities per sample: with the default R^n the estimator is then so fast that a load on the
#: link moves it little more than with the true state fed back, see docs/design.md.
TORQUE_NOISE = 1e-7

#: Default limits of the running loop. See docs/decisions.md for what they cost with the link alone measured.
PEAK_SENSITIVITY, GAIN_MARGIN = 2.5, 1.8

#: An oscillation with a smaller damping ratio than this rings: it takes more than three periods to fall to a tenth.
RINGS = 0.1

#: A figure that misses its limit by less than this fraction of it meets it: the width of the searches.
TOLERANCE = 0.02

#: Longest run in samples. Beyond it a time was probably meant in ms: such a run takes minutes and shows nothing that a
#: shorter one does not.
RUN_SAMPLES = 1_000_000

#: Most of what only costs time and memory beyond, and why.
MOST = {
    "draws": (100_000, "more take hours, and the memory of every run"),
    "rays": (100_000, "ascent finds what so many directions miss; more take hours"),
    "gamma_ratio": (1e6, "from there on the disturbance has no weight in the law, and it no longer changes"),
    "checked_gamma_ratio": (1e6, "from there on the disturbance has no weight in the inequality"),
}

#: A step of a sensor by what it measures, for advice, and the SI units that it may be stated in.
EXAMPLES = {"position": "0.01deg", "velocity": "0.1deg/s", "torque": "0.1Nm"}
SENSOR_UNITS = {"position": ("rad", "m"), "velocity": ("rad/s", "m/s"), "torque": ("N·m", "N")}

#: What 0 stands for at the command line where a limit is stated: infinity, also over a limit of the robot.
NO_LIMIT = "no limit"

BEHAVIOUR, WEIGHTS = "What the loop is to do", "Weights, instead of a preset"
SYNTHESIS, LOOP, REPORT = "Synthesis", "Sensors, estimator and true plant", "Report"


class SpecificationError(InvalidInput):
    """A field of a specification that cannot be used.

    Attributes
    ----------
    field : str
        The name of the field; it need not be one of `FIELDS`.
    example : str
        A value that can be used, as on the command line; "" where the advice is another one.
    """

    def __init__(self, field: str, what: str, found: str, advice: str = "", example: str = "") -> None:
        self.field, self.example = field, example
        super().__init__(what, found, advice or f"{field}={_python(field, example)}")


@dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid", arbitrary_types_allowed=True))
class Specification:
    """What a design is asked for; a field that is None is chosen by the rule that its help states.

    The fields with their units, ranges and defaults are listed in docs/design.md and by ``flexhinf design --help``.
    Every field takes numbers in SI units, or the text that the command line takes: ``pose="90deg"``, ``delay="5ms"``.

    Raises
    ------
    SpecificationError
        For an unknown field and for a value outside its range, with the field, the value and what is allowed.
    """

    # fmt: off
    pose: Annotated[Pose | None, About(BEHAVIOUR,
        "Goal, one position per joint: 0.3,-0.5 (rad, m), 30deg,-10deg or 30°,-10°.", "0.3,-0.5", "rad, m",
        default="the robot's home")] = None
    start: Annotated[Pose | None, About(BEHAVIOUR, "Position from which the step to the goal starts.",
        "0.2,-0.4", "rad, m", default="0.1 rad (10 mm) from the goal")] = None
    via: Annotated[Poses, About(BEHAVIOUR,
        "A pose between start and goal at which a law is designed too; repeat the option for several. The "
        "controller takes the law whose pose is nearest to the command.", "0.1,0.2", "rad, m")] = ()
    shaping: Annotated[Annotated[Shaping, BeforeValidator(choice), Allowed(", ".join(SHAPINGS))], About(BEHAVIOUR,
        "How the command gets to the goal: jump (at once), quintic or jerk-limited (as fast as the bandwidth and the "
        "limits of effort and speed allow). A move stops at its waypoints with the last two, and passes through them "
        "with jump.", "jerk-limited")] = "jump"
    move: Annotated[Move | None, About(BEHAVIOUR,
        "A move that the loop is judged by: a CSV file with columns time and the joints, 'time [s],elbow [deg]'. "
        "The goal is by default its last waypoint.", "waypoints.csv", "s; rad, m",
        default="the way from start to goal, not judged")] = None
    tracking_error: Annotated[Tolerances | None, About(BEHAVIOUR,
        "Largest distance of a link from the move: 1deg (0.01 rad, m), or one per joint 1deg,2mm.", "0.5deg", "rad, m",
        default="5 % of the joint's way along the move")] = None
    angle_unit: Annotated[Annotated[Literal["rad", "deg"], BeforeValidator(choice), Allowed("rad, deg")] | None,
        About(BEHAVIOUR, "Unit in which the report shows angles: rad or deg.", "deg",
        default="the unit of the poses")] = None
    preset: Annotated[Annotated[Preset, BeforeValidator(choice), Allowed(", ".join(PRESETS))] | None,
        About(BEHAVIOUR,
        "Where the weights come from: paper (the robot's own), damped (searched for bandwidth and damping), "
        "robust (searched on the running loop for its tolerances), proved (the step's least gain proved for all).",
        "damped", default="the robot's own weights, or damped where a bandwidth or a damping is required")] = None
    bandwidth: Annotated[Frequencies | None, About(BEHAVIOUR,
        "Least bandwidth, where |command → link position| falls below 1/√2: 4 (rad/s), one per joint 4,6, or with a "
        "unit 4rad/s, 0.6Hz. Weights are searched for it at corners of the tolerances, with the true state; it is "
        "judged on the running loop of the nominal robot.", "4", "rad/s",
        default="0.3 of the lowest vibration with held motors, less where margins of the loop ask for it")] = None
    damping: Annotated[Ratio | None, About(BEHAVIOUR,
        "Least damping ratio of every oscillation; searched for and judged as the bandwidth is.", "0.3",
        default="0.2 where weights are searched, down to 0.1 where noise at the motors asks for it")] = None
    peak_effort: Annotated[PerJoint | None, About(BEHAVIOUR,
        "Largest input of every motor in the step: 60, or one per joint 87,87,12.", "60",
        "V, N·m or N", zero=NO_LIMIT, default="the robot's effort limits, or none")] = None
    peak_speed: Annotated[PerJointSpeed | None, About(BEHAVIOUR,
        "Largest speed of every link: 2 (rad/s, m/s), one per joint 2.2,2.6, or with a unit 120deg/s.", "2",
        "rad/s or m/s", zero=NO_LIMIT, default="the robot's speed limits, or none")] = None
    overshoot: Annotated[Positive, About(BEHAVIOUR,
        "Largest overshoot of every link position, in per cent of the step.", "5", "%")] = 5.0
    peak_sensitivity: Annotated[AboveOne | None, About(BEHAVIOUR,
        "Largest peak of |S| of the running loop, with estimator, sampling and delay.", "2",
        default=f"{PEAK_SENSITIVITY:g}")] = None
    gain_margin: Annotated[AboveOne | None, About(BEHAVIOUR,
        "Least factor by which the gain of the running loop may grow or shrink.", "2",
        default=f"{GAIN_MARGIN:g}")] = None
    penalty: Annotated[Weights | None, About(WEIGHTS,
        "Weights of h(x): link_position=60,link_position_integral=300, or one per state (integrals last).",
        "link_position=60,link_position_integral=300", default="by the preset")] = None
    effort: Annotated[Positive | None, About(WEIGHTS, "R2, the weight of the input.", "10", zero="the default",
        default="the robot's own, or 1")] = None
    gamma_ratio: Annotated[AboveOne, About(SYNTHESIS,
        "γ/γ* of the design, at most 1e6; preset proved takes the best of 1.3, 1.5 and 2 for 1.5.", "1.5")] = 1.5
    checked_gamma_ratio: Annotated[Positive, About(SYNTHESIS,
        "γ/γ* of the inequality that is checked, at most 1e6.", "1.6")] = 1.6
    checked_penalty: Annotated[Weights | None, About(SYNTHESIS, "Weights of the inequality that is checked.",
        "link_position=54", default="0.9 times the penalty; the robot's own for all tolerances")] = None
    degrees: Annotated[Degrees | None, About(SYNTHESIS,
        "Degrees of V to compare: 4, or 2,4,6. The cost of the step decides between several.", "2,4",
        default="2, or up to 6 where that saves more than 5 % of the cost of the step")] = None
    disturbances: Annotated[Names | None, About(SYNTHESIS,
        "Torques that are disturbances of the synthesis: link_torque,motor_torque.", "link_torque",
        default="the command instead, as in the paper")] = None
    command: Annotated[Flag, About(SYNTHESIS,
        "Whether the command is a disturbance too, beside --disturbances.", "")] = False
    friction_model: Annotated[Flag, About(SYNTHESIS,
        "Whether the estimator's model (ukf, ekf) has the dry friction of --extras, smoothed; the feedforward of the "
        "planned move has it anyway.", "")] = False
    measured: Annotated[Names, About(LOOP,
        "link_position, motor_position, joint_torque, link_velocity, motor_velocity; NAME_JOINT for single ones.",
        "motor_position")] = ("link_position",)
    estimator: Annotated[Annotated[Estimator, BeforeValidator(choice), Allowed(", ".join(ESTIMATORS))],
        About(LOOP, "ukf, ekf, observer (output injection), or none (feeds back the true state).",
        "ukf")] = "ukf"
    period: Annotated[Period, About(LOOP, "Sampling period of estimator and law: 0.001 (s) or 1ms.", "1ms",
        "s")] = 1e-3
    process_noise: Annotated[NotNegative | None, About(LOOP,
        "q of R^v = q I, the variance added to every state per sample.", "1e-10")] = None
    torque_noise: Annotated[NotNegative | None, About(LOOP,
        "Variance added to the velocities alone per sample, where unknown torques act.", "1e-7",
        default=f"searched on the running loop with a Kalman filter; {TORQUE_NOISE:g} with the observer")] = None
    measurement_noise: Annotated[Positive, About(LOOP,
        "R^n, the variance of a measured position; the simulated noise has it too.", "1e-8", "rad², m²")] = 1e-8
    saturation: Annotated[PerJoint | None, About(LOOP, "Limit ± of every input, or one per joint 87,87,12.", "24",
        "V, N·m or N", zero=NO_LIMIT, default="the robot's effort limits, or none")] = None
    extras: Annotated[Names, About(LOOP,
        "What the true plant has beside the model: inductance, joint_damping, spring_hardening, backlash, "
        "coulomb_friction, stribeck_friction.", "coulomb_friction")] = ()
    delay: Annotated[Seconds, About(LOOP,
        "Delay of the inputs, a multiple of the period, at most 100,000 samples; the estimator "
        "does not know of it.", "5ms", "s")] = 0.0
    quantisation: Annotated[Quanta, About(LOOP,
        "Step of every measurement, in its unit: 1e-4, or one per name of --measured, or per measured signal, such as "
        "0.01deg,0.1Nm; the estimator does not know of it.", "1e-4", "rad, m, …")] = 0.0
    integral_dead_zone: Annotated[Distances | None, About(LOOP,
        "Errors up to this size are not integrated, against hunting: 1e-3 (rad, m), 0.05deg, or one per joint; "
        "0: none.", "1e-3", "rad, m",
        default="none, or the amplitude of the hunting that dry friction causes")] = None
    load: Annotated[Number | None, About(REPORT, "Torque on every link in the load response.", "1", "N·m or N",
        default="a tenth of what the motors give at the peak input of the step")] = None
    draws: Annotated[Count | None, About(REPORT,
        "Robots within their tolerances that make the step (Monte Carlo samples), at most 100,000; 0: none.", "200",
        default="by the number of states")] = None
    rays: Annotated[Count | None, About(REPORT,
        "Directions along which the region is sampled, at most 100,000; 0: none.", "1000",
        default="by the number of states")] = None
    proof_seconds: Annotated[NotNegative, About(REPORT,
        "CPU time that a proof of the region may take, for a robot of one link; what is not proved by then is sampled. "
        "0: no proof.", "60", "s")] = 20.0
    duration: Annotated[Duration | None, About(REPORT, "Length of the step response.", "5", "s",
        zero="the default", default="by the slowest mode")] = None
    seed: Annotated[Seed, About(REPORT, "Seed of directions, noise and sampled robots.", "0")] = 0
    compare_rigid: Annotated[Flag, About(REPORT,
        "Whether the same is designed on the rigid model too, and run on the elastic robot.", "")] = True
    mujoco: Annotated[Flag, About(REPORT,
        "Whether the step is run on MuJoCo's plant too (needs flexhinf[mujoco]).", "")] = False
    # fmt: on

    def __post_init__(self) -> None:
        for name, (most, why) in MOST.items():
            if (value := getattr(self, name)) is not None and value > most:
                raise _refusal(name, f"expected at most {most:g} ({why}), got {value_text(value)}")
        if self.delay:
            self._check_delay()
        length = 0.0 if self.duration is None else self.duration / self.period
        if length > RUN_SAMPLES:
            raise _refusal(
                "duration",
                f"expected at most {RUN_SAMPLES * self.period:g} s: {self.duration:g} s are {length:.0f} samples",
                f"{self.duration:g}ms",
            )

    def _check_delay(self) -> None:
        from flexhinf.loop.simulation.program import (
            LONGEST_LINEAR,
            WHOLE,
        )  # a tenth of the time of `flexhinf --help`

        samples = self.delay / self.period
        if samples > LONGEST_LINEAR * (1.0 + WHOLE):
            raise _refusal(
                "delay",
                f"expected at most {LONGEST_LINEAR * self.period:g} s, {LONGEST_LINEAR} samples: "
                f"{self.delay:g} s are {samples:.0f} samples",
                f"{self.delay:g}ms",
            )
        if abs(samples - round(samples)) > WHOLE:
            raise _refusal("delay", f"expected a multiple of {self.period:g} s, got {self.delay:g} s")

    @property
    def peak_sensitivity_limit(self) -> float:
        """Largest |S| that is allowed: as stated, or `PEAK_SENSITIVITY`."""
        return PEAK_SENSITIVITY if self.peak_sensitivity is None else self.peak_sensitivity

    @property
    def gain_margin_limit(self) -> float:
        """Smallest gain margin that is allowed, a factor: as stated, or `GAIN_MARGIN`."""
        return GAIN_MARGIN if self.gain_margin is None else self.gain_margin

    @property
    def in_degrees(self) -> bool:
        """Whether the report shows angles in degrees."""
        return self.angle_unit == "deg"


_HINTS = get_type_hints(Specification, include_extras=True)
FIELDS = {field.name: info_of(field, _HINTS[field.name]) for field in dataclasses.fields(Specification)}


# Errors ---------------------------------------------------------------------------------------------
def _checked(make: Any) -> Any:
    """`Specification.__init__` that takes the unit of angles from their texts and raises errors of ours."""

    @functools.wraps(make)
    def init(self: Specification, **fields: Any) -> None:
        if fields.get("angle_unit") is None:
            fields["angle_unit"] = angle_unit_of(
                *(fields.get(name) for name in ("pose", "start", "via", "tracking_error"))
            )
        try:
            make(self, **fields)
            _check_sensor_units(self)
        except ValidationError as error:
            raise _specification_error(error, fields) from None
        except UnicodeEncodeError as error:
            raise InvalidInput(
                "A field of the specification is no text in UTF-8.",
                f"got {value_text(error.object)}",
                "text that can be printed",
            ) from None

    return init


def _check_sensor_units(s: Specification) -> None:
    """Refuse a step in a unit that its kind of sensor does not have; a number without a unit fits every sensor."""
    parts = s.quantisation if isinstance(s.quantisation, tuple) else (s.quantisation,)
    single = len(parts) == len(s.measured)  # otherwise one for all sensors, or one per signal
    for k, part in enumerate(parts):
        sensors = s.measured[k : k + 1] if single else s.measured
        kinds = [_kind_of(name) for name in sensors]
        fitting = all if len(parts) == 1 else any
        if isinstance(part, Stated) and not fitting(part.si in SENSOR_UNITS.get(kind, ()) for kind in kinds):
            raise _refusal(
                "quantisation",
                f"expected a step for each of {list(s.measured)} in its own unit, got '{part.number}{part.unit}' for "
                f"{' and '.join(map(repr, sensors))}",
                ",".join(EXAMPLES.get(k, "1e-4") for k in map(_kind_of, s.measured)),
            )


def _kind_of(name: str) -> str:
    return next((kind for kind in EXAMPLES if kind in name), "")


setattr(Specification, "__init__", _checked(Specification.__init__))  # noqa: B010  pyright


def _specification_error(error: ValidationError, fields: dict[str, Any]) -> InvalidInput:
    first = error.errors(include_url=False)[0]
    own = first.get("ctx", {}).get("error")
    if isinstance(own, (SpecificationError, WaypointError)):
        return own
    name = str(first["loc"][0])
    if name not in FIELDS:
        close = difflib.get_close_matches(name, FIELDS, n=1)
        return SpecificationError(
            name,
            f"A specification has no field {name!r}.",
            f"expected fields out of {list(FIELDS)}, got {name!r}",
            f"{close[0]!r}" if close else "one of these",
        )
    milliseconds = name == "period" and first["type"] == "less_than_equal"
    example = f"{float(fields[name]):g}ms" if milliseconds and str(fields[name]).isnumeric() else ""
    example = own.meant if isinstance(own, Unreadable) and isinstance(fields[name], str) else example
    return _refusal(name, f"expected {FIELDS[name].allowed}, got {value_text(fields[name])}", example)


def _refusal(name: str, found: str, example: str = "") -> SpecificationError:
    example = example or FIELDS[name].about.example
    return SpecificationError(name, f"The {name.replace('_', ' ')} cannot be used.", found, example=example)


def _python(name: str, example: str) -> str:
    """The example of a field as a value in Python."""
    if name not in FIELDS or not example:
        return "True"
    try:
        value = _ADAPTERS(name).validate_python(example)
    except (ValidationError, WaypointError):
        return repr(example)
    text = any(unit in example for unit in ("ms", "deg", "°"))
    return repr(example if text else value)


@functools.cache
def _ADAPTERS(name: str) -> TypeAdapter:
    return TypeAdapter(_HINTS[name])


def json_schema() -> dict[str, Any]:
    """The JSON schema of the table [design] of a design file, without robot and elastic."""
    schema = TypeAdapter(Specification).json_schema()
    for name, field in FIELDS.items():
        about = field.about
        text = f"{about.help} Default: {about.default}." if about.default else about.help
        schema["properties"][name] |= {"description": text} | ({"x-unit": about.unit} if about.unit else {})
    return schema
