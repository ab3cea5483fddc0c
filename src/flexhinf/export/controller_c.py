"""A controller as two files of C99: a header with types and constants, and the source with its step.

The step is the program that `Controller.step` compiles, with the same rules for samples that fail (see
`flexhinf.loop.controller.memory`), and a watchdog for measurements that are late or missing.

Names in C: valid identifiers, names of signals, and text that is safe in a comment.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from importlib.resources import files
from textwrap import wrap
from types import MappingProxyType
from typing import Any

import numpy as np

from flexhinf import __version__
from flexhinf.codegen import (
    Call,
    Cholesky,
    Householder,
    Map,
    OuterSum,
    Polynomial,
    Repeat,
    Residual,
    Sweep,
    When,
)
from flexhinf.codegen.c import Real, Translator, constant
from flexhinf.codegen.program import Step
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.loop import Controller, Status
from flexhinf.loop.controller.memory import SPACING, step_program
from flexhinf.loop.controller.options import holding_function
from flexhinf.plant.joints import standstill_function
from flexhinf.validation import unknown_name, value_text

#: Words of C99 and of C++, and names of their headers: NAME.h must not be found in the place of one.
RESERVED = frozenset({
    "asm", "auto", "bool", "break", "case", "catch", "char", "class", "const", "continue", "default", "delete", "do",
    "double", "else", "enum", "explicit", "export", "extern", "false", "float", "for", "friend", "goto", "if",
    "inline", "int", "long", "main", "mutable", "namespace", "new", "not", "operator", "or", "private", "protected",
    "public", "register", "restrict", "return", "short", "signed", "sizeof", "static", "struct", "switch", "template",
    "this", "throw", "true", "try", "typedef", "typename", "union", "unsigned", "using", "virtual", "void", "volatile",
    "while", "xor",
    "assert", "complex", "ctype", "errno", "fenv", "inttypes", "iso646", "limits", "locale", "math", "memory", "setjmp",
    "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio", "stdlib", "string", "strings", "tgmath", "threads",
    "time", "unistd", "wchar", "wctype",
})  # fmt: skip

LONGEST = 31  # characters that every linker keeps apart


def checked_identifier(name: object) -> str:
    """A name for functions and files.

    Raises InvalidInput: if it is no identifier of C, is reserved, or is too long.
    """
    text = name if isinstance(name, str) else ""
    whole = re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", text) is not None and len(text) <= LONGEST
    refuse_if(
        not whole or text.lower() in RESERVED,
        "This is no name for C.",
        f"expected a letter, then up to {LONGEST - 1} letters, digits and underscores, no word of C and no "
        f"header of its library, got {value_text(name)}",
        identifier_of(text) if text else "my_arm",
    )
    return text


def identifier_of(text: str) -> str:
    """A name for C that looks like the text."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_").lower()[:LONGEST] or "controller"
    if not name[0].isalpha() or name in RESERVED:
        name = f"arm_{name}"[:LONGEST]
    return name


def constants(prefix: str, names: Sequence[str]) -> list[str]:
    """Names of constants for signals, each once: ``ARM_Y_LINK_POSITION``."""
    chosen: list[str] = []
    for k, name in enumerate(names):
        full = f"{prefix}_{re.sub(r'[^A-Z0-9]+', '_', name.upper()).strip('_') or k}"
        chosen.append(full if full not in chosen else f"{full}_{k}")
    return chosen


#: How characters of units and names are written in ASCII.
ASCII = str.maketrans({"·": " ", "²": "^2", "³": "^3", "Ω": "Ohm", "°": "deg", "µ": "u", "−": "-"})


def comment(text: str) -> str:
    """A text made safe for a comment of one line: printable ASCII that neither ends nor continues it."""
    plain = "".join(c if " " <= c <= "~" else "?" for c in text.translate(ASCII))
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").replace("??", "? ?")


