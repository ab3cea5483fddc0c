"""A controller as two files of C99: a header with types and constants, and the source with its step.

The step is the program that `Controller.step` compiles, with the same rules for samples that fail (see
`flexhinf.loop.controller.memory`), and a watchdog for measurements that are late or missing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, reduce
from textwrap import wrap
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf import __version__
from flexhinf.codegen import (
    Call,
    Cholesky,
    Householder,
    Map,
    OuterSum,
    Polynomial,
    Recorder,
    Repeat,
    Residual,
    Sweep,
    When,
)
from flexhinf.codegen.c import Real, Translator, comment, constant, folded, pivot_tolerance
from flexhinf.codegen.compose import SCRATCH
from flexhinf.codegen.program import Step
from flexhinf.codegen.stages import staged
from flexhinf.codegen.straight import straightened
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export.contract import CODES, unlimited_inputs
from flexhinf.export.filling import arithmetic, fill, template
from flexhinf.export.fragments import (
    ALIGNMENT,
    BEGIN_AGAIN,
    BEGINS,
    BELIEVED_ALL,
    BELIEVED_SOME,
    BITS,
    COUNTED,
    DOUBTFUL,
    DOUBTFUL_DECLARED,
    EDGE,
    FINITE,
    HOLD,
    KNOWN_ESTIMATE,
    MOST_COUNTED,
    MOVING,
    MOVING_FIRST,
    NAMED,
    NEVER,
    NO_ESTIMATE,
    NOT_BELIEVED,
    PLAUSIBLE,
    PLAUSIBLE_TEXT,
    PREDICTION,
    QUEUED,
    REACTED,
    REJECTED,
    REJECTED_DECLARED,
    REPORTED,
    RESTING,
    RESTING_COMMAND,
    RESTING_FIRST,
    ROOM,
    SLOWED,
    SLOWED_DECLARED,
    SLOWED_MOTION,
    SLOWER,
    STANDING,
    STANDSTILL,
    STANDSTILL_DECLARED,
    START,
    STATUS,
    STATUS_BITS,
    STOP_KEPT,
    UNLIMITED,
)
from flexhinf.export.names import (
    MEMORY,
    checked_identifier,
    constants,
    default_lines,
    enumeration,
    number_lines,
    origin_facts,
)
from flexhinf.export.parameter_check import range_rows, ranges
from flexhinf.export.places import Places
from flexhinf.loop import Controller, Status
from flexhinf.loop.controller.measured import plausible
from flexhinf.loop.controller.memory import SPACING, step_program
from flexhinf.loop.controller.options import holding_function
from flexhinf.loop.controller.status import possible_status
from flexhinf.plant import known, rcond_limit
from flexhinf.plant.joints import standstill_function
from flexhinf.scalars import drop_empty, maximum, trace
from flexhinf.validation import unknown_name

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: Columns evaluated at once where the step is composed of loops over the points of a large estimator; a small one gains
#: nothing by it, and a microcontroller has no vectors.
LANES = 8

#: Integers of a state beside those of each measurement, and the bytes of one.
INTEGERS, INTEGER_BYTES = 7, 4

#: Samples without a measurement that are predicted over before the output is held.
MISSING_LIMIT = 10

#: Names of functions, types and numbers of every controller, behind its own.
OWN = frozenset({
    "believed", "check", "defaults", "digest", "exact", "fused", "init", "input", "output", "param", "predict", "real",
    "rest", "sample", "slowed", "some", "start", "state", "step", "type_of_constants", "version",
})  # fmt: skip

#: Signals of motors, seen from the joint, and what they are at the motor: its signal, divided or multiplied by a ratio.
AT_MOTOR = {
    "motor_position": "motor angle /",
    "motor_velocity": "motor speed /",
    "drive_torque": "motor torque *",
    "velocity_command": "command of the motor's speed /",
    "position_command": "command of the motor's angle /",
}
#: What is stated of them all.
GEARS = (
    "Angles, speeds and torques of motors are those at the joint, after the gear: the angle of an encoder on a motor "
    "is divided by the gear ratio before it is given, and a torque is divided by it for the motor."
)

#: What the header says before them.
ELEMENTS = "Elements of the arrays below. "

NOTHING: Mapping[str, str] = MappingProxyType({})


class ControllerCode:
    """The C of a controller; `name` is a C identifier, checked, with which all names begin.

    `sizes`: Numbers in each of y, r, data, memory, u and estimate. `predicts`: Whether there is an estimator, so that
    samples without a measurement can be predicted over. `program`: The step.
    `scratch`: Numbers of working memory, beside "after" and "estimated". `constants`: Numbers of data and first memory.
    `state_bytes`: Memory that the caller gives, at most. `safe_input`: The input before the first
    sample, (m,). `codes`: Return values of a step, of `CODES`. `signals`: Names of the elements of y, r, u and the
    state. `units`: Units of signals by name, as far as the model of the estimator has them. `belief`: Where the
    estimate begins, (n,), and the robot must be; None without an estimator. `oldest`: Age beyond which a measurement
    counts as missing, s. `robot`: Its parameters have units, and the units of motors' signals state its gear ratios.
    `places`: Where numbers of the step lie. `doubt`, `rejected`: As those of the places.
    `origin`: Which design it is, by what each line states, for the header.
    """

    def __init__(
        self,
        controller: Controller,
        name: str,
        real: Real,
        robot: Robot | None = None,
        origin: Mapping[str, str] = NOTHING,
    ) -> None:
        self.controller, self.name, self.real, self.origin = controller, name, real, dict(origin)
        self.robot, self.robot_numbers = robot, {} if robot is None else robot.nominal
        if robot is not None:
            self.origin = {"robot": robot.name, **self.origin}
        c, estimator = controller, controller.estimator
        self.sizes = {
            "y": len(c.measured), "r": max(1, len(c.commanded)), "data": c.data_vector.size, "memory": c.memory.size,
            "u": len(c.law.input_names), "estimate": len(c.estimated),
        }  # fmt: skip
        self.signals = {"Y": c.measured, "R": c.commanded, "U": tuple(c.law.input_names), "X": c.estimated}
        self.predicts = estimator is not None
        self.places = Places(c, name.upper(), self.signals, self.sizes, robot)
        self.doubt, self.rejected = self.places.doubt, self.places.rejected
        self.program = step_program(self.sizes, bool(c.commanded), c.gaps, self._steps, self.places.parts())
        if self.lanes == 1 and c.composed:
            self.program = straightened(self.program, pivot_tolerance(real))
        buffers = self.program.buffers
        work = [b.size or 0 for b in buffers if b.role == "work" and b.name not in ("after", "estimated")]
        self.scratch = max(work, default=0)
        self.constants = self.sizes["data"] + self.sizes["memory"]
        own = 5 * self.sizes["memory"] + 2 * self.sizes["estimate"] + 2 * self.sizes["u"]
        numbers = (own + max(1, self.scratch) + self.translator.room) * real.bytes
        integers = INTEGER_BYTES * (INTEGERS + self.sizes["y"])
        self.state_bytes = -(-(numbers + integers) // real.bytes) * real.bytes
        if self.lanes > 1 and self.translator.room:
            self.state_bytes = -(-(self.state_bytes + 8) // 16) * 16
        self.initial_memory = c.initial_memory()
        self.safe_input = self.initial_memory[c.memory.places["u"]]
        self.codes = {code: row for code, row in CODES.items() if self.predicts or code != "PREDICTED"}
        self.units = {} if estimator is None else dict(estimator.plant.units)
        self.belief = None if estimator is None else np.asarray(estimator.initial[0], dtype=float)
        self.oldest = 2.0 * c.period

    @property
    def lanes(self) -> int:
        """Columns of a matrix side by side."""
        return LANES if self.controller.composed and self.real.name == "double" else 1

    @cached_property
    def translator(self) -> Translator:
        """All functions of the step."""
        translator = Translator(
            self.name,
            self.real,
            self.lanes,
            OWN,
            self.places.elements(),
            self.places.long_parts(),
            self.places.constants_of_sizes(),
        )
        names = ("OK", "BAD_MEASUREMENT", "BAD_COMMAND", "BAD_RESULT")
        translator.add(self.program, "sample", {CODES[name].value: self.upper(name) for name in names})
        return translator

    def _steps(self, places: Any) -> Any:
        """Those of the controller; one that is a single trace is read in its stages."""
        (*body,), buffers = self.controller.steps(places)
        if not self.controller.composed:
            run = Recorder()
            function = drop_empty(self.controller.traced(run))
            (call,) = (replace(step, stages=run.stages(function)) for step in body if isinstance(step, Call))
            return staged(call, SCRATCH, "y")
        return body, buffers

    @property
    def operations(self) -> int:
        """Operations of the traced functions of a step, each as often as it is called."""
        return sum(_operations(step) for step in self.program.body)

    def upper(self, what: str) -> str:
        """A constant's name."""
        return f"{self.name.upper()}_{what}"

    def unit_text(self, name: str) -> str:
        """A signal's unit, and of a motor's where it is meant, with the gear ratio if the robot states one."""
        unit = self.units.get(name, "")
        for signal, motor in AT_MOTOR.items():
            if name == signal or name.startswith(f"{signal}_"):
                ratio = self.robot_numbers.get("gear_ratio" + name.removeprefix(signal))
                place = (
                    "at the joint, after the gear"
                    if ratio is None
                    else f"at the joint ({motor} {ratio:.10g})"
                )
                return comment(f"{unit} {place}".lstrip())
        return comment(unit)

    @property
    def has_motors(self) -> bool:
        """Whether a signal is one of a motor, seen from the joint."""
        return any(
            "at the joint" in self.unit_text(name) for names in self.signals.values() for name in names
        )

    @property
    def unlimited_text(self) -> str:
        """Which inputs may have any value, for header and README."""
        free = unlimited_inputs(self.controller)
        return UNLIMITED.format(comment(", ".join(free))) if free else ""

    def numbers(self, values: Sequence[float] | np.ndarray, indent: str = "    ") -> str:
        """Constants between commas, some in a line."""
        texts = [constant(float(value), self.real) for value in np.ravel(values)]
        return ",\n".join(indent + ", ".join(texts[k : k + 4]) for k in range(0, len(texts), 4))

    @property
    def files(self) -> dict[str, str]:
        """Header and source by the names of their files."""
        return {f"{self.name}.h": self.header, f"{self.name}.c": self.source}

    @property
    def header(self) -> str:
        """The text of ``NAME.h``."""
        return self._filled(self._header, self.digest)

    @property
    def source(self) -> str:
        """The text of ``NAME.c``."""
        return self._filled(self._source, self.digest)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of header and source but for itself, which determine every input that the code computes."""
        texts = (self._filled(text, "@DIGEST@") for text in (self._header, self._source))
        return hashlib.sha256("".join(texts).encode()).hexdigest()

    def _filled(self, text: tuple[str, dict[str, str]], digest: str) -> str:
        """A text with what users wrote in it."""
        return folded(fill(text[0], self.name, self.real, {**text[1], "DIGEST": digest}))

    @property
    def facts(self) -> dict[str, str]:
        """What design it is, and what the controller says of itself."""
        return {**origin_facts(self.controller, self.origin), **self.controller.summary()}

    def _comment(self, facts: Mapping[str, str]) -> str:
        """Facts as lines of a comment, each in lines of its own."""
        return "\n * ".join(
            "\n *   ".join(wrap(comment(f"{name}: {text}"), 112, break_on_hyphens=False))
            for name, text in facts.items()
        )

    @cached_property
    def _header(self) -> tuple[str, dict[str, str]]:
        """The text of ``NAME.h`` before texts of users stand in it, and these by their marks."""
        c, sizes = self.controller, self.sizes
        parameters = self.places.parameters()
        signals = []
        for kind, names in self.signals.items():
            texts = [f"{comment(name)}, {self.unit_text(name)}".rstrip(", ") for name in names]
            if kind == "X" and self.belief is not None:
                texts = [f"{text}; begins at {x:.6g}" for text, x in zip(texts, self.belief, strict=True)]
            rows = zip(constants(self.upper(kind), names), range(len(names)), texts, strict=True)
            signals += [enumeration(list(rows))] if names else []
        text = fill(
            template("controller.h"), self.name, self.real,
            PERIOD=constant(c.period, self.real), PERIOD_TEXT=f"{c.period:g}", VERSION=__version__,
            FIRST_LINES=self.first_lines,
            LATENCY=c.mode.latency, P=sizes["y"], K=len(c.commanded), M=sizes["u"],
            N=sizes["estimate"], DATA=sizes["data"], MEMORY=sizes["memory"], WORK=max(1, self.scratch), R=sizes["r"],
            COLUMNS=f",\n    {self.upper('COLUMNS')} = {self.translator.room}" if self.translator.room else "",
            ROOM=(ALIGNMENT * (self.lanes > 1) + ROOM) if self.translator.room else "",
            REJECTED="" if self.rejected is None else REJECTED_DECLARED,
            DOUBTFUL=DOUBTFUL_DECLARED if self.doubt is not None else "",
            CODES=enumeration([(self.upper(name), code.value, code.meaning) for name, code in self.codes.items()]),
            STATUS=enumeration([
                (self.upper(str(bit.name)), bit.value, text if bit in self.able else f"{NEVER}: {text}")
                for bit, text in zip(Status, STATUS)
            ]),
            SETS="about another state" if self.starts_anywhere
            else "the estimate begins where that of @NAME@_init does",
            BEGINS=BEGINS if self.predicts else "the state is what is measured",
            STANDSTILL="" if self.standstill is None else STANDSTILL_DECLARED.format(RESTING_COMMAND * self.rests)
            + SLOWED_DECLARED * self.slows,
            PLAUSIBLE=PLAUSIBLE_TEXT if c.mode.checks_measurements else "",
            GAPS=", not finite (NAN) where a sensor gave nothing" if self.predicts else "",
            ELEMENTS="\n * ".join(wrap(ELEMENTS + GEARS * self.has_motors, 112)),
            SAYS="\n * ".join(wrap(self.status_text, 112)),
            COMMAND="\n * ".join(wrap(self.command_text, 112)), FIRST=c.first_input.text,
            TOLERANCES="" if self.robot is None else " outside the tolerances of the robot file",
            BITS=BITS[self.real.name],
            HELD=c.first_input.text if self.starts_anywhere else "that of @NAME@_init",
        )  # fmt: skip
        return text, {
            "SUMMARY": self._comment(self.facts), "SIGNALS": "\n".join(signals),
            "OFFSETS": enumeration(self.places.numbers()),
            "NAMED": "" if not parameters else NAMED + enumeration(parameters),
            "UNLIMITED": "".join(f"\n * {line}" for line in wrap(self.unlimited_text, 112)),
        }  # fmt: skip

    @cached_property
    def _source(self) -> tuple[str, dict[str, str]]:
        """The text of ``NAME.c`` before texts of users stand in it, and these by their marks."""
        memory = self.controller.memory.places
        start, standstill, believed = self._start, self._standstill, self._plausible  # may need functions
        missing = MISSING_LIMIT if self.predicts else 0
        rows = ranges(self.controller, self.defaults, self.robot, self.oldest, missing)
        functions = str(self.translator).replace(f"{self.real.name} ", "real ")
        text = fill(
            template("controller.c"), self.name, self.real,
            START=start, STANDSTILL=standstill, QUEUED=self._queued, VERSION=__version__,
            ARITHMETIC=arithmetic(self.name, self.real),
            OLDEST=constant(self.oldest, self.real), MISSING=missing,
            INITIAL=number_lines(memory, self.initial_memory, self.real, MEMORY),
            FUNCTIONS=functions + (PREDICTION if self.predicts else ""), MEASURED=self._call("input->y"),
            PREDICTED=f"{self.name}_predict(state, param, input@IN_TIME@)" if self.predicts else self.upper("STOPPED"),
            IN_TIME=", in_time" if believed else "", ALSO_IN_TIME=", int in_time" if believed else "",
            NOTHING=NOT_BELIEVED if believed else constant(np.inf, self.real),
            PREDICTED_CALL=self._call("nothing") if self.predicts else "",
            THERE=f" && {self.name}_some(input->y) != 0" if self.predicts else "",
            BELIEVED=f" && {self.name}_believed(state, param, input->y) != 0" if believed else "", PLAUSIBLE=believed,
            OR_PREDICTED=f" || code == {self.upper('PREDICTED')}" if self.predicts else "",
            COMMANDED=memory["reference"].stop - memory["reference"].start, SPACING=SPACING,
            REJECTED="" if self.rejected is None else REJECTED.format("counted(state->memory[AT_REJECTED + i])"),
            NONE_REJECTED="" if self.rejected is None else REJECTED.format("0").replace("\n", "\n    "),
            DOUBTFUL="" if self.doubt is None else DOUBTFUL,
            NONE_DOUBTFUL="" if self.doubt is None else "\n        output->doubtful = 0;",
            COUNTED="" if self.rejected is None and self.doubt is None else COUNTED,
            MOST=constant(MOST_COUNTED[self.real.name], self.real),
            STATUS=STATUS_BITS if "status" in memory else "", FINITE=FINITE if self.unlimited_text else "",
            PATH_RATE=SLOWED if "stop" in memory else "@UNITY@",
            STOP_KEPT=STOP_KEPT if "stop" in memory else "",
            UNITY=constant(1.0, self.real),
            FIRST_ESTIMATE=KNOWN_ESTIMATE if self.starts_anywhere else NO_ESTIMATE,
            RANGES=range_rows(rows, self.real), COUNT=len(rows),
            ZERO=constant(0.0, self.real), F=self.real.suffix, SUFFIX=self.real.suffix.upper(), BYTES=self.real.bytes,
        )  # fmt: skip
        return text, {
            "SUMMARY": self._comment(origin_facts(self.controller, self.origin)),
            "DEFAULTS": default_lines(self.controller, self.defaults, self.real),
            "PLACES": enumeration(self.places.memory()),
        }

    @property
    def _plausible(self) -> str:
        """C that says whether something plausible is measured; "" without limits of measurements."""
        c, p = self.controller, self.sizes["y"]
        if not c.mode.checks_measurements or c.estimator is None:
            return ""
        turns = c.estimator.plant.angle_places(c.estimator.plant.outputs)

        def some(y: Any, seen: Any, *limits: Any) -> Any:
            return np.array([reduce(maximum, known(plausible(turns, y, seen.reshape(3, p), *limits)[0]))])

        call = self.translator.function(trace(some, p, 3 * p, 1, p, p, p, name="plausible"))
        parts = ("PERIOD", "MEASUREMENT_LOWER", "MEASUREMENT_UPPER", "MEASUREMENT_RATE")
        limits = ", ".join(f"param->value + {self.upper(f'P_{part}')}" for part in parts)
        return PLAUSIBLE.replace("@CALL@", call).replace("@LIMITS@", limits)

    @property
    def able(self) -> Status:
        """Bits of the status that this controller can set."""
        c = self.controller
        return possible_status(c.supervision, c.watched, c.limits, self.doubt is not None, c.mode)

    @property
    def defaults(self) -> np.ndarray:
        """Numbers of the step; what counts as lost digits is that of the type."""
        numbers = np.array(self.controller.data_vector)
        if self.doubt is not None:
            eps = np.finfo(np.float64 if self.real.name == "double" else np.float32).eps
            numbers[self.controller.data.places["rcond_limit"]] = rcond_limit(float(eps))
        return numbers

    def _call(self, measurement: str) -> str:
        places = {"y": measurement, "r": "input->r", "data": "param->value", "scratch": "state->work"}
        arguments = [places.get(b.name, f"state->{b.name}") for b in self.program.buffers]
        arguments += ["state->columns"] * (self.translator.room > 0)
        return f"{self.name}_sample({', '.join(arguments)})"

    @property
    def _known(self) -> dict[int, tuple[str, int]]:
        """That a second argument is the model's parameters, within the numbers of the step."""
        return {1: ("data", self.controller.data.places["parameters"].start)}

    @property
    def _start(self) -> str:
        """Body of ``NAME_start``: sets the estimate, and the input that holds the robot there."""
        if not self.starts_anywhere or self.controller.first_input.is_zero:
            return START.replace("@HOLD@", "") if self.starts_anywhere else "    (void)estimate;"
        return START.replace("@HOLD@", HOLD.replace("@HOLDING@", self._holding("state->start", "held")))

    def _holding(self, state: str, inputs: str) -> str:
        """A call that writes the inputs that hold the robot at a state."""
        assert self.controller.estimator is not None
        plant = self.controller.estimator.plant
        known = self._known if plant.parameters.size else {}
        called = self.translator.function(holding_function(plant), "x", *["data"] * len(known), within=known)
        return f"{called}({state}, {'param->value, ' * len(known)}{inputs})"

    @cached_property
    def standstill(self) -> Any:
        """(q, parameters) → state and input at rest at q, as a CasADi function; None without such a model."""
        estimator = self.controller.estimator
        if estimator is None or not self.starts_anywhere or not estimator.plant.parameters.size:
            return None
        return standstill_function(estimator.plant)

    @property
    def rests(self) -> bool:
        """Whether the command is a motion, and the model tells one that rests."""
        return self.controller.mode.moving and self.standstill is not None

    @property
    def slows(self) -> bool:
        """Whether the command is a motion that the controller may slow down, and the model tells one that rests."""
        return self.rests and "stop" in self.controller.memory.places

    @property
    def command_text(self) -> str:
        """What the command is, for header and README."""
        if not self.controller.mode.moving:
            return STANDING if self.controller.commanded else "There is no command."
        later = ", @BIG@_LATENCY periods later" if self.controller.mode.latency else ""
        return MOVING.format(latency=later, resting="" if self.standstill is None else RESTING)

    @property
    def first_lines(self) -> str:
        """The header's first lines, where a command of positions alone would be wrong."""
        if not self.controller.mode.moving:
            return ""
        text = MOVING_FIRST.format(
            len(self.controller.commanded), "" if self.standstill is None else RESTING_FIRST
        )
        return "".join(f" * {line}\n" for line in [*wrap(text, 112), ""]).replace(" * \n", " *\n")

    @property
    def believes_text(self) -> str:
        """Which measurements the controller believes, for the README."""
        checks = self.controller.mode.checks_measurements
        return BELIEVED_SOME if checks or self.rejected is not None else BELIEVED_ALL

    @property
    def status_text(self) -> str:
        """What the controller does about the bits of its status, for header and README."""
        supervision = self.controller.supervision
        if supervision is None or Status.REACTING not in self.able:
            return REPORTED
        brakes = supervision.reactions.get("workspace") == "brake"
        edge = EDGE.format(supervision.braking_time / 2.0) * brakes
        return REACTED + SLOWER * self.slows + edge + BEGIN_AGAIN

    @property
    def _standstill(self) -> str:
        """``NAME_rest``, whose traced function stands beside it: a firmware may do without both."""
        if self.standstill is None:
            return ""
        before = set(self.translator.functions)
        traced = self.translator.function(self.standstill, "q", "data", within=self._known)
        slower = {}
        if self.slows:
            slower["IS_VELOCITY"] = ", ".join(str("velocity" in name).lower() for name in self.signals["X"])
            slower |= {
                "HOLDING_FAST": self._holding("r", "held"),
                "HOLDING_SLOW": self._holding("r", "slower"),
            }
        added = [name for name in self.translator.functions if name not in before]
        texts = [self.translator.functions.pop(name) for name in added]
        text = "\n\n".join(texts).replace(f"{self.real.name} ", "real ")
        slowed = SLOWED_MOTION * self.slows
        return fill(STANDSTILL, self.name, self.real, TRACED=text, CALL=traced, SLOWED=slowed, **slower)

    @property
    def _queued(self) -> str:
        """That the inputs that wait at the start are the one before the first sample too."""
        if "queue" not in self.controller.memory.places:
            return ""
        return QUEUED.replace("@WHICH@", " + i % @BIG@_INPUTS" if self.sizes["u"] > 1 else "")

    @cached_property
    def starts_anywhere(self) -> bool:
        """Whether the belief about another state is the initial one with another mean."""
        estimator = self.controller.estimator
        if estimator is not None:
            with suppress(InvalidInput):
                other = estimator.initial_at(np.asarray(estimator.initial[0], dtype=float) + 1e-3)
                return all(map(np.array_equal, other[1:], estimator.initial[1:]))
        return False


