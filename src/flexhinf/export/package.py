"""All files of an exported controller, and where they are written.

Its test vector is a recorded run of the controller: measurements, commands and outputs of every sample. The C code must
give the same.
"""

from __future__ import annotations

import math
import os
import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf import __version__
from flexhinf.codegen.c import comment, constant
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.export.compiled import build, compiler_flags
from flexhinf.export.controller_c import (
    GEARS,
    MISSING_LIMIT,
    NOTHING,
    ControllerCode,
    code_of,
    fill,
    template,
)
from flexhinf.export.names import PARTS
from flexhinf.export.refusals import check_limits
from flexhinf.export.ros2 import ros2_files
from flexhinf.export.stack import stack_text
from flexhinf.files import write_file
from flexhinf.loop import Controller, Loop, Samples
from flexhinf.loop.controller.options import equilibrium_line
from flexhinf.validation import checked_path

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: Largest error of the test vector relative to an input's largest value: in double of the C library's functions, where
#: they are called; in float of covariances and gains of 24 bits: 1e-6 to 2 % were seen, so it is measured where a C
#: compiler is at hand, and a controller beyond this is refused.
TOLERANCE = {"double": 1e-9, "float": 5e-2}

#: What a test vector in float allows: this many times what was measured, as other processors round otherwise.
SPARE, MIN_TOLERANCE = 5.0, 1e-5

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
    """Write every file whole or not at all; the folders are made."""
    for name, content in files.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidInput(
                "The output folder cannot be made.",
                f"{path.parent}: {error.strerror or error}",
                "another folder",
            ) from error
        data = content.encode("utf-8") if isinstance(content, str) else content
        write_file(path, "exported file", lambda part, data=data: Path(part).write_bytes(data))


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
    allowed, accuracy = _accuracy(code, run)
    text, home = _home(code)
    marks = {
        "VERSION": __version__, "PERIOD_US": round(1e6 * code.controller.period), "R": code.sizes["r"],
        "HOME": ", ".join(constant(float(v), code.real) for v in home), "HOME_TEXT": text,
        "FABS": f"fabs{code.real.suffix}", "MISSING": _missing(code),
    }  # fmt: skip
    return {
        **code.files,
        f"{name}_test.c": _test(code, runs, allowed),
        "README.md": _readme(code, run, accuracy, bool(design)),
        **{
            path.replace("NAME", name): fill(
                template(file).replace("@STANDSTILL@", _standstill(code, file)), name, code.real, **marks
            )
            for path, file in AROUND.items()
        },
        **ros2_files(code, home),
        **{f"design/{path}": text for path, text in design.items()},
    }


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
    "main.c": "input.r", "sketch.ino": "r", "cortex_m4/periodic.c": "input.r", "freertos.c": "input.r",
}  # fmt: skip


def _standstill(code: ControllerCode, file: str) -> str:
    """The statement of a template that makes the command rest at `home`."""
    r = COMMAND_ARRAYS.get(file, "")
    if code.rests:
        return f"@NAME@_rest(&@NAME@_defaults, home, {r});"
    return f"for (int i = 0; i < @BIG@_COMMANDS; ++i) {{ {r}[i] = home[i]; }}"


def _accuracy(code: ControllerCode, run: Recording) -> tuple[float, str]:
    """Largest error that the test vector allows, relative to each input's largest value, and a text for the README.

    In float it is measured with this machine's C compiler, if there is one. Raises InvalidInput if more is lost than a
    test vector may allow.
    """
    most, plainly = TOLERANCE[code.real.name], (f"-D{code.upper('PLAIN')}",)
    if code.real.name == "double":
        same = f"nothing, if {code.name}_fused is 1 in a simulation with fused multiply-adds, and else in one without"
        called = f"{same}, but for the C library's functions: the test vector allows {most:.0e}"
        return (most, called) if code.translator.calls_library else (0.0, same)
    fused, plain = (_measured_error(code, run, flags) for flags in (compiler_flags("portable"), plainly))
    vector = "the test vector allows"
    if fused is None or plain is None:
        return most, f"not measured: no C compiler for this machine was found; {vector} {100 * most:g} %"
    worst = max(fused, plain)
    refuse_if(
        worst > most,
        "The controller loses too much in float.",
        f"expected inputs within {100 * most:g} % of their largest value over the test vector, "
        f"got {100 * worst:.2g} %",
        "--real double; or larger noise levels of the estimator, which condition its covariances better",
    )
    allowed = min(most, max(MIN_TOLERANCE, SPARE * worst))
    return (
        allowed,
        f"{100 * fused:.2g} % of the input's largest value over the test vector, {100 * plain:.2g} % without fused "
        f"multiply-adds, measured at the export; {vector} {100 * allowed:.2g} %",
    )


