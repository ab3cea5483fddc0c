"""Random words for the command line: exit codes 0, 1 and 2 only, no traceback, few lines on standard error.

What the options say is checked in full; the design, the comparison, proofs, the paper's experiments, the filter over a
log and the search for numbers in it are replaced by a stop, so that an attempt takes milliseconds. A few designs of a
small robot, and a few short logs, run whole. What is refused leaves nothing behind.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import math
import os
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from typer.main import get_command

import flexhinf.paper
from flexhinf.cli import main
from flexhinf.cli.commands import app
from flexhinf.designs.specification import FIELDS
from flexhinf.errors import FlexhinfError
from fuzz.tally import Tally

ATTEMPTS = 1500
WHOLE = 250
"""Every so many attempts a design runs whole."""

LONGEST = 3000
"""Characters on standard error."""

VALUES = (
    "", "0", "-1", "1", "4", "0.3", "90", "90deg", "90 deg", "-90°", "0.6Hz", "5ms", "1e-3", "1e308", "1e400",
    "nan", "inf", "-inf", "1e-300", "9" * 400, "9" * 5000, "true", "none", "auto", "None", "1,2", "1,2,3", ",",
    ",,", "1;2", "0x10", "link_position", "motor_position", "joint_torque,link_position", "link_position=1",
    "link_position=nan", "a=b=c", "=", "paper", "robust", "damped", "UKF", "ekf", "observer", "pd,lqr",
    "bandwidth", "peak", "coulomb_friction", "inductance", "2,4", "13", "[red]", "[/]", "$x$", "\x1b[31m",
    "\u202e", "😀", "肘", "../..", "/", "~", "/dev/null", "/proc/self/mem", "a" * 5000, "a\nb", "--", "-",
    "--help", "%s", "'", '"', "`id`", "$(id)", "\udcff",
    "30mm", "1deg,2mm", "0.1Nm", "87,87,12", "0.01deg,0.1Nm", "inf,1", "0..3kg", "2kg@elbow", "3..0kg@@", "1e29",
    "0.2,0,0.1", "400mm,0,1e9", "elbow:0,0,0.1", ":1,2", "way.csv", "short.csv", "bytes.toml", "fifo.toml", "folder",
    "jerk-limited", "jump", "0.999", "0.5", "motor_position=0..1", "link_position=-90deg..90deg", "link_position=1..-1",
    "link_velocity=-inf..inf", "link_position=..", "motor_position=p [deg]", "motor_voltage=u [", "stiffness,friction",
    "stiffness,stiffness", "friction_elbow", "unscented", "extended", "covariance", "parquet", "log.csv",
)  # fmt: skip

LOGS = (
    "log.csv", "log.csv", "log.csv", "log.csv", "gaps.csv", "way.csv", "short.csv", "empty.toml", "bytes.toml",
    "folder", "nowhere.csv", "fifo.toml", "log.mcap", "log.parquet", *VALUES,
)  # fmt: skip

ROBOTS = (
    "paper", "planar-two-link", "quanser-rotflex", "seven-link", "arm.toml", "design.toml", "paper", "papr",
    "arm.xml", "empty.toml", "bytes.toml", "folder", "nowhere.toml", "arm.urdf", "fifo.toml", "deep.toml", "large.toml",
    *VALUES,
)  # fmt: skip

ARM = """[[joint]]
name = "elbow"
[joint.link]
mass = {value = 1.0, tolerance = 5}
centre_of_mass = [0.2, 0.0, 0.0]
inertia = {xx = 0.01, yy = 0.02, zz = 0.02}
[joint.spring]
stiffness = 100.0
[joint.motor]
motor_inertia = 0.1
friction = 0.1
"""
COMMANDS = (
    "design", "design", "design", "compare", "compare", "certify", "paper", "robots", "schema", "desing", "",
    "estimate", "estimate", "identify", "identify",
)  # fmt: skip

QUICK = (
    "--pose",
    "home",
    "--degrees",
    "2",
    "--set",
    "rays=0",
    "--draws",
    "0",
    "--estimator",
    "none",
    "--duration",
    "1",
)

#: Options of the commands that read a log, by command.
READING = {
    name: list(inspect.unwrap(command.callback).options.values())  # type: ignore[attr-defined]
    for name, command in get_command(app).commands.items()  # type: ignore[attr-defined]
    if name in ("estimate", "identify")
}

#: What runs whole, one after the other.
WHOLE_WORDS = (
    ("design", "arm.toml", *QUICK),
    ("estimate", "log.csv", "--robot", "arm.toml"),
    ("identify", "log.csv", "--robot", "arm.toml", "--parameters", "friction", "--motion", "0.5s"),
)


#: What is replaced by a stop.
WORK = (
    (import_module("flexhinf.designs"), "design_with"), (flexhinf, "compare"), (flexhinf.paper, "reproduce"),
    (import_module("flexhinf.designs.certification"), "certify_design"),
    (import_module("flexhinf.designs.workspace.proof"), "prove_workspace"),
    (flexhinf, "filter_log"), (flexhinf, "identify"),
)  # fmt: skip


class _ReachedError(FlexhinfError):
    """The words are understood: here the work would begin."""


def run(attempts: int, seed: int) -> Tally:
    """One command of up to six options at a time, in a folder of good and bad files."""
    tally, rng = Tally("words of the command line"), np.random.default_rng([seed, 3])
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        _fill(Path(folder))
        os.chdir(folder)
        try:
            for attempt in range(attempts):
                whole = attempt % WHOLE == WHOLE - 1
                words = _words(rng)
                if whole:
                    base = WHOLE_WORDS[attempt // WHOLE % len(WHOLE_WORDS)]
                    words = [*base, *_options(rng, 1, READING.get(base[0]))]
                how = f"seed {seed}, attempt {attempt}: {ascii(words)[:300]}"
                known = set(os.listdir())
                code, error, fault = _outcome(words, whole)
                left = set(os.listdir()) - known
                if left and code not in (0, 1):
                    fault = fault or f"left {sorted(left)}"
                if fault or code == 0 or "here the work would begin" in error or (whole and code == 1):
                    tally.answered(fault, how)
                else:
                    tally.typed += 1
        finally:
            os.chdir(before)
    return tally


def _fill(folder: Path) -> None:
    """Files of all kinds."""
    texts = {
        "arm.toml": ARM, "design.toml": "[design]\nrobot = 'arm.toml'\nbandwidth = 4.0\n", "empty.toml": "",
        "way.csv": "time,elbow [deg]\n0,0\n1,5\n", "short.csv": "time [ms],elbow\n0,0\n1e-9,1\n",
        "arm.xml": "<mujoco><worldbody><body><joint name='elbow'/></body></worldbody></mujoco>",
        "arm.urdf": "<robot name='a'><link name='base'/></robot>", "deep.toml": "x = " + "[" * 10_000,
        "large.toml": "x = [" + "1," * 3_000_000 + "]",
        "log.csv": "time,drive_torque,link_position,motor_position\n"
        + "".join(f"{0.01 * k:.2f},{k % 5 - 2},{1e-3 * (k % 7)},{1e-3 * (k % 3)}\n" for k in range(40)),
        "gaps.csv": "time,drive_torque,link_position\n0,1,0\n0.01,,0.1\n0.03,nan,\n",
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "bytes.toml").write_bytes(bytes(range(256)))
    (folder / "folder").mkdir()
    os.mkfifo(folder / "fifo.toml")


def _words(rng: np.random.Generator) -> list[str]:
    command = COMMANDS[rng.integers(len(COMMANDS))]
    words = [command]
    if command in ("design", "compare", "certify") and rng.random() < 0.97:
        words.append(ROBOTS[rng.integers(7 if rng.random() < 0.7 else len(ROBOTS))])
    if command in READING:
        words.append(LOGS[rng.integers(5 if rng.random() < 0.7 else len(LOGS))])
        if rng.random() < 0.8:
            words += ["--robot", "arm.toml" if rng.random() < 0.7 else ROBOTS[rng.integers(len(ROBOTS))]]
        if command == "identify" and rng.random() < 0.8:
            words += ["--parameters", "stiffness,friction"]
    return [*words, *_options(rng, int(rng.integers(0, 5)), READING.get(command))]


def _options(rng: np.random.Generator, count: int, declared: list[Any] | None = None) -> list[str]:
    """Options (of a specification, if none are declared) with their own example, or with any value."""
    found: list[str] = []
    fields = [field for field in declared or FIELDS.values() if field.option.startswith("-")]
    for _ in range(count):
        field = fields[rng.integers(len(fields))]
        others = (
            "--out", "--elastic", "--laws", "--gains", "--payload", "--pose-xyz", "--goal", "--tool", "--set",
            "--unknown", "--peak-effort", "-x", "--decay", "--observer", "--degree", "--threads", "--check",
        )  # fmt: skip
        option = field.option.split("/")[0] if rng.random() < 0.93 else others[rng.integers(len(others))]
        if "/" in field.option and option in field.option:
            found += option.split(" ")
            continue
        value = field.about.example if rng.random() < 0.7 else VALUES[rng.integers(len(VALUES))]
        if field.option.startswith("--set ") or rng.random() < 0.3:
            found += f"{option}={value}".split(" ", 1)
        else:
            found += [option, value]
    return found


def _outcome(words: list[str], whole: bool) -> tuple[int | None, str, str]:
    """Exit code, standard error, and what is wrong with them."""
    out, err = io.StringIO(), io.StringIO()
    stops = contextlib.ExitStack()
    with stops, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        if not whole:
            for module, name in WORK:
                stops.enter_context(mock.patch.object(module, name, _stop))
        try:
            code = main(words)
        except SystemExit as error:
            return None, "", f"SystemExit {error.code}"
        except BaseException as error:
            return None, "", f"{type(error).__name__}: {str(error)[:200]}"
    text = err.getvalue()
    if code not in (0, 1, 2) or (code == 1 and not whole):
        return code, text, f"exit code {code}"
    if code == 2 and ("error: " not in text or "\n  try:" not in text):
        return code, text, f"no error in three parts: {text[:200]!r}"
    if "Traceback" in text or len(text) > LONGEST or not text.replace("\n", "").isprintable():
        return code, text, f"standard error of {len(text)} characters: {text[:200]!r}"
    return code, text, ""


def _stop(*arguments: Any, **others: Any) -> None:
    """Instead of the work: numbers of the specification or the settings are finite."""
    given = next((one for one in arguments if hasattr(one, "gamma_ratio")), None)
    for name, value in vars(given).items() if given is not None else ():
        if isinstance(value, float) and not math.isfinite(value):
            raise AssertionError(f"{name} = {value}")
    raise _ReachedError("The words are understood.", "here the work would begin", "nothing")
