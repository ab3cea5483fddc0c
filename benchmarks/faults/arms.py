"""Arms with their designs, exports and programs, each made once and kept.

A folder is named by a digest of what it is made of: of the robot file and the command for a design, of these and of
flexhinf's source for an export, of both and of the C here for a program.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.faults.kinds import Facts
from benchmarks.faults.robot import Robot, read_robot, source
from benchmarks.limits.arms import noise_in

__all__ = ["ARMS", "BUILD", "Program", "Source", "program_of"]

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
#: Where all is kept, beside the repository's other builds.
BUILD = REPOSITORY / "build" / "faults"
BOTH = "link_position,motor_position"
#: What `bench.h` calls measurements.
SENSORS = ("link_position", "motor_position", "joint_torque", "deflection", "link_velocity", "motor_velocity")
#: Sources of a program, beside those of the export.
PARTS = ("plant.c", "faults.c", "moves.c", "record.c", "runner.c")
#: Ratio of a gear whose file states none: of a turn of its motor's encoder, seen at the joint.
USUAL_RATIO = 100.0


@dataclass(frozen=True)
class Source:
    """An arm: its file, the options of its design or the folder of one that is there, and how it is exported.

    `brakes`: whether joints that do not say so have them.
    """

    name: str
    about: str
    file: Path
    options: tuple[str, ...] = ()
    real: str = "double"
    brakes: bool = True
    design: Path | None = None


#: By name.
ARMS: Mapping[str, Source] = {
    arm.name: arm
    for arm in (
        Source("one", "one joint without a brake, torque drive, both encoders", HERE / "robots" / "one.toml",
               ("--measured", BOTH), brakes=False),
        Source("two", "two joints, voltages, both encoders", HERE / "robots" / "two.toml", ("--measured", BOTH)),
        Source("servo", "two joints, position drives every 4 ms, both encoders", HERE / "robots" / "servo.toml",
               ("--measured", BOTH, "--period", "4ms", "--latency", "2")),
        Source("six", "six joints, torque drives, motor encoders, float", HERE / "robots" / "six.toml",
               ("--measured", "motor_position", "--measurement-noise", "0.01mrad"), real="float"),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Program:
    """What runs an arm: the path of the program, the robot, and what decides which faults it may have."""

    arm: Source
    path: Path
    robot: Robot
    facts: Facts
    digest: str

    def lines(self, requests: Sequence[Mapping[str, Any]], trace: Path | None = None) -> list[dict[str, Any]]:
        """What was found in each run, in their order."""
        text = "".join(
            " ".join(f"{key}={value!r}".replace("'", "") for key, value in request.items() if key != "x")
            + "\n"
            for request in requests
        )
        command = [str(self.path), *([str(trace)] if trace else [])]
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{self.arm.name}: {done.stderr.strip() or done.returncode}")
        return [json.loads(line) for line in done.stdout.splitlines()]


def digest_of(*parts: str | bytes | Path) -> str:
    """The first digits of the SHA-256 of texts and files; of a folder, of all that is in it."""
    found = hashlib.sha256()
    for part in parts:
        files = sorted(part.rglob("*")) if isinstance(part, Path) and part.is_dir() else [part]
        for one in files:
            if isinstance(one, Path):
                if one.is_file() and "__pycache__" not in one.parts:
                    found.update(one.read_bytes())
            else:
                found.update(one.encode() if isinstance(one, str) else one)
        found.update(b"\0")
    return found.hexdigest()[:12]


def _flexhinf(words: Sequence[str], out: Path) -> None:
    """Run a command that writes a folder; what it prints is kept beside it. RuntimeError where it writes none."""
    done = subprocess.run(
        [sys.executable, "-m", "flexhinf", *words, "--out", str(out)], capture_output=True, text=True, check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    out.parent.mkdir(parents=True, exist_ok=True)
    out.with_suffix(".txt").write_text(done.stdout + done.stderr, encoding="utf-8")
    if not out.is_dir():
        raise RuntimeError(f"flexhinf {' '.join(words)}\n{done.stdout}{done.stderr}")


def program_of(arm: Source, build: Path = BUILD) -> Program:
    """Design, export and compile what is not there."""
    design = arm.design or build / f"{arm.name}-{digest_of(arm.file, *arm.options)}"
    if not (design / "design.json").exists():
        _flexhinf(["design", str(arm.file), *arm.options], design)
    made = digest_of(
        arm.file, *arm.options, design / "design.json", arm.real, REPOSITORY / "src" / "flexhinf"
    )
    export = build / f"{arm.name}-{made}.export"
    if not (export / "arm.c").exists():
        words = ["--name", "arm", "--real", arm.real, "--accept-estimates", "--accept-unmet"]
        _flexhinf(["export", "c", str(design), *words], export)
    robot = read_robot(arm.file, arm.brakes)
    header = (export / "arm.h").read_text(encoding="utf-8")
    sensors = sensors_of(arm, robot, header, (design / "design.toml").read_text(encoding="utf-8"))
    text = f'#include "bench.h"\n\n{source(robot)}\nconst sensor SENSORS[] = {{{", ".join(sensors)}}};\n'
    digest = digest_of(made, text, *(HERE / name for name in (*PARTS, "plant.h", "bench.h", "decide.h")))
    path = build / f"{arm.name}-{digest}.runner"
    if not path.exists():
        (export / "robot.c").write_text(text, encoding="utf-8")
        _compile(export, path)
    return Program(arm, path, robot, _facts(robot, header), digest)


def _compile(export: Path, path: Path) -> None:
    """Compile a program: warnings of the files here are errors; the export has its own tests."""
    own = [str(HERE / name) for name in PARTS]
    made = [str(export / name) for name in ("robot.c", "arm.c", "arm_follow.c")]
    part = path.with_suffix(".part")
    for files, strict in ((own, ["-Wall", "-Wextra", "-Werror"]), (made, [])):
        command = ["gcc", "-std=c99", "-O2", *strict, f"-I{export}", f"-I{HERE}", "-c", *files]
        done = subprocess.run(command, cwd=export, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{path.name}: gcc\n{done.stderr[:2000]}")
    objects = [str(export / f"{Path(name).stem}.o") for name in (*own, *made)]
    subprocess.run(["gcc", *objects, "-lm", "-o", str(part)], check=True)
    part.replace(path)


def sensors_of(arm: Source, robot: Robot, header: str, design: str) -> list[str]:
    """Rows of `sensor` in C, in the order of the exported measurements."""
    noise, sliding = noise_in(design)
    quantum = re.search(r"\bquantisation = ([0-9.e-]+)", design)
    step = float(quantum[1]) if quantum else 0.0
    stated = tomllib.loads(arm.file.read_text(encoding="utf-8"))["joint"]
    names = [name.upper() for name in robot.joints]
    rows = list[str]()
    for signal in measurements(header):
        kind = next(kind for kind in SENSORS if signal.startswith(kind.upper()))
        name = signal[len(kind) + 1 :]
        j = names.index(name) if name else 0
        own = noise if not robot.slides[j] or sliding is None else sliding
        motor = next(row for row in stated if row["name"] == robot.joints[j]).get("motor", {})
        ratio = motor.get("gear_ratio", USUAL_RATIO)
        ratio = float(ratio["value"] if isinstance(ratio, dict) else ratio)
        turn = 2.0 * math.pi / (ratio if kind.startswith("motor") else 1.0)
        rows.append(
            f"{{{kind.upper()}, {j}, {own if kind.endswith('position') else 0.0!r}, {step!r}, {turn!r}}}"
        )
    return rows


def measurements(header: str) -> list[str]:
    """Names of an export's measurements, in their order, as they stand behind ``ARM_Y_``."""
    found = {int(number): name for name, number in re.findall(r"\bARM_Y_(\w+) = (\d+)", header)}
    return [found[k] for k in range(len(found))]


def _facts(robot: Robot, header: str) -> Facts:
    signals = measurements(header)
    payload = robot.fields["payload"][0][0]
    period = re.search(r"#define ARM_PERIOD ([0-9.e-]+)", header)
    assert period is not None
    count = len(robot.joints)
    return Facts(
        count, sum(name.startswith("LINK_POSITION") for name in signals) == count,
        any(name.startswith("MOTOR") for name in signals), robot.drive, (payload.low, payload.high), float(period[1]),
        bool(robot.nominal("brake")[0] >= 0.0),
    )  # fmt: skip
