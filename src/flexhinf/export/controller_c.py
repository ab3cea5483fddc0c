"""A controller as two files of C99: a header with types and constants, and the source with its step.

The step is the program that `Controller.step` compiles, with the same rules for samples that fail (see
`flexhinf.loop.controller.memory`), and a watchdog for measurements that are late or missing.
"""

# Not checked strictly: what a caller passes may be of another type than stated.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, reduce
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from markupsafe import Markup

from flexhinf.codegen import (
    Buffer,
    Call,
    Cholesky,
    Householder,
    Map,
    OuterSum,
    Polynomial,
    Recorder,
    Repeat,
    Residual,
    Slice,
    Sweep,
    When,
)
from flexhinf.codegen.c import Real, Translator, comment, constant, pivot_tolerance
from flexhinf.codegen.c.algebra import SIXTEEN
from flexhinf.codegen.compose import SCRATCH
from flexhinf.codegen.program import Step
from flexhinf.codegen.shared import share
from flexhinf.codegen.stages import staged
from flexhinf.codegen.straight import straightened
from flexhinf.errors import refuse_if
from flexhinf.export.contract import CODES, unlimited_inputs
from flexhinf.export.file_list import File, rendered
from flexhinf.export.names import (
    MEMORY,
    checked_identifier,
    constants,
    default_lines,
    number_lines,
    origin_facts,
)
from flexhinf.export.parameter_check import range_rows, ranges
from flexhinf.export.places import Places
from flexhinf.export.rendering import names_in
from flexhinf.export.stop_code import Coded, StopCode
from flexhinf.loop import Controller, Status
from flexhinf.loop.controller.memory import PAUSES, SPACING, step_program
from flexhinf.loop.controller.options import holding_function
from flexhinf.loop.controller.protection import LOOK
from flexhinf.loop.controller.readings import believed_readings
from flexhinf.loop.controller.signs import PAUSES as TOO_MANY, SIGNS
from flexhinf.loop.controller.starting import standstill_of, starts_anywhere
from flexhinf.loop.controller.status import WATCHED, possible_status
from flexhinf.loop.controller.stop import (
    stop_size,
)
from flexhinf.plant import known, rcond_limit
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot.drives import DRIVES
from flexhinf.scalars import drop_empty, maximum, trace
from flexhinf.stops import STOPS, Stop
from flexhinf.validation import unknown_name

if TYPE_CHECKING:
    import casadi

    from flexhinf.arrays import Elements
    from flexhinf.robot import Robot

#: Columns evaluated at once where the step is composed of loops over the points of a large estimator; a small one gains
#: nothing by it, and a microcontroller has no vectors.
LANES = 8

#: Integers of a state beside those of each measurement, and the bytes of one.
INTEGERS, INTEGER_BYTES = 8, 4

#: Samples without a measurement that are predicted over before the output is held.
MISSING_LIMIT = 10

#: What the bits of a status say, and of one that a controller does not watch.
STATUS = (
    "the command is outside of the positions that the design is for",
    "an input, or a tracked position, swings to and fro while the command rests",
    "an input has been at a limit for long",
    "the command is replaced, or the path rate falls",
    "the estimate is in doubt: rounding may move it by over 0.001 of its standard deviation, or it was repaired",
    "a tracked position is far from its command",
    "something blocks a joint that is far from its command, by more than the model explains; it lets go",
    "the frame of measurements is a repeated one, which counts as missing",
    *(STOPS[name].says for name in SIGNS),
)
NEVER = "always 0 here, not watched"

