"""The specification of a design: every field with its unit, range, default, help and example, declared once.

The options of the command line (`flexhinf.cli.arguments`), the design file (`flexhinf.designs.design_file`), its JSON
schema and the table of options in docs/options.md derive from this class, see `flexhinf.options`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

from flexhinf import options
from flexhinf.designs.requirements.kinds import REQUIREMENTS, limit_fields, reserve
from flexhinf.errors import InvalidInput
from flexhinf.extensions import load_extensions
from flexhinf.notebook import stated_text
from flexhinf.options import (
    ADVANCED,
    LIMITS,
    LOOP,
    NO_LIMIT,
    SEARCH,
    SENSORS,
    UNCERTAIN,
    WAY,
    WRITTEN,
    Allowed,
    FieldInfo,
    declared,
    option,
    read_by,
    refused,
    setting,
    with_parameters,
)
from flexhinf.robot.waypoints import WaypointError, stated_workspace, waypoints
from flexhinf.validation import late_package, nearest, value_text

if TYPE_CHECKING:
    import numpy as np
    import pydantic

    from flexhinf.robot import Robot
else:
    np, pydantic = map(late_package, ("numpy", "pydantic"))

MoveTable = Annotated[
    Any, read_by(waypoints), Allowed("a CSV file with columns time and joints, or such columns by name"),
    options.Marker("WithJsonSchema", {"anyOf": [{"type": "string"}, {"type": "object"}]}),
]  # fmt: skip


Range = Annotated[
    Any, read_by(stated_workspace),
    Allowed("limits, one (low, high) per joint, a box in space, or waypoints"),
    options.Marker("WithJsonSchema", {"anyOf": [{"type": "string"}, {"type": "array"}, {"type": "object"}]}),
]  # fmt: skip

PresetName = Annotated[Literal["paper", "damped", "robust", "proved"], options.CHOICE]
#: The preset by which a law is proved for all tolerances.
PROVED = "proved"

#: The estimator that is chosen by law and sensors.
AUTO = "auto"

#: Estimators by name, in a sentence; `declare_estimator` adds others.
ESTIMATED_BY = {
    "auto": "the one that law and sensors ask for",
    "modal": "the Kalman filter with the gains of each pose",
    "ukf": "the unscented Kalman filter",
    "ekf": "the extended Kalman filter",
    "observer": "the output-injection observer",
    "none": "the true state fed back",
}


def estimator_name(value: Any) -> str:
    """The name of an estimator, in small letters. Raises `InvalidInput` for one that is not known."""
    name = options.choice(value)
    if not isinstance(name, str) or name not in ESTIMATED_BY:
        load_extensions()
    if not isinstance(name, str) or name not in ESTIMATED_BY:
        found = f"expected {', '.join(ESTIMATED_BY)}, got {value_text(value)}"
        raise InvalidInput(refused("estimator"), found, nearest(value, ESTIMATED_BY, AUTO).strip("'"))
    return name


EstimatorName = Annotated[
    str,
    read_by(estimator_name),
    Allowed(", ".join(ESTIMATED_BY)),
    options.Marker("WithJsonSchema", {"type": "string", "enum": [*ESTIMATED_BY]}),
]
LawName = Annotated[str, read_by(options.choice), Allowed("the name of a law"),
    options.Marker("WithJsonSchema", {"type": "string"})]  # fmt: skip
ShapingName = Annotated[Literal["jump", "quintic", "jerk-limited"], options.CHOICE]
AngleUnit = Annotated[Literal["rad", "deg"], options.CHOICE]

#: Default variance of the velocities per sample. With the default R^n the estimator is so fast that a load deflects the
#: link little more than with the true state fed back, see docs/real_loop.md.
TORQUE_NOISE = 1e-7

#: Default latency of a loop with an estimator, samples.
LATENCY = 1


#: An oscillation with a smaller damping ratio than this rings: it takes more than three periods to fall to a tenth.
RINGS = 0.1

#: No design meets its specification with a smaller damping ratio of an oscillation below `damped_below`, rad/s.
#: Faster ones have hardly any amplitude; the models of springs and motors do not hold there.
MIN_DAMPING, DAMPED_BELOW = 0.05, 350.0

#: Largest `damped_below`, as a fraction of half the sampling frequency.
OF_NYQUIST = 1.0 / 3.0

#: Longest run in samples. A longer time was probably meant in ms: such a run takes minutes and adds no information.
RUN_SAMPLES = 1_000_000

#: Upper bounds of fields whose larger values only cost time and memory, with the reasons.
MOST = {
    "draws": (100_000, "more take hours, and the memory of every run"),
    "rays": (100_000, "ascent finds what so many directions miss; more take hours"),
    "latency": (10, "each beyond the first costs a step one more time update of the estimator"),
    "delay_margin": (200, "a linear loop has at most so many samples of delay"),
    "gamma_ratio": (1e6, "from there on the disturbance has no weight in the law, and it no longer changes"),
    "checked_gamma_ratio": (1e6, "from there on the disturbance has no weight in the inequality"),
}


#: Names of fields in earlier versions.
FORMER = {
    "goal": "pose", "from_pose": "start", "friction": "friction_model", "dead_zone": "integral_dead_zone",
    "peak_voltage": "peak_effort", "peak_current": "peak_effort", "peak_torque": "peak_effort",
}  # fmt: skip


class SpecificationError(InvalidInput):
    """A field of a specification that cannot be used.

    Attributes
    ----------
    field : str
        The name of the field; it need not be one of `FIELDS`.
    example : str
        A valid value, as on the command line; "" if the advice is a different one.
    """

    def __init__(self, field: str, what: str, found: str, advice: str = "", example: str = "") -> None:
        self.field, self.example = field, example
        value = "True"
        if field in FIELDS and example:  # as a value in Python
            value = repr(example)
            if not any(unit in example for unit in ("ms", "deg", "°", "mrad")):
                with contextlib.suppress(pydantic.ValidationError, WaypointError):
                    value = repr(FIELDS[field].adapter.validate_python(example))
        super().__init__(what, found, advice or f"{field}={value}")


@dataclass(frozen=True, kw_only=True, repr=False)
class Specification:
    """The requirements on a design. A field that is None is chosen by the rule in its help.

    ``pose`` makes the task one pose and the motion to it; nothing else does. Which laws, estimators and tasks read a
    field `flexhinf.designs.fields` says. ``workspace`` is text as at the command line, one (low, high) in rad or m for
    each joint, a file of waypoints, or their columns as a mapping or a table.

    Every field takes numbers in SI units, or the text that the command line takes: ``pose="90deg"``,
    ``unknown_delay="5ms"``.

    Raises
    ------
    SpecificationError
        For an unknown field and for a value outside its range, with the field, the value and what is allowed.

    Examples
    --------
    >>> import flexhinf as fh
    >>> wanted = fh.Specification(pose="90deg", bandwidth=3.0, overshoot=5.0, measured="motor_position")
    >>> wanted.bandwidth
    3.0
    """

    # fmt: off
    pose: options.Pose | None = option(None, WAY,
        "One pose for which the controller is made, with the motion to it, instead of a workspace: one position per "
        "joint, 30deg,-10deg, or home. A number without a unit is in rad or m.",
        "0.3,-0.5", "rad, m", default="none: the controller is for a workspace")
    workspace: Range | None = option(None, WAY,
        "Where one controller has to work: limits (the joint ranges), or one LOW:HIGH per joint. In space: "
        "x=0.2:0.5,z=0:0.4 (m, for the point of --tool). From a CSV file: poses, with columns as for --move, of which "
        "time may be left out.", "limits", "rad, m",
        default="limits, where no pose is stated")
    law: LawName | None = option(None, WAY,
        "The law: modal, nl-hinf, pid, lqg, pd or another one that flexhinf compare --help lists.", "lqg",
        default="modal; nl-hinf at one pose (--pose)")
    start: options.Pose | None = option(None, WAY, "Position from which the step or the move to the goal starts.",
        "0.2,-0.4", "rad, m", default="0.1 rad (10 mm) from the goal")
    via: options.Poses = option((), ADVANCED,
        "A pose between start and goal at which a law is designed too; repeat the option for several. The "
        "controller takes the law whose pose is nearest to the command.", "0.1,0.2", "rad, m")
    shaping: ShapingName = setting("jump", WAY,
        "How the command gets to the goal: jump (at once), quintic or jerk-limited. The last two are as fast as the "
        "bandwidth and the limits of effort and speed allow, and stop at the waypoints of a move; jump passes through "
        "them. Moves over a workspace are quintic.", "jerk-limited")
    feedforward: options.Flag = setting(True, ADVANCED,
        "Whether a move and a shaped command have the feedforward of the inverse dynamics. Without it a law with "
        "integrals follows the positions alone.")
    move: MoveTable | None = option(None, WAY,
        "A move to follow: a CSV file with columns time and the joints, 'time [s],elbow [deg]'. The loop is judged by "
        "it. Usually its last waypoint is --pose.", "waypoints.csv", "s; rad, m",
        default="the way from start to goal, not judged")
    angle_unit: AngleUnit | None = setting(None, WRITTEN, "Unit of angles in the report: rad or deg.", "deg",
        default="the unit of the poses")
    preset: PresetName | None = option(None, SEARCH,
        "Where the weights come from: paper (the robot's file), damped (searched for bandwidth and damping), "
        "robust (searched on the running loop for its tolerances too), proved (proved for all tolerances). Of one "
        "joint it takes the smallest gain; for a workspace the fastest law.",
        "damped", default="the robot's own weights, or damped where a bandwidth or a damping is required")
    bandwidth: options.Frequencies | None = option(None, LOOP,
        "Least bandwidth: 4 (rad/s), 0.6Hz, or one per joint 4,6. There |command → link position| falls below "
        "1/√2. Weights are searched for it at corners of the tolerances, with the true state; it is judged on the "
        "running loop of the nominal robot.", "4", "rad/s",
        default="0.3 of the lowest vibration with held motors, less where margins of the loop ask for it")
    damping: options.Ratio | None = option(None, LOOP,
        "Least damping ratio of every oscillation, at least 0.05. Those above --set damped_below need only be stable. "
        "Weights are searched for it, and it is judged, as for the bandwidth.", "0.3",
        default="0.2 for a workspace; where weights are searched, 0.2 down to 0.1 where noise at the motors asks for "
        "it; 0.05 otherwise")
    damped_below: options.Frequency | None = setting(None, ADVANCED,
        "Frequency below which every oscillation has to be damped: 350 (rad/s) or 55Hz. It is at most a third of half "
        "the sampling frequency. Faster oscillations have to be stable.", "350", "rad/s",
        default="350 rad/s, or that third")
    peak_effort: options.PerJointEffort | None = option(None, LIMITS,
        "Largest input of every motor: 60, or one per joint 87,87,12. It limits the controller too.", "60",
        "V, A, N·m or N", zero=NO_LIMIT, default="the robot's effort limits, or none")
    peak_speed: options.PerJointSpeed | None = option(None, LIMITS,
        "Largest speed of every link: 2 (rad/s, m/s), 120deg/s, or one per joint 2.2,2.6.", "2",
        "rad/s or m/s", zero=NO_LIMIT, default="the robot's speed limits, or none")
    penalty: options.Weights | None = setting(None, ADVANCED,
        "Weights of h(x): link_position=60,link_position_integral=300, or one per state (integrals last).",
        "link_position=60,link_position_integral=300", default="by the preset")
    effort: options.Efforts | None = setting(None, ADVANCED,
        "R2, the weight of the inputs, one number or one per joint 0.1,0.1,1. A motor's input counts in units of its "
        "limit (--saturation, or the robot's) relative to the largest limit, one without a limit as the strongest.",
        "10", zero="the default", default="the robot's own, or 1")
    gamma_ratio: options.AboveOne = setting(1.5, ADVANCED,
        "γ/γ* of the design, at most 1e6. Preset proved takes the best of 1.3, 1.5 and 2 for 1.5.", "1.5")
    checked_gamma_ratio: options.Positive = setting(1.6, ADVANCED,
        "γ/γ* of the inequality that is checked, at most 1e6.", "1.6")
    checked_penalty: options.Weights | None = setting(None, ADVANCED, "Weights of the inequality that is checked.",
        "link_position=54", default="0.9 times the penalty; the robot's own for all tolerances")
    degrees: options.Degrees | None = option(None, ADVANCED,
        "Degrees of V to compare: 4, or 2,4,6. The cost of the step decides between several.", "2,4",
        default="2, or up to 6 where that saves more than 5 % of the cost of the step")
    disturbances: options.Names | None = setting(None, ADVANCED,
        "Torques that are disturbances of the synthesis: link_torque,motor_torque.", "link_torque",
        default="the command instead, as in the paper")
    command: options.Flag = setting(False, ADVANCED,
        "Whether the command is a disturbance too, beside --set disturbances.")
    friction_model: options.Flag = setting(False, ADVANCED,
        "Whether the estimator's model (ukf, ekf) has the dry friction of the file, smoothed. The feedforward of a "
        "planned move always has it.")
    measured: options.Names = option(("link_position",), SENSORS,
        "The sensors: link_position, motor_position, joint_torque, deflection (motor minus link), link_velocity, "
        "motor_velocity. NAME_JOINT is the sensor of a single joint.", "motor_position",
        default="the sensors of the robot's file, or link_position")
    estimator: EstimatorName = option(AUTO, SENSORS,
        "What estimates the rest: auto (by law and sensors), modal (a Kalman filter with the gains of each pose), ukf, "
        "ekf, observer (output injection), or none (the true state).",
        "ukf")
    period: options.Period = option(1e-3, SENSORS, "Sampling period of the controller: 0.001 (s) or 1ms.", "1ms",
        "s")
    process_noise: options.NotNegative | None = option(None, ADVANCED,
        "q of R^v = q I, the variance added to every state per sample.", "1e-10")
    torque_noise: options.NotNegative | None = option(None, ADVANCED,
        "Variance added to the velocities alone per sample, where unknown torques act.", "1e-7",
        default=f"searched on the running loop with a Kalman filter; {TORQUE_NOISE:g} with the observer")
    measurement_noise: options.Variances = option(1e-8, ADVANCED,
        "Noise of the sensors, rms with a unit: 0.1mrad, or one per name of --measured, or per measured signal: "
        "0.1mrad,0.5Nm. A number without a unit is the variance of an angle, R^n, 1e-8 for 0.1mrad. A length then has "
        "0.01 m² of it, a velocity 1e4 times and a torque stiffness² times that of its position.",
        "0.1mrad", "rad²", default="0.1 mrad rms")
    saturation: options.PerJointEffort | None = option(None, LIMITS,
        "Limit ± of every input, or one per joint 87,87,12.", "24", "V, A, N·m or N", zero=NO_LIMIT,
        default="the robot's effort limits, or none")
    extras: options.Names = option((), UNCERTAIN,
        "What the true robot has and the model has not: inductance, joint_damping, spring_hardening, "
        "stiffness_curve, kinematic_error, torque_ripple, backlash, coulomb_friction, stribeck_friction, "
        "load_friction, drive_torque_limit. It always has the gears, the dry friction, the damping of springs and the "
        "limits of drives that the file states.",
        "inductance")
    latency: options.Count | None = option(None, SENSORS,
        "Samples between a measurement and the effect of its input, at most 10. The estimator predicts over them.",
        "1", "samples", default=f"{LATENCY}, or 0 where the true state is fed back")
    unknown_delay: options.Seconds = option(0.0, UNCERTAIN,
        "Delay of the inputs that the estimator does not know, on top of the latency. It is a multiple of the period, "
        "and at most 200 samples with the latency.", "5ms", "s")
    quantisation: options.Quanta = option(0.0, SENSORS,
        "Resolution of every sensor: 1e-4, or one per name of --measured 0.01deg,0.1Nm, or one per measured signal. "
        "The estimator does not know of it.", "1e-4", "rad, m, …")
    integral_dead_zone: options.Distances | None = setting(None, ADVANCED,
        "Errors up to this size are not integrated, against limit cycles: 1e-3 (rad, m), 0.05deg, or one per joint; "
        "0: none.", "1e-3", "rad, m",
        default="none, or the amplitude of the limit cycle that dry friction causes; in a workspace half the backlash")
    load: options.Number | None = setting(None, SEARCH, "Torque on every link in the load response.", "1", "N·m or N",
        default="a tenth of what the motors give at the peak input of the step")
    draws: options.Count | None = option(None, SEARCH,
        "Number of robots within their tolerances that are tried, at most 100,000; 0: none. Each makes the step, or a "
        "move in the workspace.", "200", default="by the number of states; one for each move in the workspace")
    rays: options.Count | None = setting(None, ADVANCED,
        "Directions along which the region is sampled, at most 100,000; 0: none.", "1000",
        default="by the number of states")
    proof_seconds: options.NotNegative = setting(20.0, ADVANCED,
        "CPU time for a proof of the region, for a robot of one link; 0: no proof. What is not proved by then is "
        "sampled.", "60", "s")
    duration: options.Duration | None = option(None, SEARCH, "Length of the step response.", "5", "s",
        zero="the default", default="by the slowest mode")
    seed: options.Seed = option(0, ADVANCED,
        "Seed of noise, sampled robots, directions, and poses and moves in the workspace.", "0")
    mujoco: options.Flag = option(False, SEARCH,
        "Whether the step is run in MuJoCo too (needs flexhinf[mujoco]).")
    # fmt: on
    #: Limits of requirements that are stated, by the fields of `requirements`; each is an attribute too.
    limits: tuple[tuple[str, object], ...] = ()

    def __post_init__(self) -> None:
        for name, value in self.limits:
            object.__setattr__(self, name, value)
        for name, field in FIELDS.items():
            if (value := getattr(self, name)) is not field.default:
                try:
                    object.__setattr__(self, name, field.read(value))
                except InvalidInput as error:
                    if isinstance(error, WaypointError) or not error.what.startswith(refused(name)):
                        raise
                    raise SpecificationError(name, error.what, error.found, example=error.advice) from None
        limits = ((name, getattr(self, name)) for name in limit_fields())
        object.__setattr__(
            self, "limits", tuple((name, value) for name, value in limits if value is not None)
        )
        for name, (most, why) in MOST.items():
            if (value := getattr(self, name)) is not None and value > most:
                raise _refusal(name, f"expected at most {most:g} ({why}), got {value_text(value)}")
        if self.latency and self.estimator == "none":
            found = f"expected 0 without an estimator, which predicts the state, got {self.latency}"
            raise _refusal("latency", found, "0")
        if self.unknown_delay:
            # Imported late: a tenth of the time of `--help`.
            from flexhinf.loop.simulation.program import LONGEST_LINEAR, WHOLE

            self._check_length("unknown_delay", LONGEST_LINEAR - self.known_latency, 1.0 + WHOLE)
            if abs(self.unknown_delay / self.period - self.unknown_samples) > WHOLE:
                found = f"expected a multiple of {self.period:g} s, got {self.unknown_delay:g} s"
                raise _refusal("unknown_delay", found)
        self._check_length("duration", RUN_SAMPLES)
        most = OF_NYQUIST * np.pi / self.period
        if self.damped_below is not None and self.damped_below > most:
            found = f"expected at most {most:.4g} rad/s, a third of half the sampling rate, got {self.damped_below:g}"
            raise _refusal("damped_below", found, f"{math.floor(most)}")

    def _check_length(self, name: str, most: int, rounding: float = 1.0) -> None:
        time = getattr(self, name) or 0.0
        if time / self.period > most * rounding:
            limit = (
                f"{most * self.period:g} s, {most} samples: {time:g} s are {time / self.period:.0f} samples"
            )
            raise _refusal(name, f"expected at most {limit}", f"{time:g}ms")

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """None, the limit of a requirement that is not stated."""
            if name.startswith("_") or name not in limit_fields():
                raise AttributeError(f"A specification has no field {name!r}.")
            return None

    else:  # the names of limits are known when their files are read

        def __init__(self, **fields: Any) -> None: ...

    def __repr__(self) -> str:
        stated = ((name, stated_text(getattr(self, name)), field.default) for name, field in FIELDS.items())
        texts = (f"{name}={text}" for name, text, default in stated if text != stated_text(default))
        return f"Specification({', '.join(texts)})"

    def limit(self, name: str, default: float | None = None) -> float:
        """The limit of the requirement of this name, as `RequirementKind.number` has it, or another default."""
        kind = REQUIREMENTS[name]
        return kind.number(self) if default is None or kind.stated(self) is not None else default

    def stated_by(self, name: str) -> str:
        """The option that states a field, or "default"."""
        field = FIELDS[name]
        return "default" if getattr(self, name) == field.default else field.option

    @property
    def damped_below_limit(self) -> float:
        """Frequency below which oscillations have to be damped, rad/s: as stated, or `DAMPED_BELOW`."""
        most = OF_NYQUIST * np.pi / self.period
        return min(DAMPED_BELOW, most) if self.damped_below is None else self.damped_below

    @property
    def known_latency(self) -> int:
        """Samples of latency that the estimator knows: as stated, or `LATENCY` where there is one."""
        default = 0 if self.estimator == "none" else LATENCY
        return default if self.latency is None else self.latency

    @property
    def unknown_samples(self) -> int:
        """Samples of delay on top of the latency."""
        return round(self.unknown_delay / self.period)

    @property
    def of_loop(self) -> Specification:
        """A copy without the bandwidth, so that no loop depends on it; unchanged if the bandwidth shapes the
        command."""
        return replace(self, bandwidth=None) if self.shaping == "jump" else self

    @property
    def in_degrees(self) -> bool:
        """Whether the report shows angles in degrees."""
        return self.angle_unit == "deg"

    def shows_degrees(self, robot: Robot) -> bool:
        """Whether the report shows the angles of this robot in degrees: where every joint turns."""
        return self.in_degrees and not any(robot.links.slides)


class Fields(Mapping[str, FieldInfo]):
    """All fields of a specification by name: its own, and among them the limits of requirements.

    The files of requirements are read when a field is not one of its own, and when all are listed.
    """

    #: The field before which the limits stand.
    BEFORE = "penalty"

    def __init__(self, own: dict[str, FieldInfo]) -> None:
        self._own = own

    def __getitem__(self, name: str) -> FieldInfo:
        return self._own[name] if name in self._own else limit_fields()[name]

    def __iter__(self) -> Iterator[str]:
        for name in self._own:
            if name == self.BEFORE:
                yield from limit_fields()
            yield name

    def __len__(self) -> int:
        return len(self._own) + len(limit_fields())

    def change(self, name: str, about: options.About, allowed: str) -> None:
        """Give one of its own fields other texts."""
        self._own[name] = replace(self._own[name], about=about, allowed=allowed)


FIELDS = Fields(declared(Specification))
reserve({*dir(Specification), *(field.name for field in dataclasses.fields(Specification))})


def per_joint(joints: Sequence[str], name: str, value: Any) -> np.ndarray:
    """A number of a field for each joint (n,); SpecificationError for another count of numbers."""
    limits = np.asarray(value, dtype=float)
    if limits.shape not in ((), (1,), (len(joints),)):
        raise SpecificationError(
            name,
            f"The {name.replace('_', ' ')} does not fit the joints.",
            f"expected one number, or one for each of {list(joints)}, got {limits.size}",
            example=",".join(f"{limit:g}" for limit in np.resize(limits, len(joints))),
        )
    return np.array(np.broadcast_to(limits, (len(joints),)))


def declare_estimator(name: str, description: str) -> None:
    """Add the name of an estimator that has a file of its own, with its description in a sentence."""
    ESTIMATED_BY[name] = description
    field = FIELDS["estimator"]
    about = replace(field.about, help=f"{field.about.help} {name}: {description}.")
    FIELDS.change("estimator", about, ", ".join(ESTIMATED_BY))


# Errors ---------------------------------------------------------------------------------------------
def _checked(make: Any) -> Any:
    """`Specification.__init__` that refuses unknown fields and takes the unit of angles from their texts."""

    @functools.wraps(make)
    def init(self: Specification, **fields: Any) -> None:
        own = {name: fields.pop(name) for name in limit_fields() if name in fields}
        fields["limits"] = tuple({**dict(fields.get("limits", ())), **own}.items())
        for name in fields:
            if name not in (*FIELDS, "limits"):
                raise SpecificationError(
                    name, f"A specification has no field {name!r}.",
                    f"expected fields out of {list(FIELDS)}, got {name!r}", nearest(name, FIELDS),
                )  # fmt: skip
        if fields.get("angle_unit") is None:
            texts = (
                (fields | own).get(name) for name in ("pose", "start", "via", "tracking_error", "workspace")
            )
            fields["angle_unit"] = options.angle_unit_of(*texts)
        make(self, **fields)

    return init


class _Late:
    """An attribute of a class that is made when it is read: it names the limits."""

    def __init__(self, make: Callable[[], object]) -> None:
        self._make = make

    def __get__(self, instance: object, owner: type) -> object:
        return self._make()


def _signature(own: inspect.Signature) -> inspect.Signature:
    """The fields as keywords, in their order."""
    kinds = own.parameters
    limit = inspect.Parameter("limit", inspect.Parameter.KEYWORD_ONLY, default=None)
    return own.replace(parameters=[kinds.get(name, limit.replace(name=name)) for name in FIELDS])


for _name, _value in {
    "__doc__": _Late(partial(with_parameters, str(Specification.__doc__), FIELDS)),
    "__signature__": _Late(partial(_signature, inspect.signature(Specification))),
    "__init__": _checked(Specification.__init__),
}.items():
    setattr(Specification, _name, _value)


def _refusal(name: str, found: str, example: str = "") -> SpecificationError:
    example = example or FIELDS[name].about.example
    return SpecificationError(name, refused(name), found, example=example)
