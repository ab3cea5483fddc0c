"""What an exported controller is tested with on its own processor: a recorded run, and a rehearsal of its contract.

The test vector is a recording of the controller: measurements, commands, inputs and estimates. The C code must give the
same. The rehearsal provokes every value that a step returns, and looks for what the README says of it.
"""

from __future__ import annotations

import math
import re
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from flexhinf import __version__
from flexhinf.codegen.c import constant, folded
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export.compiled import build, compiler_flags
from flexhinf.export.controller_c import ControllerCode
from flexhinf.export.filling import fill, template
from flexhinf.export.recording import MISSING, Recording

#: Largest error of the test vector relative to an input's largest value: in double of the C library's functions, where
#: they are called; in float of covariances and gains of 24 bits: 1e-6 to 2 % were seen, so it is measured where a C
#: compiler is at hand, and a controller beyond this is refused.
TOLERANCE = {"double": 1e-9, "float": 5e-2}

#: Largest error in float while positions are moved.
MOST_MOVED = 0.2

#: What a test vector in float allows: this many times what was measured, as other processors round otherwise.
SPARE, MIN_TOLERANCE = 5.0, 1e-5


#: Every how many samples the estimate is compared.
EVERY = 10


@dataclass(frozen=True)
class Accuracy:
    """Largest errors that a test vector allows in each of its parts, relative to each signal's largest value there, and
    a text for the README."""

    inputs: tuple[float, ...]
    estimates: tuple[float, ...]
    text: str


def accuracy(code: ControllerCode, run: Recording) -> Accuracy:
    """In double what the C library's functions may differ by; in float what is measured with this machine's compiler.

    Raises InvalidInput if inputs lose more than a test vector may allow: less while no position is moved.
    """
    most, plainly, parts = TOLERANCE[code.real.name], (f"-D{code.upper('PLAIN')}",), len(run.parts)
    if code.real.name == "double":
        same = f"nothing, if {code.name}_fused is 1 in a simulation with fused multiply-adds, and else in one without"
        called = f"{same}, but for the C library's functions: the test vector allows {most:.0e}"
        called, most = (called, most) if code.translator.calls_library else (same, 0.0)
        return Accuracy((most,) * parts, (most,) * parts, called)
    fused, plain = (_measured_errors(code, run, flags) for flags in (compiler_flags("portable"), plainly))
    vector = "the test vector allows"
    if fused is None or plain is None:
        text = f"not measured: no C compiler for this machine was found; {vector} {100 * most:g} %"
        return Accuracy((most, SPARE * MOST_MOVED)[:parts], (math.inf,) * parts, text)
    worst, estimates = (np.maximum(*each) for each in zip(fused, plain, strict=True))
    refuse_if(
        worst[0] > most or worst[-1] > max(most, MOST_MOVED),
        "The controller loses too much in float.",
        f"expected inputs within {100 * most:g} % of their largest value over the test vector, "
        f"got {100 * worst[0]:.2g} %{MOVED.format(100 * worst[-1]) * (parts > 1)}",
        "--real double; or larger noise levels of the estimator, which condition its covariances better",
    )
    allowed = np.maximum(MIN_TOLERANCE, SPARE * worst)
    allowed[0] = min(most, allowed[0])
    moved = f" ({vector} {100 * allowed[-1]:.2g} %)"
    return Accuracy(
        tuple(allowed),
        tuple(np.maximum(MIN_TOLERANCE, SPARE * estimates)),
        f"{100 * fused[0][0]:.2g} % of the input's largest value over the test vector, {100 * plain[0][0]:.2g} % "
        f"without fused multiply-adds, measured at the export; {vector} {100 * allowed[0]:.2g} %"
        + (MOVED.format(100 * worst[-1]) + moved)
        * (parts > 1),
    )


#: What is added of errors while measured positions are moved.
MOVED = "; {:.2g} % while positions are moved from outside"


