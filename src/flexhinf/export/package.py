"""All files of an exported controller, and where they are written."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf import __version__
from flexhinf.codegen.c import comment, constant, folded
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export.controller_c import GEARS, MISSING_LIMIT, NOTHING, ControllerCode, code_of
from flexhinf.export.filling import fill, template
from flexhinf.export.names import PARTS
from flexhinf.export.recording import Recording, record, with_both_roundings
from flexhinf.export.refusals import check_limits
from flexhinf.export.ros2 import ros2_files
from flexhinf.export.self_test import EVERY, accuracy, contract, reaches_far, vector
from flexhinf.export.stack import stack_text
from flexhinf.files import write_folder
from flexhinf.loop import Controller
from flexhinf.loop.controller.memory import SPACING
from flexhinf.plant.joints import joint_places
from flexhinf.validation import checked_path

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: Files around the controller, of which NAME is its name, and the templates that they are made of.
AROUND = {
    "main.c": "main.c", "Makefile": "Makefile", "CMakeLists.txt": "CMakeLists.txt", "misra.txt": "misra.txt",
    "cortex_m4/board.c": "cortex_m4/board.c", "cortex_m4/board.ld": "cortex_m4/board.ld",
    "cortex_m4/periodic.c": "cortex_m4/periodic.c", "cortex_m4/recorded.c": "cortex_m4/recorded.c",
    "templates/NAME.ino": "sketch.ino", "templates/NAME_freertos.c": "freertos.c",
}  # fmt: skip


def export_c(
    controller: Controller,
    folder: str | os.PathLike[str],
    name: str = "controller",
    real: str = "double",
    force: bool = False,
    robot: Robot | None = None,
    origin: Mapping[str, str] = NOTHING,
    limits: bool = True,
) -> Path:
    """Write a controller as dependency-free C99: header, source, test vector, and further files for firmware.

    Parameters
    ----------
    controller : Controller
        Its memory of past samples is not exported.
    folder : path
        Made if it is not there.
    name : str
        A C identifier: of the two files, and the beginning of every name in them.
    real : {"double", "float"}
        The type of all numbers. In float, code is smaller and faster on a microcontroller, and the estimate has some
        three to five digits.
    force : bool
        Write into a folder that is not empty: files of the same names are replaced, others stay.
    robot : Robot, optional
        Whose name, parameters with units, and gear ratios stand in the header.
    origin : mapping of str to str, optional
        Lines for header and README that say which design this is: ``{"drawing": "A-1234, revision C"}``.
    limits : bool
        Whether every input must have limits; False exports a controller that may ask for any value.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    InvalidInput
        If the name is none for C, the type is unknown, the folder is not empty, an input has no limits, or numbers or
        law do not fit the type.
    Unsupported
        If law or estimator need an operation that has no form in C.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> import tempfile
    >>> controller = fh.Controller(fh.linear_law(fh.paper_arm().problem(), gamma=np.inf), None, 1e-3, 48.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = fh.export_c(controller, f"{folder}/c")
    ...     (written / "controller.h").is_file()
    True
    """
    target, files = checked_folder(folder, force), controller_files(controller, name, real, robot, origin)
    if limits:
        check_limits(controller)
    write_files(target, files)
    return target


def checked_folder(folder: str | os.PathLike[str], force: bool) -> Path:
    """The absolute path of a folder that may be written.

    Raises InvalidInput: if it is a file, or is not empty and `force` is not set.
    """
    path = checked_path("The folder", folder).absolute()
    found, full = f"expected a new or empty folder, got {path}", path.is_dir() and any(path.iterdir())
    refuse_if(path.exists() and not path.is_dir(), "The output is no folder.", found, "another name")
    refuse_if(
        full and not force,
        "The output folder is not empty.",
        found,
        "another folder, or force=True (--force): files of the same names are then replaced",
    )
    return path


def write_files(folder: Path, files: Mapping[str, str | bytes]) -> None:
    """Write all files or none; the folders are made, and other files there stay.

    Raises InvalidInput: if the place cannot be written; then all is as it was.
    """
    contents = {n: text.encode("utf-8") if isinstance(text, str) else text for n, text in files.items()}
    try:
        write_folder(folder, contents)
    except OSError as error:
        raise InvalidInput(
            "The output folder cannot be written; nothing was changed.",
            f"{folder}: {error.strerror or error}",
            "another folder, with room",
        ) from error


def controller_files(
    controller: Controller,
    name: str = "controller",
    real: str = "double",
    robot: Robot | None = None,
    origin: Mapping[str, str] = NOTHING,
    design: Mapping[str, str] = NOTHING,
) -> dict[str, str]:
    """The files of `export_c`: relative path to text; raises as it does. `design`: Files of the design, which go with
    it."""
    code = code_of(controller, name, real, robot, origin)
    run = record(code.controller, exact=np.float32 if real == "float" else np.float64)
    runs = (run,) if real == "float" else with_both_roundings(code.controller, run)
    allowed = accuracy(code, run)
    text, home = _home(code)
    marks = {
        "VERSION": __version__, "PERIOD_US": round(1e6 * code.controller.period), "R": code.sizes["r"],
        "HOME": ", ".join(constant(float(v), code.real) for v in home), "HOME_TEXT": text,
        "FABS": f"fabs{code.real.suffix}", "LONGEST_UNSEEN": MISSING_LIMIT,
    }  # fmt: skip
    return {
        **code.files,
        f"{name}_test.c": vector(code, runs, allowed),
        f"{name}_contract.c": contract(code, run),
        "README.md": _readme(code, run, allowed.text, bool(design)),
        **{path.replace("NAME", name): _around(code, file, marks) for path, file in AROUND.items()},
        **ros2_files(code, home),
        **{f"design/{path}": text for path, text in design.items()},
    }


#: What a program does with a row of a motion that the controller may slow down.
THEN_SLOWED = ", and where that is below 1, @NAME@_slowed"


def _around(code: ControllerCode, file: str, marks: Mapping[str, Any]) -> str:
    """A file around the controller, made of a template; lines of C are folded."""
    text = template(file).replace("@STANDSTILL@", _standstill(code, file)).replace("@MAY_ACT@", MAY_ACT)
    about, statements = _begin_here(code)
    begins = BEGIN_HERE.replace("@BEGINS_HERE@", about).replace("@STATEMENTS@", statements)
    text = text.replace("@BEGIN_HERE@", begins)
    text = text.replace("@THEN_SLOWED@", THEN_SLOWED * code.slows)
    filled = fill(text, code.name, code.real, **marks)
    return folded(filled) if file.endswith((".c", ".ino")) else filled


def _home(code: ControllerCode) -> tuple[str, np.ndarray]:
    """What a command of the templates begins with, in words and as numbers: that of the robot where it starts."""
    c, place = code.controller, code.belief
    if c.mode.moving and code.standstill is None:
        return "A motion", c.operating_reference
    state = np.asarray(c.law.operating_point)[: len(c.states)]
    state = state if place is None else c.estimated_states.own(place)
    if code.rests:
        return "Link positions", state[: code.standstill.size1_in(0)]
    positions = state[[c.law.plant_states.index(name) for name in c.law.tracked]]
    return "Positions", positions if len(positions) else np.zeros(1)


#: The array of the command in the templates.
COMMAND_ARRAYS = {
    "main.c": "input.r", "sketch.ino": "input.r", "cortex_m4/periodic.c": "input.r", "freertos.c": "input.r",
}  # fmt: skip


def _standstill(code: ControllerCode, file: str) -> str:
    """The statement of a template that makes the command rest at `home`."""
    r = COMMAND_ARRAYS.get(file, "")
    if code.rests:
        return f"@NAME@_rest(&@NAME@_defaults, home, {r});"
    return f"for (int i = 0; i < @BIG@_COMMANDS; ++i) {{ {r}[i] = home[i]; }}"


#: What main.c and the templates do about their drives.
BEGIN_HERE = """/* 1 of a recorded robot: its drives are enabled at once, and it is where @NAME@.h says. */
#ifndef @BIG@_ENABLED
#define @BIG@_ENABLED 0
#endif

/* @BEGINS_HERE@ Whether that is done: not before it is measured. */
static int begin_here(@NAME@_input *input, @NAME@_output *output)
{
    const int measured = input->measured;
@STATEMENTS@
    input->measured = 0; /* the input before the first sample */
    (void)@NAME@_step(&state, &@NAME@_defaults, input, output);
    input->measured = measured;
    return 1;
}

/* Whether the drives are enabled and it has begun there; until then, what is computed is not heard. */
static int still_enabled(int enabled, @NAME@_input *input, @NAME@_output *output)
{
    int now = 0;
    if (drives_enabled() != 0) {
        now = (enabled != 0) ? 1 : begin_here(input, output);
    }
    return now;
}
"""

#: How they begin when drives become enabled: at rest where the links are measured, or as it is designed.
HERE = "When the drives become enabled: the robot rests where it is measured, and the command is that."
FROM_LINKS = """    @NAME@_real rest[@BIG@_STATES + @BIG@_INPUTS] = {{0}};
    static const int links[] = {{{links}}}; /* which measurements are the links' positions */
    for (int i = 0; i < {count}; ++i) {{
        rest[i] = input->y[links[i]];
    }}
    if (measured == 0 || @NAME@_rest(&@NAME@_defaults, rest, rest) != @BIG@_OK ||
        @NAME@_start(&state, &@NAME@_defaults, rest, rest + @BIG@_STATES) != @BIG@_OK) {{
        return 0;
    }}
{command}"""
AS_BEFORE = "When the drives become enabled, as at first: the robot must be where @NAME@.h says."
DESIGNED = """    if (begin_with(&state) != @BIG@_OK) {{
        return 0;
    }}
    {command} /* the command until there is another */"""


def _begin_here(code: ControllerCode) -> tuple[str, str]:
    """A sentence and statements of these for drives that become enabled."""
    c, measured = code.controller, list(code.signals["Y"])
    command = _standstill(code, "main.c").replace("input.r", "input->r")
    if code.standstill is None or c.estimator is None:
        return AS_BEFORE, DESIGNED.format(command=command)
    states = c.estimator.plant.states
    links = [states[int(place)] for place in joint_places(c.estimator.plant)[0].tolist()]
    if not set(links) <= set(measured):
        return AS_BEFORE, DESIGNED.format(command=command)
    places = range(code.sizes["r"]) if code.rests else [states.index(name) for name in c.tracked]
    lines = [f"    input->r[{k}] = rest[{place}];" for k, place in enumerate(places)]
    if code.rests:
        lines = ["    for (int i = 0; i < @BIG@_COMMANDS; ++i) {", "        input->r[i] = rest[i];", "    }"]
    numbers = ", ".join(str(measured.index(name)) for name in links)
    return HERE, FROM_LINKS.format(links=numbers, count=len(links), command="\n".join(lines))


#: What the time of a sine depends on, of each type.
ANGLES = {
    "double": "whether an angle is beyond 1e6 rad (1e9 with fused multiply-adds)",
    "float": "in which quarter turn an angle lies, and whether it is beyond 1e4 rad",
}


#: What a step does with a part of the measurements.
SOME = """ Where some elements are NaN and others are not,
the estimate is corrected by the others, and the step returns `@BIG@_OK`."""

#: What a test vector compares.
COMPARED = {
    "double": f"inputs, codes and status, and the estimate of every {EVERY}th",
    "float": f"inputs and codes, and the estimate of every {EVERY}th; the status may depend on rounding",
}

#: What is made of the first measurement where it is not what was expected.
OFFSET = (
    "\nWhat the first measurement differs from that belief is taken for an offset of the sensor, which fades with a "
    "time constant of\n{:g} s. So a wrong belief is not seen at once: a command to the place where the robot really is "
    "is a jump to the\ncontroller, and one to the place where it is believed to be moves the robot as the offset fades."
)

#: How main.c and the templates begin, and what they do about a step.
MAY_ACT = """/* @NAME@_init, unless header and source are of two exports: nothing may act where it does not return
 * @BIG@_OK. The robot must be where @NAME@.h says; where it is elsewhere, call @NAME@_start behind this. */
static int begin_with(@NAME@_state *memory)
{
    return (strcmp(@NAME@_digest, @BIG@_DIGEST) == 0) ? @NAME@_init(memory) : @BIG@_NOT_INITIALISED;
}

/* Samples that a sensor may be without a measurement; more for one that is slower than the step. */
enum { LONGEST_UNSEEN = @LONGEST_UNSEEN@ };

/* Whether the output may act; where other codes than these last, the watchdog brakes. */
static int may_act(int code, const @NAME@_output *output)
{
    int seen = 1;
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        seen = seen && (output->unseen[i] <= LONGEST_UNSEEN || code == @BIG@_WAITING);
    }
    return seen && code != @BIG@_STOPPED && code != @BIG@_WENT_BACK && code != @BIG@_NOT_INITIALISED;
}
"""

#: What a step in double needs.
SLOWLY = (
    "\nOn a processor without double, such as a Cortex-M4F, a step takes some 25 times as long as with "
    "`--real float`."
)

#: The files of a design, among the others.
DESIGN = (
    "| `design/` | the design as it was exported: `design.toml`, whose `verdict` says for where it is and what is "
    "proved; the robot file; `requirements.md` |\n"
)


def _readme(code: ControllerCode, run: Recording, accuracy: str, has_design: bool) -> str:
    c = code.controller
    begins = "Without an estimator the state is what is measured, so the robot may be anywhere."
    if code.predicts:
        start = f"call `{code.name}_start` with its state instead"
        other = start if code.starts_anywhere else "this observer cannot be told of it"
        where = "moves start by default" if c.mode.moving else "the step of the design starts"
        begins = (
            f"`{code.name}_init` believes the robot at rest at the estimate of the last column, where {where}.\nThe "
            "estimator trusts that: from another place the first inputs may be as large as their limits. Where the "
            f"robot is\nelsewhere, {other}; an input that acts already is its other argument."
        )
        if c.offset_time is not None:
            begins += OFFSET.format(c.offset_time)
    arrays = {
        "Y": ("input.y", None), "R": ("input.r", None), "U": ("output.u", code.safe_input),
        "X": ("output.estimate", code.belief),
    }  # fmt: skip
    signals = [
        (f"`{array}`", str(k), comment(name), code.unit_text(name),
         "" if starts is None else f"{starts[k]:.6g}")
        for kind, (array, starts) in arrays.items() for k, name in enumerate(code.signals[kind])
    ]  # fmt: skip
    at_limit = (run.u <= c.limits.lower) | (run.u >= c.limits.upper)
    counts = [int(at_limit[part].any(axis=1).sum()) for part in run.parts]
    reasons = [text.format(count) for count, text in zip(counts, (AT_LIMIT, MOVED_TO_LIMIT)) if count]
    none = f"none: set `{code.upper('P_LOWER')}` and `{code.upper('P_UPPER')}` to what the drives take"
    facts = {
        **code.facts,
        "digest": code.digest,
        "saturation": c.summary().get("saturation", none),
        "type": code.real.name,
        "inputs differ from the simulation's by": accuracy,
        "memory of one controller": f"{code.state_bytes} bytes, given by the caller (`{code.name}_state`)",
        "stack of a step": stack_text(code.files, code.name, code.real.name),
        "constants": f"{code.constants} numbers",
        "arithmetic operations of one step": f"about {code.operations}; `make cortex-m4-contract` counts the most "
        "instructions",
        "from `<math.h>`": ", ".join(sorted(set(MATHEMATICS.findall(code.source)))),
    }
    return fill(
        template("README.md").replace("@EXAMPLE@", _example(code)), code.name, code.real,
        VERSION=__version__, PERIOD_TEXT=f"{c.period:g}", SAMPLES=len(run.u), OLDEST=f"{code.oldest:g}",
        MISSING=MISSING_LIMIT if code.predicts else 0, BEGINS=begins,
        GEARS="\n".join(["", *wrap(GEARS, 118), ""]) if code.has_motors else "",
        COMMAND="\n".join(wrap(code.command_text, 118)),
        STANDSTILL_USE="" if code.standstill is None else STANDSTILL_USE if code.rests else RESTART_USE,
        HOLDING="" if code.standstill is None else ":\n`@NAME@_rest` gives the input that they must leave room for",
        SOME=SOME if code.predicts and code.sizes["y"] > 1 else "",
        SLOWLY=SLOWLY if code.real.name == "double" else "",
        SPACING=SPACING,
        COMPARED=COMPARED[code.real.name],
        STANDS_FAR=", stands at large angles" if reaches_far(code) else "",
        BOTH=" The test vector\nhas both." if code.real.name == "double" else "",
        BELIEVES="\n".join(wrap(code.believes_text, 118)),
        SAYS="\n".join(wrap(code.status_text, 112)), ANGLES=ANGLES[code.real.name],
        DESIGN=DESIGN if has_design else "",
        TOLERANCES="" if code.robot is None else " outside\nthe tolerances of the robot file",
        AT_LIMIT="".join(reasons),
        CODES=_table(
            ("constant", "value", "what happened", "what you do"),
            [(f"`{code.upper(key)}`", str(row.value), *row[1:]) for key, row in code.codes.items()
             if key != "BAD_MEASUREMENT" or not code.predicts],
        ),
        PARAMETERS=_table(
            ("first element", "numbers", "what"),
            [
                (f"`{code.upper(f'P_{part.upper()}')}`", str(place.stop - place.start), PARTS[part])
                for part, place in c.data.places.items()
                if place.stop > place.start
            ],
        ),
        users={
            "MARK": "@DIGEST@",
            "UNLIMITED": "\n".join(["", *wrap(code.unlimited_text, 118)]) if code.unlimited_text else "",
            "FACTS": _table(("", ""), [(key, comment(text)) for key, text in facts.items()]),
            "SIGNALS": _table(("array", "element", "signal", "unit", "at the start"), signals),
        },
    )  # fmt: skip


def _example(code: ControllerCode) -> str:
    """The first lines of C in the README, with the command that the controller takes."""
    c = code.controller
    count, drive = len(c.commanded), "        drive_motors(output.u); /* yours{} */\n"
    if code.rests:
        command = (
            f"@NAME@_rest(&@NAME@_defaults, q, input.r); /* all {count} numbers: rest at link positions q */"
        )
    elif c.mode.moving:
        command = f"read_motion(input.r); /* yours: {count} numbers of one motion, never positions alone */"
    else:
        command = f"read_command(input.r); /* yours: {count} position{'s' * (count > 1)} */" if count else ""
    late = c.mode.latency > 0
    before, after = drive.format(": what the step before gave") * late, drive.format("") * (not late)
    slower = SLOWER_LOOP * code.slows
    return fill(EXAMPLE, code.name, code.real, COMMAND=command, SLOWER=slower, LATE=before, NOW=after)


#: Functions and macros of the mathematical library.
MATHEMATICS = re.compile(
    r"\b((?:sqrt|fabs|copysign|a?sin|a?cos|a?tan|atan2|exp|log|pow|tanh|floor|frexp)f?|is(?:finite|nan))\("
)

#: What that example says of a path.
SLOWER_LOOP = """        /* on a path: output.path_rate periods further, then, where that is below 1,
           @NAME@_slowed(&@NAME@_defaults, output.path_rate, input.r) */