def code_of(
    controller: Controller,
    name: str,
    real: str,
    robot: Robot | None = None,
    origin: Mapping[str, str] = NOTHING,
) -> ControllerCode:
    """The code of a controller in a type, checked."""
    if real not in ("double", "float"):
        raise unknown_name("There is no such type of numbers.", real, ("double", "float"), "double")
    refuse_if(
        not isinstance(controller, Controller),
        "There is no controller to export.",
        f"expected a flexhinf.Controller, got {type(controller).__name__}",
        "design(...).controller(), or load_controller(file)",
    )
    if real == "float":  # for a microcontroller: less code counts more than the simulation's own bits
        controller = controller.in_pieces()
    return ControllerCode(controller, checked_identifier(name), Real(real), robot, origin)


def _operations(step: Step) -> int:
    """Operations of one step of a program: instructions of its function, or multiplications of its sums."""
    match step:
        case Repeat() | Sweep() | When():
            # a guard, as a call below, runs at most once
            return int(getattr(step, "count", 1)) * sum(map(_operations, step.body))
        case Call() | Map():
            return getattr(step, "count", 1) * step.function.n_instructions()
        case OuterSum():
            return step.count * step.target.size
        case Polynomial():
            return step.rows * step.columns
        case Householder():
            return 2 * step.count * step.source.size
        case Residual():
            return 10 * step.target.size * step.shape[1]
    return step.order**3 // 3 if isinstance(step, Cholesky) else 0