#: Columns evaluated at once where the step is composed of loops over the points of a large estimator; a small one gains
#: nothing by it, and a microcontroller has no vectors.
LANES = 8

#: Samples without a measurement that are predicted over before the output is held.
MISSING_LIMIT = 10


#: What a step returns, by the end of its constant's name.
CODES = {
    "OK": (0, "all is well"),
    "BAD_MEASUREMENT": (
        1,
        "without an estimator, a measurement is not finite: nothing changed, the last output is held",
    ),
    "BAD_COMMAND": (2, "a command is not finite: nothing changed, the last output is held"),
    "BAD_RESULT": (3, "a result is not finite: nothing changed, the last output is held"),
    "WENT_BACK": (4, "as BAD_RESULT, again: the memory went back to an earlier one"),
    "PREDICTED": (5, "no measurement in time: the estimate is predicted, the law acts on it"),
    "STOPPED": (6, "too many samples without a measurement: the last output is held"),
    "WAITING": (7, "no measurement yet: nothing changed, the output is that before the first"),
    "NOT_INITIALISED": (8, "the state was not initialised: the output is that before the first"),
    "BAD_ARITHMETIC": (9, "the compiler's flags change results: nothing is computed"),
}


#: Signals of motors, seen from the joint, and what they are at the motor: its signal, divided or multiplied by a ratio.
AT_MOTOR = {
    "motor_position": "motor angle /",
    "motor_velocity": "motor speed /",
    "drive_torque": "motor torque *",
}

#: What is stated of them all.
GEARS = (
    "Angles, speeds and torques of motors are those at the joint, after the gear: the angle of an encoder on a motor "
    "is divided by the gear ratio before it is given, and a torque is divided by it for the motor."
)

#: What the header says before them.
ELEMENTS = "Elements of the arrays below. "

NO_NUMBERS: Mapping[str, float] = MappingProxyType({})