def _measured_error(code: ControllerCode, run: Recording, flags: Sequence[str]) -> float | None:
    """Largest error in the test vector, built for this machine; infinite where a result is not finite."""
    texts = {**code.files, "test.c": _test(code, (run,), TOLERANCE[code.real.name])}
    try:
        with TemporaryDirectory() as work:
            built = build(texts, Path(work), ("-O1", *flags))
            output = subprocess.run([built], capture_output=True, text=True, check=False).stdout
    except (InvalidInput, OSError):  # there is none, or the one that CC names compiles for another machine
        return None
    match = re.search(r"largest relative error (\S+)", output)
    error = float(match.group(1)) if match else math.inf
    refused = "flags of the compiler" in output  # it has flags of its own, and the controller refuses them
    return None if refused else error if math.isfinite(error) else math.inf


def _test(code: ControllerCode, runs: Sequence[Recording], allowed: float) -> str:
    """The test vector as C, of one run for both roundings or one for each; stored inputs are exact, as in Python."""
    run, size = runs[-1], np.maximum(np.abs(runs[-1].u).max(axis=0), 1e-30)
    codes = [str(code.codes[kind].value) for kind in run.codes]
    status = [_lines([str(bits) if code.real.bytes == 8 else "-1" for bits in run.status]) for run in runs]

    def rows(values: np.ndarray) -> str:
        texts = [
            ["(@NAME@_real)NAN" if np.isnan(v) else constant(float(v), code.real) for v in row]
            for row in values
        ]
        return ",\n".join(f"    {{{', '.join(row)}}}" for row in texts)

    return fill(
        template("test.c"), code.name, code.real,
        VERSION=__version__, SAMPLES=len(codes), TOLERANCE=constant(allowed, code.real), RUNS=len(runs),
        R=code.sizes["r"], Y=rows(run.y), COMMANDS=rows(run.r), RUN=f"{code.name}_fused" if len(runs) > 1 else 0,
        U="\n}, {\n".join(rows(run.u) for run in runs),
        SIZES="    " + ", ".join(constant(float(v), code.real) for v in size),
        CODES=_lines(codes), STATUS="\n}, {\n".join(status), MISSING=_missing(code),
        ZERO=constant(0.0, code.real), FABS=f"fabs{code.real.suffix}",
    )  # fmt: skip


def _missing(code: ControllerCode) -> int:
    """What a step returns for a sample without a measurement."""
    return code.codes["PREDICTED" if code.predicts else "STOPPED"].value


def _lines(numbers: Sequence[str]) -> str:
    return ",\n".join("    " + ", ".join(numbers[k : k + 20]) for k in range(0, len(numbers), 20))


#: What the time of a sine depends on, of each type.
ANGLES = {
    "double": "whether an angle is beyond 1e6 rad",
    "float": "in which quarter turn an angle lies, and whether it is beyond 1e4 rad",
}