#: Up to which number int and real of a type count.
MOST_COUNTED = {"double": 2.0**31 - 1.0, "float": 2.0**24}


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
            "y": len(c.measured),
            "r": max(1, len(c.commanded)),
            "data": c.data_vector.size,
            "memory": c.memory.size,
            "u": len(c.law.input_names),
            "estimate": len(c.estimated),
        }
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
        own = 5 * self.sizes["memory"] + 2 * self.sizes["estimate"] + 2 * self.sizes["u"] + 1
        own += stop_size(self.sizes["u"]) + self.sizes["y"]
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
            Real(self.real.name, "real"),
            self.lanes,
            names_in("controller.c", self.name),
            self.places.elements(),
            self.places.long_parts(),
            self.places.constants_of_sizes(),
            ("NOINLINE",),
        )
        names = ("OK", "BAD_MEASUREMENT", "BAD_COMMAND", "BAD_RESULT")
        translator.add(self.program, "sample", {CODES[name].value: self.upper(name) for name in names})
        return translator

    def _steps(self, places: dict[str, Slice | None]) -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
        """Those of the controller, whatever its numbers, its name and its type are."""
        key = "exported", self.controller.code_key, tuple(places.items())
        return share(key, lambda: self._staged_steps(places))

    def _staged_steps(self, places: dict[str, Slice | None]) -> tuple[tuple[Step, ...], tuple[Buffer, ...]]:
        """Those of the controller; one that is a single trace is read in its stages."""
        (*body,), buffers = self.controller.steps(places)
        if not self.controller.composed:
            run = Recorder()
            function = drop_empty(self.controller.traced(run))
            (call,) = (replace(step, stages=run.stages(function)) for step in body if isinstance(step, Call))
            return staged(call, SCRATCH, "y")
        return tuple(body), buffers

    @property
    def operations(self) -> int:
        """Operations of the traced functions of a step, each as often as it is called."""
        return sum(_operations(step) for step in self.program.body)

    def upper(self, what: str) -> str:
        """A constant's name."""
        return f"{self.name.upper()}_{what}"

    def unit_text(self, name: str) -> str:
        """A signal's unit in ASCII, and of a motor's where it is meant, with the gear ratio if the robot states one."""
        unit = self.units.get(name, "")
        kinds = {kind.name: kind.at_motor for kind in SENSORS.values()}
        kinds |= {kind.quantity: kind.at_motor for kind in DRIVES.values()}
        for signal, motor in kinds.items():
            if motor and (name == signal or name.startswith(f"{signal}_")):
                ratio = self.robot_numbers.get("gear_ratio" + name.removeprefix(signal))
                gear = ", after the gear" if ratio is None else f" ({motor} {ratio:.10g})"
                unit = f"{unit} at the joint{gear}".lstrip()
                break
        return comment(unit)

    @property
    def has_motors(self) -> bool:
        """Whether a signal is one of a motor, seen from the joint."""
        return any(
            "at the joint" in self.unit_text(name) for names in self.signals.values() for name in names
        )

    @property
    def unlimited(self) -> list[str]:
        """Inputs that may have any value."""
        return unlimited_inputs(self.controller)

    def numbers(self, values: Sequence[float] | np.ndarray, indent: str = "    ") -> Markup:
        """Constants between commas, some in a line."""
        texts = [constant(float(value), self.real) for value in np.ravel(values)]
        return Markup(",\n".join(indent + ", ".join(texts[k : k + 4]) for k in range(0, len(texts), 4)))

    @property
    def files(self) -> dict[str, str]:
        """Header and source by the names of their files."""
        return self._files(self.digest)

    @property
    def header(self) -> str:
        """The text of ``NAME.h``."""
        return self.files[f"{self.name}.h"]

    @property
    def source(self) -> str:
        """The text of ``NAME.c``."""
        return self.files[f"{self.name}.c"]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of header and source but for itself, which determine every input that the code computes."""
        return hashlib.sha256("".join(self._files(Markup("@DIGEST@")).values()).encode()).hexdigest()

    @property
    def missing(self) -> int:
        """Samples without a measurement that are predicted over."""
        return MISSING_LIMIT if self.predicts else 0

    @cached_property
    def values(self) -> dict[str, object]:
        """What every template about this controller may use."""
        return {
            "code": self,
            "c": self.controller,
            "period_text": f"{self.controller.period:g}",
            "missing": self.missing,
            "stop_size": stop_size(self.sizes["u"]),
            "spacing": SPACING,
            "longest_unseen": self.longest_unseen,
        }

    def _files(self, digest: str) -> dict[str, str]:
        return rendered(SOURCES, self, self.name, self.real, digest=digest, **self.values)

    @property
    def facts(self) -> dict[str, str]:
        """What design it is, and what the controller says of itself."""
        return {**origin_facts(self.controller, self.origin), **self.controller.summary()}

    @cached_property
    def header_values(self) -> dict[str, object]:
        """What ``NAME.h`` says beside."""
        signals: list[list[tuple[str, int, str]]] = []
        for kind, names in self.signals.items():
            texts = [f"{name}, {self.unit_text(name)}".rstrip(", ") for name in names]
            if kind == "X" and self.belief is not None:
                texts = [f"{text}; begins at {x:.6g}" for text, x in zip(texts, self.belief, strict=True)]
            rows = zip(constants(self.upper(kind), names), range(len(names)), texts, strict=True)
            signals += [list(rows)] if names else []
        return {
            "signals": signals,
            "parameters": self.places.parameters(),
            "look": f"{LOOK:g}",
            "checkable": self.stop.is_checkable,
            "stops": [
                (self.upper(f"STOP_{stop.name}"), stop.value, STOPS[str(stop.name).lower()].says)
                for stop in Stop
            ],
            "columns": self.translator.room,
            "sixteen": Markup(SIXTEEN),
            "codes": [(self.upper(name), code.value, code.meaning) for name, code in self.codes.items()],
            "status": [
                (self.upper(str(bit.name)), bit.value, text if bit in self.able else f"{NEVER}: {text}")
                for bit, text in zip(Status, STATUS, strict=True)
            ],
        }

    @cached_property
    def source_values(self) -> dict[str, object]:
        """What ``NAME.c`` consists of beside; its functions come last, as the others may need some of them."""
        memory = self.controller.memory.places
        holding, standstill, plausible = self._held, self._standstill, self._plausible
        return {
            "places": memory,
            "origin": origin_facts(self.controller, self.origin),
            "defaults": Markup(default_lines(self.controller, self.defaults, self.real)),
            "initial": Markup(number_lines(memory, self.initial_memory, self.real, MEMORY)),
            "ranges": ranges(self.controller, self.defaults, self.robot, self.oldest, self.whole_numbers),
            **self.stop.deciding_values,
            "start": self.stop.starting,
            "checkable": self.stop.is_checkable,
            "range_rows": range_rows,
            "most_counted": constant(MOST_COUNTED[self.real.name], self.real),
            "holding": holding,
            "standstill": standstill,
            "plausible": plausible,
            "pause": PAUSES,
            "pauses": TOO_MANY,
            **self._pausing,
            "pairs": len(self.controller.mode.protected.pairs) if self.controller.mode.protected else 0,
            "flags": [self.upper(str(bit.name)) for bit in self.flags],
            "functions": Markup(self.translator),
        }

    @property
    def _pausing(self) -> dict[str, object]:
        """What a long pause of the loop changes, of a controller with a protection."""
        protection = self.controller.protection
        if protection is None:
            return {}
        pausing = protection.pausing(self.controller.period)
        return {"pausing": pausing._replace(free=-pausing.free)}

    @property
    def _plausible(self) -> str:
        """The function that says whether something plausible is measured; "" without limits of measurements."""
        c = self.controller
        if not c.mode.checks_measurements or c.estimator is None:
            return ""
        plant, kind = c.estimator.plant, cast("Callable[..., Any]", type(c.estimator.initial))
        turns = plant.angle_places(plant.outputs)

        def some(y: Elements, memory: Elements, data: Elements) -> Elements:
            kept, d = c.memory.named(memory), c.data.named(data)
            acted = kept.queue[-1] if c.mode.latency else kept.u
            predicted = plant.evaluate_output(kind(*kept.belief).mean, acted, d.parameters)
            limits = d.measurement_lower, d.measurement_upper, d.measurement_rate, d.reading_steps
            found = believed_readings(
                turns, y, predicted, kept.readings, d.period, *limits, d.reading_windows
            )
            return np.array([reduce(maximum, known(found[0]))])

        sizes = self.sizes["y"], self.sizes["memory"], self.sizes["data"]
        return self.translator.function(trace(some, *sizes, name="plausible"))

    @property
    def whole_numbers(self) -> tuple[int, int, int]:
        """How many measurements may be missing in a row, the bits of what stops the robot, and the category of that
        stop."""
        protection = self.controller.protection
        stop_on = tuple(STOPS) if protection is None else protection.stop_on
        bits = sum(Stop[name.upper()] for name in stop_on)
        return self.missing, int(bits), 0 if protection is None else protection.category

    @property
    def longest_unseen(self) -> int:
        """Samples for which one sensor may be missing."""
        protection = self.controller.protection
        return MISSING_LIMIT if protection is None else protection.longest_unseen

    @cached_property
    def stop(self) -> StopCode:
        """What decides whether the output may act."""
        return StopCode(cast("Coded", self))

    @property
    def flags(self) -> tuple[Status, ...]:
        """Bits of the status in the order of their flags in the memory."""
        place = self.controller.memory.places.get("status", slice(0))
        return WATCHED[: place.stop - (place.start or 0)]

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
            numbers[self.controller.data.places["rcond_limit"]] = rcond_limit(self.real.epsilon)
        return numbers

    def call(self, measurement: str) -> Markup:
        """The call of the step, with what is measured."""
        places = {"y": measurement, "r": "input->r", "data": "param->value", "scratch": "state->work"}
        arguments = [places.get(b.name, f"state->{b.name}") for b in self.program.buffers]
        arguments += ["state->columns"] * (self.translator.room > 0)
        return Markup(f"{self.name}_sample({', '.join(arguments)})")

    @property
    def _known(self) -> dict[int, tuple[str, int]]:
        """That a second argument is the model's parameters, within the numbers of the step."""
        return {1: ("data", self.controller.data.places["parameters"].start)}

    @property
    def _held(self) -> str:
        """The call in ``NAME_start`` that writes the input that holds the robot there; "" where that is zero."""
        if not self.starts_anywhere or self.controller.first_input.is_zero:
            return ""
        return self._holding("state->start", "held")

    def _holding(self, state: str, inputs: str) -> Markup:
        """A call that writes the inputs that hold the robot at a state."""
        assert self.controller.estimator is not None
        plant = self.controller.estimator.plant
        known = self._known if plant.parameters.size else {}
        called = self.translator.function(holding_function(plant), "x", *["data"] * len(known), within=known)
        return Markup(f"{called}({state}, {'param->value, ' * len(known)}{inputs})")

    @cached_property
    def standstill(self) -> casadi.Function | None:
        """(q, parameters) → state and input at rest at q, as a CasADi function; None without such a model."""
        return standstill_of(self.controller.estimator)

    @property
    def rests(self) -> bool:
        """Whether the command is a motion, and the model tells one that rests."""
        return self.controller.mode.moving and self.standstill is not None

    @property
    def slows(self) -> bool:
        """Whether the command is a motion that the controller may slow down, and the model tells one that rests."""
        return self.rests and "stop" in self.controller.memory.places

    @property
    def reacts(self) -> bool:
        """Whether the controller does something about the bits of its status."""
        return self.controller.supervision is not None and Status.REACTING in self.able

    @property
    def _standstill(self) -> dict[str, object]:
        """What ``NAME_rest`` and ``NAME_slowed`` consist of; a firmware may do without them and their functions."""
        if self.standstill is None:
            return {}
        before = set(self.translator.functions)
        parts: dict[str, object] = {
            "call": self.translator.function(self.standstill, "q", "data", within=self._known)
        }
        if self.slows:
            parts["is_velocity"] = [str("velocity" in name).lower() for name in self.signals["X"]]
            parts["holding_fast"] = self._holding("r", "held")
            parts["holding_slow"] = self._holding("r", "slower")
        added = [name for name in self.translator.functions if name not in before]
        text = "\n\n".join(self.translator.functions.pop(name) for name in added)
        return parts | {"functions": Markup(text)}

    @cached_property
    def starts_anywhere(self) -> bool:
        """Whether the belief about another state is the initial one with another mean."""
        return starts_anywhere(self.controller.estimator)


#: Header and source of a controller.
SOURCES: tuple[File[ControllerCode], ...] = (
    File("@{name}.h", "controller.h", lambda code: code.header_values),
    File("@{name}.c", "controller.c", lambda code: code.source_values),
)


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
        case Cholesky():
            return step.order**3 // 3
        case _:
            return 0