"""

#: The first example of the README.
EXAMPLE = """    static @NAME@_state state;
    @NAME@_input input = {0};
    @NAME@_output output = {0};
    int code;

    if (@NAME@_init(&state) != @BIG@_OK) { refuse(); } /* yours; else it is believed to rest where "Signals" says */
    @COMMAND@
    @NAME@_step(&state, &@NAME@_defaults, &input, &output); /* no measurement yet: the input that holds the robot */
    for (;;) { /* every @PERIOD_TEXT@ s; change input.r to move */
        input.measured = read_sensors(input.y); /* yours; 0 where there is no measurement */
@SLOWER@@LATE@        code = @NAME@_step(&state, &@NAME@_defaults, &input, &output);
@NOW@        watch(code); /* yours: brakes as "What a step returns" says */
    }"""

#: Why a test vector may saturate: before measured positions are moved, and then.
AT_LIMIT = "; in {} of them an input is at its limit, as commands swing faster than a robot should"
MOVED_TO_LIMIT = "; in {} of them an input is at its limit, as measured positions are moved away and back"

#: How a moving command rests, and begins elsewhere.
STANDSTILL_USE = """
    @NAME@_rest(&@NAME@_defaults, q, input.r);    /* rests at link positions q, rad or m */
    @NAME@_start(&state, &@NAME@_defaults, input.r, input.r + @BIG@_STATES);    /* begins there */

Its code is about as large as that of the model; `-D@BIG@_WITHOUT_REST` leaves it out.
`flexhinf run DIR --mujoco --log run.csv` writes a whole move, in columns `reference/…`; a sample needs the row that is
`@BIG@_LATENCY` periods later.
"""

#: How a controller of positions begins elsewhere.
RESTART_USE = """
Where the robot rests at other link positions q, rad or m, this begins there, with the input that holds it:

    @NAME@_real rest[@BIG@_STATES + @BIG@_INPUTS];
    @NAME@_rest(&@NAME@_defaults, q, rest);    /* state and input: motors stand where the springs hold the weight */
    @NAME@_start(&state, &@NAME@_defaults, rest, rest + @BIG@_STATES);
"""


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    return "\n".join(
        f"| {' | '.join(str(cell).replace('|', '/') for cell in line)} |"
        for line in [head, ["---"] * len(head), *rows]
    )
