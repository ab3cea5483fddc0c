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
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf import __version__
from flexhinf.codegen.c import constant
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.export.compiled import build, cortex_m4_bytes
from flexhinf.export.controller_c import (
    GEARS,
    MISSING_LIMIT,
    NO_NUMBERS,
    ControllerCode,
    code_of,
    comment,
    fill,
    template,
)
from flexhinf.files import write_file
from flexhinf.loop import Controller, Loop, Samples
from flexhinf.loop.controller.options import equilibrium_line
from flexhinf.validation import checked_path, value_text

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: Largest error of the test vector relative to an input's largest value. In double it is zero where the processor has a
#: fused multiply-add, and what other roundings leave of ill-conditioned covariances where it has none (1e-10 was seen).
#: In float it is that of covariances and gains of 24 bits: 1e-6 to 2 % were seen, so it is measured where a C compiler
#: is at hand, and a controller beyond this is refused.
TOLERANCE = {"double": 1e-9, "float": 5e-2}

#: What a test vector in float allows: this many times what was measured, as other processors round otherwise.
SPARE, MIN_TOLERANCE = 5.0, 1e-5

#: Files around the controller, of which NAME is its name, and the templates that they are made of.
AROUND = {
    "main.c": "main.c", "Makefile": "Makefile", "CMakeLists.txt": "CMakeLists.txt",
    "cortex_m4/board.c": "cortex_m4/board.c", "cortex_m4/board.ld": "cortex_m4/board.ld",
    "templates/NAME.ino": "sketch.ino", "templates/NAME_ros2_controller.cpp": "ros2_controller.cpp",
}  # fmt: skip