class ControllerCode:
    """The C of a controller; `name` is a C identifier, checked, with which all names begin.

    `sizes`: Numbers in each of y, r, data, memory, u and estimate. `predicts`: Whether there is an estimator, so that
    samples without a measurement can be predicted over. `program`: The step.
    `scratch`: Numbers of working memory, beside "after" and "estimated". `constants`: Numbers of data and first memory.
    `state_bytes`: Memory that the caller gives, but for a few integers. `safe_input`: The input before the first
    sample, (m,). `codes`: Return values of a step, of `CODES`. `signals`: Names of the elements of y, r, u and the
    state. `units`: Units of signals by name, as far as the model of the estimator has them. `belief`: Where the
    estimate begins, (n,), and the robot must be; None without an estimator. `oldest`: Age beyond which a measurement
    counts as missing, s. `robot_numbers`: Those of the robot by name; the units of motors' signals state gear ratios.
    """

    def __init__(
        self, controller: Controller, name: str, real: Real, robot_numbers: Mapping[str, float] = NO_NUMBERS
    ) -> None:
        self.controller, self.name, self.real, self.robot_numbers = controller, name, real, robot_numbers
        c, estimator = controller, controller.estimator
        self.sizes = {
            "y": len(c.measured), "r": max(1, len(c.commanded)), "data": c.data_vector.size, "memory": c.memory.size,
            "u": len(c.law.input_names), "estimate": len(c.estimated),
        }  # fmt: skip
        self.predicts = estimator is not None
        self.program = step_program(self.sizes, bool(c.commanded), c.gaps, c.steps)
        buffers = self.program.buffers
        work = [b.size or 0 for b in buffers if b.role == "work" and b.name not in ("after", "estimated")]
        self.scratch = max(work, default=0)
        self.constants = self.sizes["data"] + self.sizes["memory"]
        own = 5 * self.sizes["memory"] + 2 * self.sizes["estimate"] + 2 * self.sizes["u"]
        self.state_bytes = (own + max(1, self.scratch)) * real.bytes
        self.initial_memory = c.initial_memory()
        self.safe_input = self.initial_memory[c.memory.places["u"]]
        self.codes = {code: row for code, row in CODES.items() if self.predicts or code != "PREDICTED"}
        self.signals = {"Y": c.measured, "R": c.commanded, "U": tuple(c.law.input_names), "X": c.estimated}
        self.units = {} if estimator is None else dict(estimator.plant.units)
        self.belief = None if estimator is None else np.asarray(estimator.initial[0], dtype=float)
        self.oldest = 2.0 * c.period

    @cached_property
    def translator(self) -> Translator:
        """All functions of the step."""
        translator = Translator(
            self.name, self.real, LANES if self.controller.composed and self.real.name == "double" else 1
        )
        translator.add(self.program, "sample")
        return translator

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

    def numbers(self, values: Sequence[float] | np.ndarray, indent: str = "    ") -> str:
        """Constants between commas, some in a line."""
        texts = [constant(float(value), self.real) for value in np.ravel(values)]
        return ",\n".join(indent + ", ".join(texts[k : k + 4]) for k in range(0, len(texts), 4))

    @property
    def files(self) -> dict[str, str]:
        """Header and source by the names of their files."""
        return {f"{self.name}.h": self.header, f"{self.name}.c": self.source}

    @cached_property
    def header(self) -> str:
        """The text of ``NAME.h``."""
        c, sizes = self.controller, self.sizes
        places = [
            (self.upper(f"P_{name.upper()}"), place.start, str(place.stop - place.start))
            for name, place in c.data.places.items()
            if place.stop > place.start
        ]
        signals = []
        for kind, names in self.signals.items():
            texts = [f"{comment(name)}, {self.unit_text(name)}".rstrip(", ") for name in names]
            if kind == "X" and self.belief is not None:
                texts = [f"{text}; begins at {x:.6g}" for text, x in zip(texts, self.belief, strict=True)]
            rows = zip(constants(self.upper(kind), names), range(len(names)), texts, strict=True)
            signals += [enumeration(list(rows))] if names else []
        return fill(
            template("controller.h"), self.name, self.real,
            PERIOD=constant(c.period, self.real), PERIOD_TEXT=f"{c.period:g}", VERSION=__version__,
            SUMMARY="\n * ".join(comment(f"{name}: {text}") for name, text in c.summary().items()),
            LATENCY=c.mode.latency, P=sizes["y"], K=len(c.commanded), M=sizes["u"],
            N=sizes["estimate"], DATA=sizes["data"], MEMORY=sizes["memory"], WORK=max(1, self.scratch), R=sizes["r"],
            REJECTED="" if self.rejected is None else REJECTED_DECLARED,
            SIGNALS="\n".join(signals), OFFSETS=enumeration(places),
            CODES=enumeration([(self.upper(name), *row) for name, row in self.codes.items()]),
            STATUS=enumeration([(self.upper(str(bit.name)), bit.value, text) for bit, text in zip(Status, STATUS)]),
            SETS="about another state" if self.starts_anywhere
            else "the estimate begins where that of @NAME@_init does",
            BEGINS=BEGINS if self.predicts else "the state is what is measured",
            STANDSTILL="" if self.standstill is None else STANDSTILL_DECLARED,
            GAPS=", not finite (NAN) where a sensor gave nothing" if self.predicts else "",
            ELEMENTS="\n * ".join(wrap(ELEMENTS + GEARS * self.has_motors, 112)),
            EDGE="".join(f"{line}\n * " for line in self.edge),
            COMMAND="\n * ".join(wrap(self.command_text, 112)), FIRST=c.first_input.text,
            HELD=c.first_input.text if self.starts_anywhere else "that of @NAME@_init",
        )  # fmt: skip

    @cached_property
    def source(self) -> str:
        """The text of ``NAME.c``."""
        memory = self.controller.memory.places
        start, standstill = self._start, self._standstill  # which may need functions
        functions = str(self.translator).replace(f"{self.real.name} ", "real ")
        return fill(
            template("controller.c"), self.name, self.real,
            START=start, STANDSTILL=standstill, QUEUED=self._queued, VERSION=__version__,
            ARITHMETIC=arithmetic(self.name, self.real),
            DEFAULTS=self.numbers(self.controller.data_vector, "        "),
            OLDEST=constant(self.oldest, self.real), MISSING=MISSING_LIMIT if self.predicts else 0,
            INITIAL=self.numbers(self.initial_memory),
            FUNCTIONS=functions + (PREDICTION if self.predicts else ""), MEASURED=self._call("input->y"),
            PREDICTED=f"{self.name}_predict(state, param, input)" if self.predicts else self.upper("STOPPED"),
            PREDICTED_CALL=self._call("nothing") if self.predicts else "",
            THERE=f" && {self.name}_some(input->y)" if self.predicts else "",
            OR_PREDICTED=f" || code == {self.upper('PREDICTED')}" if self.predicts else "",
            U=memory["u"].start, REFERENCE=memory["reference"].start,
            COMMANDED=memory["reference"].stop - memory["reference"].start, SPACING=SPACING,
            REJECTED="" if self.rejected is None else REJECTED.format(f"state->memory[{self.rejected} + i]"),
            NONE_REJECTED="" if self.rejected is None else REJECTED.format("0").replace("\n", "\n    "),
            STATUS=STATUS_BITS.format(memory["status"].start) if "status" in memory else "",
            PATH_RATE=f"state->memory[{memory['stop'].stop - 1}]" if "stop" in memory else constant(1.0, self.real),
            ZERO=constant(0.0, self.real), F=self.real.suffix, SUFFIX=self.real.suffix.upper(),
        )  # fmt: skip

    @property
    def rejected(self) -> int | None:
        """Where the memory counts the rejected measurements, (p,); None without a gate."""
        estimator = self.controller.estimator
        if estimator is None or "rejected" not in estimator.initial._fields:
            return None
        kept = [np.size(part) for part in estimator.initial]
        place = estimator.initial._fields.index("rejected")
        return self.controller.memory.places["belief"].start + sum(kept[:place])

    @property
    def digest(self) -> str:
        """SHA-256 of header and source, which determine every input that the code computes."""
        return hashlib.sha256((self.header + self.source).encode()).hexdigest()

    def _call(self, measurement: str) -> str:
        places = {"y": measurement, "r": "input->r", "data": "param->value", "scratch": "state->work"}
        arguments = [places.get(b.name, f"state->{b.name}") for b in self.program.buffers]
        return f"{self.name}_sample({', '.join(arguments)})"

    @property
    def _start(self) -> str:
        """Body of ``NAME_start``: sets the estimate, and the input that holds the robot there."""
        if not self.starts_anywhere or self.controller.first_input.is_zero:
            return START.replace("@HOLD@", "") if self.starts_anywhere else "    (void)estimate;"
        assert self.controller.estimator is not None
        plant = self.controller.estimator.plant
        arguments = ["state->start", f"param->value + {self.upper('P_PARAMETERS')}", "held"]
        arguments = arguments if plant.parameters.size else arguments[::2]
        call = f"{self.translator.function(holding_function(plant))}({', '.join(arguments)})"
        return START.replace("@HOLD@", HOLD.replace("@HOLDING@", call))

    @cached_property
    def standstill(self) -> Any:
        """(q, parameters) → the moving command that rests at q, as a CasADi function; None without such a model."""
        estimator = self.controller.estimator
        if estimator is None or not self.controller.mode.moving or not estimator.plant.parameters.size:
            return None
        return standstill_function(estimator.plant)

    @property
    def command_text(self) -> str:
        """What the command is, for header and README."""
        if not self.controller.mode.moving:
            return STANDING if self.controller.commanded else "There is no command."
        later = ", @BIG@_LATENCY periods later" if self.controller.mode.latency else ""
        return MOVING.format(latency=later, resting="" if self.standstill is None else RESTING)

    @property
    def edge(self) -> list[str]:
        """Where a controller that brakes at the edge of its workspace comes to rest, in lines; none for another."""
        c = self.controller
        if c.supervision is None or c.supervision.reactions.get("workspace") != "brake":
            return []
        return wrap(EDGE.format(c.supervision.braking_time / 2.0), 112)

    @property
    def _standstill(self) -> str:
        """``NAME_rest``, whose traced function stands beside it: a firmware may do without both."""
        if self.standstill is None:
            return ""
        traced = self.translator.function(self.standstill)
        text = self.translator.functions.pop(traced).replace(f"{self.real.name} ", "real ")
        return STANDSTILL.replace("@TRACED@", text).replace("@CALL@", traced)

    @property
    def _queued(self) -> str:
        """That the inputs that wait at the start are the one before the first sample too."""
        queue = self.controller.memory.places.get("queue")
        return "" if queue is None else QUEUED.replace("@QUEUE@", str(queue.start))

    @cached_property
    def starts_anywhere(self) -> bool:
        """Whether the belief about another state is the initial one with another mean."""
        estimator = self.controller.estimator
        if estimator is not None:
            with suppress(InvalidInput):
                other = estimator.initial_at(np.asarray(estimator.initial[0], dtype=float) + 1e-3)
                return all(map(np.array_equal, other[1:], estimator.initial[1:]))
        return False