def _measured_errors(
    code: ControllerCode, run: Recording, flags: Sequence[str]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Largest errors of inputs and estimates in each part of the test vector, built for this machine; infinite where a
    result is not finite."""
    any_error = (math.inf,) * len(run.parts)
    texts = {**code.files, "test.c": vector(code, (run,), Accuracy(any_error, any_error, ""))}
    try:
        with TemporaryDirectory() as work:
            built = build(texts, Path(work), ("-O1", *flags))
            output = subprocess.run([built], capture_output=True, text=True, check=False).stdout
    except (InvalidInput, OSError):  # there is none, or the one that CC names compiles for another machine
        return None
    if "flags of the compiler" in output:  # it has flags of its own, and the controller refuses them
        return None
    found = re.findall(r"largest relative error (\S+) .* of estimates (\S+)", output)
    errors = np.array(found or [("inf", "inf")] * len(run.parts), dtype=float).T
    inputs, estimates = np.where(np.isfinite(errors), errors, math.inf)
    return inputs, estimates


def vector(code: ControllerCode, runs: Sequence[Recording], allowed: Accuracy) -> str:
    """The test vector as C, of one run for both roundings or one for each; stored inputs are exact, as in Python."""
    run = runs[-1]
    codes = [str(code.codes[kind].value) for kind in run.codes]
    status = [_lines([str(bits) if code.real.bytes == 8 else "-1" for bits in run.status]) for run in runs]
    sizes, sizes_of_estimates = list[str](), list[str]()
    for part in run.parts:
        largest = np.abs(run.estimate[part]).max(axis=0)
        sizes.append(_row(code, np.maximum(np.abs(run.u[part]).max(axis=0), 1e-30)))
        sizes_of_estimates.append(_row(code, np.maximum(largest, 1e-3 * largest.max())))

    def rows(values: np.ndarray) -> str:
        return ",\n".join(f"    {{{_row(code, row)}}}" for row in values)

    text = fill(
        template("test.c"), code.name, code.real,
        VERSION=__version__, SAMPLES=len(codes), RUNS=len(runs), EVERY=EVERY, R=code.sizes["r"],
        RUN=f"{code.name}_fused" if len(runs) > 1 else 0,
        TOLERANCE_OF_ESTIMATES=_row(code, np.array(allowed.estimates)), TOLERANCE=_row(code, np.array(allowed.inputs)),
        PARTS=len(run.parts), MOVED=len(codes) if run.moved is None else run.moved,
        Y=rows(run.y), COMMANDS=rows(run.r),
        MEASURED=_lines([str(int(kind != MISSING)) for kind in run.kinds]),
        U="\n}, {\n".join(rows(run.u) for run in runs),
        ESTIMATES="\n}, {\n".join(rows(run.estimate[::EVERY]) for run in runs),
        SIZES=",\n".join(f"    {{{row}}}" for row in sizes),
        SIZES_OF_ESTIMATES=",\n".join(f"    {{{row}}}" for row in sizes_of_estimates),
        CODES=_lines(codes), STATUS="\n}, {\n".join(status),
        ZERO=constant(0.0, code.real), FABS=f"fabs{code.real.suffix}",
    )  # fmt: skip
    return folded(text)


def reaches_far(code: ControllerCode) -> bool:
    """Whether the rehearsal stands the robot at large angles: a model knows it at rest, and no limit refuses them."""
    return code.standstill is not None and not code.controller.mode.checks_measurements


def contract(code: ControllerCode, run: Recording) -> str:
    """The rehearsal of the contract as C, which begins with the first sample of a recording."""
    far = reaches_far(code)
    marks = {
        "Q": code.standstill.size1_in(0) if far else 0, "FAR_ANGLE": FAR[code.real.name],
        "LARGEST": {"double": "1e300", "float": "1e30F"}[code.real.name],
        "FAR_R": FAR_R * code.rests, "VERSION": __version__, "PREDICTS": int(code.predicts),
        "NOT_FINITE": "PREDICTED" if code.predicts else "BAD_MEASUREMENT",
        "UNMEASURED": "PREDICTED" if code.predicts else "STOPPED",
        "STARTS": int(code.starts_anywhere), "R": code.sizes["r"], "FIRST_Y": _row(code, run.y[0]),
        "FIRST_R": _row(code, run.r[0]),
        "FIRST_ESTIMATE": _row(code, np.zeros(code.sizes["estimate"]) if code.belief is None else code.belief),
    }  # fmt: skip
    text = template("contract.c").replace("@FAR_AWAY@", FAR_AWAY * far)
    return folded(fill(text.replace("@FAR_CALL@", "    far_away();\n" * far), code.name, code.real, **marks))


#: Angles beyond those that are reduced quickly, rad.
FAR = {"double": "4e9", "float": "2e4F"}

#: Where the model knows a robot at rest, it stands at such angles; and a moving command rests there.
FAR_AWAY = """/* The longest way through a sine: the robot stands at angles beyond those that are reduced quickly. */
static void far_away(void)
{
#ifndef @BIG@_WITHOUT_REST
    @NAME@_real q[@Q@], rest[@BIG@_STATES + @BIG@_INPUTS];
    for (int i = 0; i < @Q@; ++i) {
        q[i] = @FAR_ANGLE@;
    }
    expect(@NAME@_rest(&param, q, rest) == @BIG@_OK, "rest at large angles");
    expect(@NAME@_start(&state, &param, rest, rest + @BIG@_STATES) == @BIG@_OK, "a start at large angles");
    give();
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        input.y[i] = @FAR_ANGLE@;
    }
@FAR_R@    (void)step();
    (void)step();
    for (int i = 0; i < @BIG@_MEASUREMENTS; ++i) {
        input.y[i] = @LARGEST@; /* finite: its square is not, and the memory goes back from there */
    }
    for (int k = 0; k < 4; ++k) {
        (void)step();
    }
#endif
}

"""
FAR_R = """    for (int i = 0; i < @BIG@_COMMANDS; ++i) {
        input.r[i] = rest[i];
    }
"""


def _row(code: ControllerCode, values: np.ndarray) -> str:
    """Numbers between commas."""
    return ", ".join(
        "(@NAME@_real)NAN" if np.isnan(value) else constant(float(value), code.real) for value in values
    )


def _lines(numbers: Sequence[str]) -> str:
    return ",\n".join("    " + ", ".join(numbers[k : k + 20]) for k in range(0, len(numbers), 20))
