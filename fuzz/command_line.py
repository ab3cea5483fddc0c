"""Random words for the command line: exit codes 0, 1 and 2 only, no traceback, few lines on standard error.

What the options say is checked in full; the design, the comparison and the paper's experiments themselves are replaced
by a stop, so that an attempt takes milliseconds. A few designs of a small robot run whole.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import flexhinf.paper
from flexhinf.cli import main
from flexhinf.design.specification import FIELDS
from flexhinf.errors import FlexhinfError
from fuzz.tally import Tally

ATTEMPTS = 1000
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
    "jerk-limited", "jump",
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
)  # fmt: skip
QUICK = (
    "--degrees",
    "2",
    "--rays",
    "0",
    "--draws",
    "0",
    "--no-compare-rigid",
    "--estimator",
    "none",
    "--duration",
    "1",
)


#: What is replaced by a stop.
WORK = (
    (flexhinf, "design"), (flexhinf, "compare"), (flexhinf.paper, "reproduce"),
    (import_module("flexhinf.design.certification"), "certify_design"),
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
                words = ["design", "arm.toml", *QUICK, *_options(rng, 1)] if whole else _words(rng)
                how = f"seed {seed}, attempt {attempt}: {ascii(words)[:300]}"
                code, error, fault = _outcome(words, whole)
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
    return [*words, *_options(rng, int(rng.integers(0, 5)))]


def _options(rng: np.random.Generator, count: int) -> list[str]:
    """Options with their own example, or with any value."""
    found: list[str] = []
    for _ in range(count):
        field = list(FIELDS.values())[rng.integers(len(FIELDS))]
        others = (
            "--out", "--elastic", "--laws", "--tune", "--payload", "--pose-xyz", "--goal", "--tool", "--gamma-ratio",
            "--unknown", "--peak-voltage", "-x", "--decay", "--observer", "--degree", "--threads", "--check",
        )  # fmt: skip
        option = field.option.split("/")[0] if rng.random() < 0.93 else others[rng.integers(len(others))]
        if "/" in field.option and option in field.option:
            found.append(option)
            continue
        value = field.about.example if rng.random() < 0.7 else VALUES[rng.integers(len(VALUES))]
        found += [f"{option}={value}"] if rng.random() < 0.3 else [option, value]
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
    given = next(one for one in arguments if hasattr(one, "gamma_ratio"))
    for name, value in vars(given).items():
        if isinstance(value, float) and not math.isfinite(value):
            raise AssertionError(f"{name} = {value}")
    raise _ReachedError("The words are understood.", "here the work would begin", "nothing")