#: What a start assumes.
BEGINS = """the estimate begins at the state that is stated with the constants
 * @BIG@_X_ above. The robot must be there, at rest: the estimator trusts it, and from another place the first inputs
 * may be as large as their limits. Call @NAME@_start where it is elsewhere"""

#: The estimate at the start, where it can be set.
START = """    if (estimate != 0 && @NAME@_finite(estimate, @BIG@_STATES)) {
        @NAME@_copy(estimate, state->start, @BIG@_STATES);
        @NAME@_copy(estimate, state->estimate, @BIG@_STATES);@HOLD@
    }"""

#: Inputs that wait at the start.
QUEUED = """
    for (int i = 0; i < @BIG@_LATENCY * @BIG@_INPUTS; ++i) {
        state->start[@QUEUE@ + i] = state->start[@U@ + i % @BIG@_INPUTS];
    }"""

#: The input that holds it there.
HOLD = """
        if (!same(estimate, initial_memory, @BIG@_STATES)) {
            real held[@BIG@_INPUTS];
            @HOLDING@;
            if (@NAME@_finite(held, @BIG@_INPUTS)) {
                limit(param, held, state->start + @U@);
            }
        }"""

#: What a command is: positions, or a motion; where the model says what rests; and how a workspace is braked at.
STANDING = "input.r are the positions to go to. A jump is a step, and zeros are positions too."
MOVING = (
    "input.r is a motion: the state and the input that the robot has on its way when the output acts{latency}. At rest "
    "it is an equilibrium and the input that holds it, never positions alone: with zeros behind them they are another "
    "motion, the robot swings, and every step returns @BIG@_OK.{resting} On the way positions must not jump, nor their "
    "velocities and accelerations: a quintic in time, for instance. In Python fh.Moving(plan, robot.inverse_dynamics) "
    "gives all these numbers, .state(t) and .input(t), and robot.operating_point(q) those of rest."
)
RESTING = (
    " At link positions q these are q, 0, q + g/K (of each joint the weight g and the spring K), 0, and the input that "
    "holds g: @NAME@_rest computes them."
)
EDGE = (
    "It brakes where a command is outside of the workspace, not before, and at a speed v rests up to v * {:g} s "
    "beyond. Where the workspace ends with the mechanical limits, that is beyond them: keep paths so far inside, or "
    "narrow the box, param.value + @BIG@_P_WORKSPACE: the least positions, then the largest. From outside no way is "
    "braked, further out neither."
)