def export_c(
    controller: Controller,
    folder: str | os.PathLike[str],
    name: str = "controller",
    real: str = "double",
    force: bool = False,
    robot: Robot | None = None,
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
        Whose gear ratios stand with the units of motors' signals.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    InvalidInput
        If the name is none for C, the type is unknown, the folder is not empty, or numbers or law do not fit the type.
    Unsupported
        If law or estimator need an operation that has no form in C.
    """
    target = checked_folder(folder, force)
    write_files(target, controller_files(controller, name, real, robot))
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


def check_room(controller: Controller, real: str, period: str = "", flash: str = "", ram: str = "") -> str:
    """Refuse a controller that does not fit a firmware; a note on what could not be counted, or "".

    `period`: Of the firmware's loop, such as "1ms"; empty for any. `flash`, `ram`: Room for
    code and constants, and for the state, such as "32kB"; empty for any. The code is counted for a Cortex-M4F where
    arm-none-eabi-gcc is installed. Raises InvalidInput: if the period is another one, or code, constants or state are
    larger.
    """
    refuse_if(
        period and abs(_quantity(period, SECONDS) - controller.period) > 1e-9 * controller.period,
        "The firmware's period is not the controller's.",
        f"expected {controller.period:g} s, for which law and estimator are made, got {value_text(period)}",
        "a design with --period of that length",
    )
    code = code_of(controller, "controller", real)
    whole, constants = cortex_m4_bytes(code) if flash else None, code.constants * code.real.bytes
    kind, where = (
        ("constants", "") if whole is None else ("code and constants", ", compiled for a Cortex-M4F")
    )
    rows = (
        ("--flash", flash, f"{kind} need", constants if whole is None else whole, where,
         "--degrees 2 at the design, --real float"),
        ("--ram", ram, "state needs", code.state_bytes, "",
         "--real float, an extended Kalman filter (--estimator ekf), --degrees 2"),
    )  # fmt: skip
    for option, stated, what, needed, where, advice in rows:
        refuse_if(
            stated and needed > _quantity(stated, BYTES),
            f"The controller does not fit: its {what} more room.",
            f"expected at most {value_text(stated)} ({option}), got {needed} bytes in the type {real}{where}",
            advice,
        )
    return NOT_COUNTED.format(constants) if flash and whole is None else ""


#: What --flash says where the code cannot be compiled.
NOT_COUNTED = (
    "--flash was compared with the constants alone, {} bytes: the code is counted where arm-none-eabi-gcc is "
    "installed, and is usually several times as large."
)


#: Units of times and sizes.
SECONDS = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
BYTES = {"": 1.0, "b": 1.0, "kb": 1e3, "kib": 1024.0, "mb": 1e6, "mib": 1024.0**2}


def _quantity(text: str, units: Mapping[str, float]) -> float:
    match = re.fullmatch(r"\s*([0-9.]+(?:e[-+]?[0-9]+)?)\s*([a-zµ]*)\s*", text.lower())
    value = -1.0
    with suppress(ValueError, KeyError):
        value = float(match.group(1)) * units[match.group(2)] if match else value
    refuse_if(
        not 0.0 < value < 1e30,
        "This is no positive quantity.",
        f"expected a number and one of {', '.join(unit for unit in units if unit)}, got {value_text(text)}",
        f"1{list(units)[2]}",
    )
    return value


def controller_files(
    controller: Controller, name: str = "controller", real: str = "double", robot: Robot | None = None
) -> dict[str, str]:
    """The files of `export_c`: relative path to text; raises as it does."""
    code = code_of(controller, name, real, NO_NUMBERS if robot is None else robot.nominal)
    run = record(code.controller, exact=np.float32 if real == "float" else np.float64)
    allowed, accuracy = _accuracy(code, run)

    commands, measured = (
        ", ".join('"' + comment(name).replace('"', "'") + '"' for name in code.signals[kind]) for kind in "UY"
    )
    text, home = _home(code)
    marks = {
        "VERSION": __version__, "PERIOD_US": round(1e6 * code.controller.period), "R": code.sizes["r"],
        "HOME": ", ".join(constant(float(v), code.real) for v in home), "HOME_TEXT": text,
        "COMMAND_INTERFACES": commands, "STATE_INTERFACES": measured,
    }  # fmt: skip
    return {
        **code.files,
        f"{name}_test.c": _test(code, run, allowed),
        "README.md": _readme(code, run, accuracy),
        **{
            path.replace("NAME", name): fill(
                template(file).replace("@STANDSTILL@", _standstill(code, file)), name, code.real, **marks
            )
            for path, file in AROUND.items()
        },
    }


def _home(code: ControllerCode) -> tuple[str, np.ndarray]:
    """What a command of the templates begins with, in words and as numbers: that of the robot where it starts."""
    c, place = code.controller, code.belief
    if c.mode.moving and code.standstill is None:
        return "A motion", c.operating_reference
    state = np.asarray(c.law.operating_point)[: len(c.states)] if place is None else place
    if code.standstill is not None:
        return "Link positions", state[: code.standstill.size1_in(0)]
    positions = state[[c.law.plant_states.index(name) for name in c.law.tracked]]
    return "Positions", positions if len(positions) else np.zeros(1)


#: The array of the command in the templates.
COMMAND_ARRAYS = {"main.c": "input.r", "sketch.ino": "r", "ros2_controller.cpp": "reference_"}


def _standstill(code: ControllerCode, file: str) -> str:
    """The statement of a template that makes the command rest at `home`."""
    r = COMMAND_ARRAYS.get(file, "")
    if code.standstill is not None:
        return f"@NAME@_rest(&@NAME@_defaults, home, {r});"
    return f"for (int i = 0; i < @BIG@_COMMANDS; ++i) {{ {r}[i] = home[i]; }}"


def _accuracy(code: ControllerCode, run: Recording) -> tuple[float, str]:
    """Largest error that the test vector allows, relative to each input's largest value, and a text for the README.

    In float it is measured with this machine's C compiler, if there is one. Raises InvalidInput if more is lost than a
    test vector may allow.
    """
    most = TOLERANCE[code.real.name]
    if code.real.name == "double":
        return (
            most,
            f"the simulation's bits with fused multiply-adds, {most:.0e} of the largest value without",
        )
    fused, plain = (_measured_error(code, run, flags) for flags in ((), (f"-D{code.upper('PLAIN')}",)))
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
    texts = {**code.files, "test.c": _test(code, run, TOLERANCE[code.real.name])}
    try:
        with TemporaryDirectory() as work:
            output = subprocess.run(
                [build(texts, Path(work), ("-O1", *flags))], capture_output=True, text=True, check=False
            ).stdout
    except (InvalidInput, OSError):  # there is none, or the one that CC names compiles for another machine
        return None
    match = re.search(r"largest relative error (\S+)", output)
    error = float(match.group(1)) if match else math.inf
    refused = "flags of the compiler" in output  # it has flags of its own, and the controller refuses them
    return None if refused else error if math.isfinite(error) else math.inf


def _test(code: ControllerCode, run: Recording, allowed: float) -> str:
    """The test vector as C; its stored inputs are exact, so that C and Python compute with the same numbers."""
    size = np.maximum(np.abs(run.u).max(axis=0), 1e-30)
    codes = [str(code.codes[kind][0]) for kind in run.codes]

    def rows(values: np.ndarray) -> str:
        texts = [
            ["(@NAME@_real)NAN" if np.isnan(v) else constant(float(v), code.real) for v in row]
            for row in values
        ]
        return ",\n".join(f"    {{{', '.join(row)}}}" for row in texts)

    return fill(
        template("test.c"), code.name, code.real,
        VERSION=__version__, SAMPLES=len(codes), TOLERANCE=constant(allowed, code.real),
        R=code.sizes["r"], Y=rows(run.y), COMMANDS=rows(run.r), U=rows(run.u),
        SIZES="    " + ", ".join(constant(float(v), code.real) for v in size),
        CODES=",\n".join("    " + ", ".join(codes[k : k + 20]) for k in range(0, len(codes), 20)),
        ZERO=constant(0.0, code.real), FABS=f"fabs{code.real.suffix}",
        MISSING=code.codes["STOPPED"][0] if not code.predicts else code.codes["PREDICTED"][0],
    )  # fmt: skip


def _readme(code: ControllerCode, run: Recording, accuracy: str) -> str:
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
        **c.summary(),
        "saturation": c.summary().get("saturation", none),
        "type": code.real.name,
        "inputs differ from the simulation's by": accuracy,
        "memory of one controller": f"{code.state_bytes} bytes, given by the caller (`{code.name}_state`)",
        "constants": f"{code.constants} numbers",
        "arithmetic operations of one step": f"about {code.operations}; `make cortex-m4` counts instructions",
    }
    return fill(
        template("README.md"), code.name, code.real,
        VERSION=__version__, PERIOD_TEXT=f"{c.period:g}", SAMPLES=len(run.u), OLDEST=f"{code.oldest:g}",
        MISSING=MISSING_LIMIT if code.predicts else 0, BEGINS=begins,
        GEARS="\n".join(["", *wrap(GEARS, 118), ""]) if code.has_motors else "",
        COMMAND="\n".join(wrap(code.command_text, 118)),
        STANDSTILL_USE="" if code.standstill is None else STANDSTILL_USE,
        EDGE="".join(f"{line}\n" for line in code.edge),
        AT_LIMIT=AT_LIMIT.format(at_limit) if at_limit else "",
        FACTS=_table(("", ""), [(key, comment(text)) for key, text in facts.items()]),
        SIGNALS=_table(("array", "element", "signal", "unit", "at the start"), signals),
        CODES=_table(
            ("constant", "value", "meaning"),
            [(f"`{code.upper(key)}`", str(value), text) for key, (value, text) in code.codes.items()],
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

#: What the numbers of a controller are.
PARTS = {
    "period": "sampling period, s; the code is made for this one",
    "law": "coefficients of the law",
    "operating_point": "state, then integrals, about which the law is",
    "operating_input": "input there",
    "lower": "least input",
    "upper": "largest input",
    "integral_gain": "slope of the input by the integrals, for the anti-windup",
    "parameters": "parameters of the estimator's model",
    "process_noise": "covariance of the process noise per sample",
    "measurement_noise": "covariance of the measurement noise",
    "inverse_slope": "integrals by input, where a law takes over",
    "decay": "factor per sample of what no integral reaches after a law took over",
    "closer": "how much closer another law's point must be before it takes over",
    "input_rate": "largest change of the input, per s",
    "command_lower": "least command",
    "command_upper": "largest command",
    "command_rate": "largest change of the command, per s",
    "workspace": "least and largest commanded positions that the design is for",
    "swings": "of each input: how near to a limit counts as at it, the smallest swing, and how many make a limit cycle",
    "watching": "samples of the longest swing and of a saturation that lasts; fraction of the braking per sample",
    "offset_decay": "factor per sample of the offsets of the first measurement",
    "integral_dead_zone": "errors up to this size are not integrated",
    "windup_line": "what integrals push at rest, by command from the operating point: of inputs without near limits",
    "windup_spread": "how much more they push, likewise",
    "windup_limit": "how much more they push at the operating point; infinite for an input that its limits keep nearer",
}


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
    sample.
    """

    y: np.ndarray
    r: np.ndarray
    u: np.ndarray
    estimate: np.ndarray
    codes: list[str]


def record(
    controller: Controller,
    samples: int = 200,
    interrupted: bool = True,
    exact: type[np.floating] = np.float64,
) -> Recording:
    """Run a closed loop of the controller and the plant that its estimator believes in, with noise.

    The noise is that of the estimator's model: without it, measurements equal predictions, and a wrong gain would not
    be seen. The plant starts where the estimator believes it, as the design's own step does: started elsewhere, the
    estimate may be so wrong that the inputs stay at their limits, and any code would answer that. The commands swing
    about the operating point, a moving reference along its equilibria; without an estimator there is no plant, and the
    states swing too.

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
    if not controller.mode.moving or controller.estimator is None:
        return np.ones(count)
    plant, share = controller.estimator.plant, []
    for name in controller.tracked:
        low, high = plant.limits.get(name, (-np.inf, np.inf))
        at = controller.law.operating_point[plant.index(name)]
        share.append(np.clip(min(at - low, high - at) / (2.0 * SWING), 0.0, 1.0))
    return np.array(share)


def _standstills(controller: Controller) -> np.ndarray:
    """Slope (n + m, k) of a moving reference along its tracked positions, at rest; zero where no model tells it."""
    n, places = len(controller.states), [controller.states.index(name) for name in controller.tracked]
    slope: Any = (None,)
    if controller.estimator is not None and places:
        r = controller.operating_reference
        slope = equilibrium_line(controller.estimator.plant, r[:n], r[n:], places)
    return np.zeros((len(controller.commanded), len(places))) if slope[0] is None else np.vstack(slope)


def replay(controller: Controller, y: np.ndarray, r: np.ndarray, kinds: list[str]) -> Recording:
    """Feed samples to a fresh controller.

    `controller`: Only read. `y`, `r`: (K, p), (K, k) arrays. `kinds`: "OK"; "PREDICTED" for a sample without a
    measurement; `GAP` for one without the first element, which is refused if there is no estimator.
    """
    fresh, y = controller.fresh(), np.array(y, dtype=float)
    held = np.asarray(fresh.input_before(), dtype=float)
    inputs, estimates, codes = [], [], []
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
    r = r if r.shape[1] else np.zeros((len(y), 1))
    return Recording(y, r, np.array(inputs), np.array(estimates), codes)