#: The files of a design, among the others.
DESIGN = (
    "| `design/` | the design as it was exported: `design.toml`, the robot file, and `requirements.md` |\n"
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
    arrays = {
        "Y": ("input.y", None), "R": ("input.r", None), "U": ("output.u", code.safe_input),
        "X": ("output.estimate", code.belief),
    }  # fmt: skip
    signals = [
        (f"`{array}`", str(k), comment(name), code.unit_text(name),
         "" if starts is None else f"{starts[k]:.6g}")
        for kind, (array, starts) in arrays.items() for k, name in enumerate(code.signals[kind])
    ]  # fmt: skip
    at_limit = int(((run.u <= c.limits.lower) | (run.u >= c.limits.upper)).any(axis=1).sum())
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
        "arithmetic operations of one step": f"about {code.operations}; `make cortex-m4` counts instructions",
        "from `<math.h>`": ", ".join(sorted(set(MATHEMATICS.findall(code.source)))),
    }
    return fill(
        template("README.md").replace("@EXAMPLE@", _example(code)), code.name, code.real,
        VERSION=__version__, PERIOD_TEXT=f"{c.period:g}", SAMPLES=len(run.u), OLDEST=f"{code.oldest:g}",
        MISSING=MISSING_LIMIT if code.predicts else 0, BEGINS=begins,
        GEARS="\n".join(["", *wrap(GEARS, 118), ""]) if code.has_motors else "",
        COMMAND="\n".join(wrap(code.command_text, 118)),
        STANDSTILL_USE="" if code.standstill is None else STANDSTILL_USE if code.rests else RESTART_USE,
        BOTH=" The test vector\nhas both." if code.real.name == "double" else "",
        BELIEVES="\n".join(wrap(code.believes_text, 118)),
        SAYS="\n".join(wrap(code.status_text, 112)), ANGLES=ANGLES[code.real.name],
        MARK="@DIGEST@", DESIGN=DESIGN if has_design else "",
        UNLIMITED="\n".join(["", *wrap(code.unlimited_text, 118)]) if code.unlimited_text else "",
        TOLERANCES="" if code.robot is None else " outside\nthe tolerances of the robot file",
        AT_LIMIT=AT_LIMIT.format(at_limit) if at_limit else "",
        FACTS=_table(("", ""), [(key, comment(text)) for key, text in facts.items()]),
        SIGNALS=_table(("array", "element", "signal", "unit", "at the start"), signals),
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
    return EXAMPLE.replace("@COMMAND@", command).replace("@LATE@", before).replace("@NOW@", after)


#: Functions and macros of the mathematical library.
MATHEMATICS = re.compile(
    r"\b((?:sqrt|fabs|copysign|a?sin|a?cos|a?tan|atan2|exp|log|pow|tanh|floor|frexp)f?|is(?:finite|nan))\("
)

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
@LATE@        code = @NAME@_step(&state, &@NAME@_defaults, &input, &output);
@NOW@        watch(code); /* yours: brakes as "What a step returns" says */
    }"""

#: Why a test vector may saturate.
AT_LIMIT = "; in {} of them an input is at its limit, as its commands swing faster than a robot should"

#: How a moving command rests, and begins elsewhere.
STANDSTILL_USE = """
    @NAME@_rest(&@NAME@_defaults, q, input.r);    /* rests at link positions q, rad or m */
    @NAME@_start(&state, &@NAME@_defaults, input.r, input.r + @BIG@_STATES);    /* begins there */

Its code is about as large as that of the model, and not counted by `--flash`; `-D@BIG@_WITHOUT_REST` leaves it out.
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


#: How a sample ends, by the name of the code that a step in C returns for it.
MEASURED, MISSING, NOT_FINITE = "OK", "PREDICTED", "BAD_MEASUREMENT"

#: A sample of whose measurement the first element is no number.
GAP = "gap"

#: Size of the commands' swing about the operating point, in the unit of the tracked states, and its periods, samples.
SWING, PERIODS = 0.05, (97, 61)

#: Largest standard deviation of the noise in a recorded loop, in the unit of the measurement: the swing is to be seen.
LOUDEST = 0.1 * SWING


@dataclass(frozen=True, eq=False)
class Recording:
    """Recorded samples of a controller, in order.

    `y`, `r`: (K, p), (K, max(1, k)) arrays, measurements and commands. `u`, `estimate`: (K, m), (K, n) arrays, outputs
    of the controller, held where the sample was refused. `codes`: "OK", "PREDICTED" or "BAD_MEASUREMENT", one for each
    sample. `status`: bits of `Controller.status`, likewise.
    """

    y: np.ndarray
    r: np.ndarray
    u: np.ndarray
    estimate: np.ndarray
    codes: list[str]
    status: list[int]