#: The command that rests; as the header declares it, and its definition.
STANDSTILL_DECLARED = """

/* The command that rests at link positions (q): writes r, whose beginning q may be. Its first @BIG@_STATES numbers are
 * the state, and the others the input, with which @NAME@_start begins there. Returns @BIG@_BAD_COMMAND where r is not
 * finite. Not there with -D@BIG@_WITHOUT_REST. */
int @NAME@_rest(const @NAME@_param *param, const @NAME@_real *q, @NAME@_real *r);"""
STANDSTILL = """

#ifndef @BIG@_WITHOUT_REST
@TRACED@

int @NAME@_rest(const @NAME@_param *param, const @NAME@_real *q, @NAME@_real *r)
{
    @CALL@(q, param->value + @BIG@_P_PARAMETERS, r);
    return @NAME@_finite(r, @BIG@_COMMANDS) ? @BIG@_OK : @BIG@_BAD_COMMAND;
}
#endif"""

#: Bits of the status, whose four numbers are a part of the memory.
STATUS_BITS = """
    for (int i = 0; i < 4; ++i) {{
        output->status |= (state->memory[{} + i] > 0) << i;
    }}"""

#: Counts of rejected measurements, which are a part of the memory.
REJECTED_DECLARED = """
    int rejected[@BIG@_MEASUREMENTS];    /* how often each measurement was rejected as an outlier since the start */"""
