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
from flexhinf.codegen.c import constant
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.export.compiled import build, compiler_flags
from flexhinf.export.controller_c import ControllerCode, fill, template
from flexhinf.export.recording import MISSING, Recording

#: Largest error of the test vector relative to an input's largest value: in double of the C library's functions, where
#: they are called; in float of covariances and gains of 24 bits: 1e-6 to 2 % were seen, so it is measured where a C
#: compiler is at hand, and a controller beyond this is refused.
TOLERANCE = {"double": 1e-9, "float": 5e-2}

#: What a test vector in float allows: this many times what was measured, as other processors round otherwise.
SPARE, MIN_TOLERANCE = 5.0, 1e-5


#: Every how many samples the estimate is compared.
EVERY = 10


@dataclass(frozen=True)
class Accuracy:
    """Largest errors that a test vector allows, relative to each signal's largest value, and a text for the README."""

    inputs: float
    estimates: float
    text: str


def accuracy(code: ControllerCode, run: Recording) -> Accuracy:
    """In double what the C library's functions may differ by; in float what is measured with this machine's compiler.

    Raises InvalidInput if inputs lose more than a test vector may allow.
    """
    most, plainly = TOLERANCE[code.real.name], (f"-D{code.upper('PLAIN')}",)
    if code.real.name == "double":
        same = f"nothing, if {code.name}_fused is 1 in a simulation with fused multiply-adds, and else in one without"
        called = f"{same}, but for the C library's functions: the test vector allows {most:.0e}"
        called, most = (called, most) if code.translator.calls_library else (same, 0.0)
        return Accuracy(most, most, called)
    fused, plain = (_measured_errors(code, run, flags) for flags in (compiler_flags("portable"), plainly))
    vector = "the test vector allows"
    if fused is None or plain is None:
        text = f"not measured: no C compiler for this machine was found; {vector} {100 * most:g} %"
        return Accuracy(most, math.inf, text)
    worst, estimates = map(max, zip(fused, plain, strict=True))
    refuse_if(
        worst > most,
        "The controller loses too much in float.",
        f"expected inputs within {100 * most:g} % of their largest value over the test vector, "
        f"got {100 * worst:.2g} %",
        "--real double; or larger noise levels of the estimator, which condition its covariances better",
    )
    allowed = min(most, max(MIN_TOLERANCE, SPARE * worst))
    return Accuracy(
        allowed,
        max(MIN_TOLERANCE, SPARE * estimates),
        f"{100 * fused[0]:.2g} % of the input's largest value over the test vector, {100 * plain[0]:.2g} % without "
        f"fused multiply-adds, measured at the export; {vector} {100 * allowed:.2g} %",
    )


def _measured_errors(
    code: ControllerCode, run: Recording, flags: Sequence[str]
) -> tuple[float, float] | None:
    """Largest errors of inputs and estimates in the test vector, built for this machine; infinite where a result is not
    finite."""
    texts = {**code.files, "test.c": vector(code, (run,), Accuracy(TOLERANCE[code.real.name], math.inf, ""))}
    try:
        with TemporaryDirectory() as work:
            built = build(texts, Path(work), ("-O1", *flags))
            output = subprocess.run([built], capture_output=True, text=True, check=False).stdout
    except (InvalidInput, OSError):  # there is none, or the one that CC names compiles for another machine
        return None
    if "flags of the compiler" in output:  # it has flags of its own, and the controller refuses them
        return None
    match = re.search(r"largest relative error (\S+) .* of estimates (\S+)", output)
    errors = map(float, match.groups() if match else ("inf", "inf"))
    inputs, estimates = (error if math.isfinite(error) else math.inf for error in errors)
    return inputs, estimates


def vector(code: ControllerCode, runs: Sequence[Recording], allowed: Accuracy) -> str:
    """The test vector as C, of one run for both roundings or one for each; stored inputs are exact, as in Python."""
    run = runs[-1]
    codes = [str(code.codes[kind].value) for kind in run.codes]
    status = [_lines([str(bits) if code.real.bytes == 8 else "-1" for bits in run.status]) for run in runs]
    largest = np.abs(run.estimate).max(axis=0)
    estimate_size = np.maximum(largest, 1e-3 * largest.max())

    def rows(values: np.ndarray) -> str:
        return ",\n".join(f"    {{{_row(code, row)}}}" for row in values)

    return fill(
        template("test.c"), code.name, code.real,
        VERSION=__version__, SAMPLES=len(codes), RUNS=len(runs), EVERY=EVERY, R=code.sizes["r"],
        RUN=f"{code.name}_fused" if len(runs) > 1 else 0,
        TOLERANCE_OF_ESTIMATES=constant(allowed.estimates, code.real), TOLERANCE=constant(allowed.inputs, code.real),
        Y=rows(run.y), COMMANDS=rows(run.r),
        MEASURED=_lines([str(int(kind != MISSING)) for kind in run.kinds]),
        U="\n}, {\n".join(rows(run.u) for run in runs),
        ESTIMATES="\n}, {\n".join(rows(run.estimate[::EVERY]) for run in runs),
        SIZES="    " + _row(code, np.maximum(np.abs(run.u).max(axis=0), 1e-30)),
        SIZES_OF_ESTIMATES="    " + _row(code, estimate_size),
        CODES=_lines(codes), STATUS="\n}, {\n".join(status),
        ZERO=constant(0.0, code.real), FABS=f"fabs{code.real.suffix}",
    )  # fmt: skip


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
    return fill(text.replace("@FAR_CALL@", "    far_away();\n" * far), code.name, code.real, **marks)


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