def record(
    controller: Controller,
    samples: int = 200,
    interrupted: bool = True,
    exact: type[np.floating] = np.float64,
) -> Recording:
    """Run a closed loop of the controller and the plant that its estimator believes in, with noise.

    The noise is that of the estimator's model: without it, measurements equal predictions, and a wrong gain would not
    be seen. The plant starts where the estimator believes it: started elsewhere, inputs may stay at their limits, and
    any code would answer that. The commands swing about the operating point within the limits of the states, a moving
    reference along its equilibria; without an estimator there is no plant, and the states swing too.

    `controller`: Only read. `interrupted`: Replay what was measured with samples left out and samples that are not
    finite. `exact`: Of numbers that hold the measurements and commands as they are.
    """
    time = np.arange(samples)[:, None]
    operating_reference = controller.operating_reference
    j = np.arange(len(controller.tracked if controller.mode.moving else operating_reference))
    swing = (
        SWING
        * _room(controller, len(j))
        * (np.sin(2.0 * np.pi * time / np.take(PERIODS, j % 2) + j) - np.sin(j))
    )
    if controller.mode.moving:
        swing = swing @ _standstills(controller).T
    r = operating_reference + swing
    if controller.estimator is None:
        point = np.asarray(controller.law.operating_point)[: len(controller.states)]
        y = point + 0.01 * np.sin(2.0 * np.pi * time / (40 + 7 * np.arange(len(point))))
    else:
        estimator, times = controller.estimator, controller.period * np.arange(samples)
        run = Loop(estimator.plant, controller).run(
            {name: Samples(times, column) for name, column in zip(controller.commanded, r.T, strict=True)},
            noise=np.minimum(np.sqrt(np.diag(np.atleast_2d(estimator.measurement_noise))), LOUDEST),
            duration=controller.period * (samples - 1),
            initial_state=np.asarray(estimator.initial[0], dtype=float),
        )
        y = np.asarray(run.data["output"])[:samples]
    kinds = np.full(samples, MEASURED, dtype=object)
    if interrupted:
        kinds[samples // 3 : samples // 3 + 3] = GAP
        if controller.estimator is not None:
            kinds[samples // 2 : samples // 2 + 5] = MISSING
    return replay(controller, y.astype(exact).astype(float), r.astype(exact).astype(float), list(kinds))


def _room(controller: Controller, count: int) -> np.ndarray:
    """Share (k,) of the swing for which each tracked state has room in its limits, about the operating point."""
    if controller.estimator is None:
        return np.ones(count)
    plant, share = controller.estimator.plant, []
    for name in controller.tracked:
        low, high = plant.limits.get(name, (-np.inf, np.inf))
        at = controller.law.operating_point[controller.states.index(name)]
        share.append(np.clip(min(at - low, high - at) / (2.0 * SWING), 0.0, 1.0))
    return np.array(share)


def _standstills(controller: Controller) -> np.ndarray:
    """Slope (n + m, k) of a moving reference along its tracked positions, at rest; zero where no model tells it."""
    n, places = len(controller.states), [controller.states.index(name) for name in controller.tracked]
    slope: Any = (None,)
    if controller.estimator is not None and places:
        r = controller.operating_reference
        model, states = controller.estimator.plant, controller.estimated_states
        moved, pushed = equilibrium_line(
            model, states.whole(r[:n]), r[n:], [model.index(name) for name in controller.tracked]
        )
        slope = (None,) if moved is None else (states.own(moved), pushed)
    return np.zeros((len(controller.commanded), len(places))) if slope[0] is None else np.vstack(slope)


def with_both_roundings(controller: Controller, run: Recording) -> tuple[Recording, Recording]:
    """A recording of the controller, as it is without and with fused multiply-adds."""
    from flexhinf.codegen import machine

    once = machine.host().fused if controller.fused is None else controller.fused
    other = replay(controller.fresh(not once), run.y, run.r[:, : len(controller.commanded)], run.codes)
    return (other, run) if once else (run, other)


def replay(controller: Controller, y: np.ndarray, r: np.ndarray, kinds: list[str]) -> Recording:
    """Feed samples to a fresh controller.

    `controller`: Only read. `y`, `r`: (K, p), (K, k) arrays. `kinds`: "OK"; "PREDICTED" for a sample without a
    measurement; `GAP` for one without the first element, which is refused if there is no estimator.
    """
    fresh, y = controller.fresh(), np.array(y, dtype=float)
    held = np.asarray(fresh.input_before(), dtype=float)
    inputs, estimates, codes, status = [], [], [], []
    for k, kind in enumerate(kinds):
        code = kind
        if kind == GAP:
            y[k, 0] = np.nan
            code = NOT_FINITE if not controller.gaps else MEASURED if np.isfinite(y[k]).any() else MISSING
        try:
            held = fresh.step(None if kind == MISSING else y[k], r[k] if r.shape[1] else None)
        except NumericalFailure:
            if code != NOT_FINITE:
                raise
        codes.append(code)
        inputs.append(held)
        estimates.append(np.nan_to_num(fresh.estimate))
        status.append(int(fresh.status))
    r = r if r.shape[1] else np.zeros((len(y), 1))
    return Recording(y, r, np.array(inputs), np.array(estimates), codes, status)