REJECTED = """
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {{
        output->rejected[i] = (int){};
    }}"""

#: What these bits say.
STATUS = (
    "the command is outside of the positions that the design is for",
    "an input swings to and fro while the command rests",
    "an input has been at a limit for long",
    "the command is replaced, or the path rate falls",
)

#: Whether something is measured; and the step where nothing is, in which a finite result has a code of its own.
PREDICTION = """
static int @NAME@_some(const real *y)
{
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        if (isfinite(y[i])) {
            return 1;
        }
    }
    return 0;
}

static int @NAME@_predict(@NAME@_state *state, const @NAME@_param *param, const @NAME@_input *input)
{
    real nothing[@BIG@_MEASUREMENTS];
    int code;
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        nothing[i] = HUGE_VAL@SUFFIX@;
    }
    code = @PREDICTED_CALL@;
    return (code == @BIG@_OK) ? @BIG@_PREDICTED : code;
}
"""


def code_of(
    controller: Controller, name: str, real: str, robot_numbers: Mapping[str, float] = NO_NUMBERS
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
    return ControllerCode(controller, checked_identifier(name), Real(real), robot_numbers)


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


def template(name: str) -> str:
    """A text with marks ``@MARK@``."""
    return (files("flexhinf.export") / "templates" / name).read_text(encoding="utf-8")


def arithmetic(name: str, real: Real) -> str:
    """C code against flags that change results: guards, and ``int NAME_exact(void)`` for flags without a macro."""
    about = np.finfo(np.float64 if real.name == "double" else np.float32)
    return fill(
        template("arithmetic.c"), name, real, BYTES=real.bytes, F=real.suffix, SUFFIX=real.suffix.upper(),
        EPSILON=constant(float(about.eps), real), SMALLEST=constant(float(about.tiny), real),
        LARGEST=constant(float(about.max), real),
    )  # fmt: skip


def fill(text: str, name: str, real: Real, **marks: Any) -> str:
    """A template with ``@NAME@`` for the name, ``@BIG@`` for the same in capitals, ``@REAL@`` and other marks."""
    for mark, value in {**marks, "NAME": name, "BIG": name.upper(), "REAL": real.name}.items():
        text = text.replace(f"@{mark}@", str(value))
    return text


def enumeration(rows: Sequence[tuple[str, int, str]]) -> str:
    """Constants with their values and a comment each."""
    lines = [
        f"    {name} = {value}{',' * (k + 1 < len(rows))} /* {text} */"
        for k, (name, value, text) in enumerate(rows)
    ]
    return "\n".join(["enum {", *lines, "};"])
