"""Arms with their controllers, exported and compiled, each made once and kept.

The arms here have the law that `flexhinf design FILE` finds with some options, and the C that `flexhinf export c` makes
of it, without the tests of either; a nightly test compares. An arm of the caller's own has its design, and is exported
by the command. A folder is named by a digest of all that it is made of.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import flexhinf as fh
from benchmarks.faults.kinds import Facts
from benchmarks.faults.robot import Robot, read_robot, source
from benchmarks.limits.arms import noise_in
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.evidence import LoopOverWorkspace
from flexhinf.designs.workspace.search import tuned_setup
from flexhinf.export.controller_c import code_of
from flexhinf.export.package import FILES, Export, files_of, write_files
from flexhinf.export.self_test import Accuracy
from flexhinf.robot.workspace import workspace_of

__all__ = ["ARMS", "BUILD", "Program", "Source", "program_of"]

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
#: Where all is kept, beside the repository's other builds.
BUILD = REPOSITORY / "build" / "faults"
BOTH = ("link_position", "motor_position")
#: What `bench.h` calls measurements.
SENSORS = ("link_position", "motor_position", "joint_torque", "deflection", "link_velocity", "motor_velocity")
#: Sources of a program, beside those of the export.
PARTS = ("plant.c", "faults.c", "moves.c", "record.c", "runner.c")
#: Variance that a design assumes of encoders where none is stated, rad².
USUAL_NOISE = fh.Specification().measurement_noise
#: Ratio of a gear whose file states none: of a turn of its motor's encoder, seen at the joint.
USUAL_RATIO = 100.0


@dataclass(frozen=True)
class Source:
    """An arm: its file, the settings of its design or the folder of one that is there, and how it is exported.

    `brakes`: whether joints that do not say so have them.
    """

    name: str
    about: str
    file: Path
    settings: Mapping[str, Any] = field(default_factory=dict)
    real: str = "double"
    brakes: bool = True
    design: Path | None = None

    @property
    def command(self) -> list[str]:
        """Words of the command that makes the same law, and tests it."""
        words = ["design", str(self.file)]
        for key, value in self.settings.items():
            words += [
                f"--{key.replace('_', '-')}",
                ",".join(value) if isinstance(value, tuple) else str(value),
            ]
        return words


#: By name.
ARMS: Mapping[str, Source] = {
    arm.name: arm
    for arm in (
        Source("one", "one joint without a brake, torque drive, both encoders", HERE / "robots" / "one.toml",
               {"measured": BOTH}, brakes=False),
        Source("two", "two joints, voltages, both encoders", HERE / "robots" / "two.toml", {"measured": BOTH}),
        Source("servo", "two joints, position drives every 4 ms, both encoders", HERE / "robots" / "servo.toml",
               {"measured": BOTH, "period": 4e-3, "latency": 2}),
        Source("six", "six joints, torque drives, motor encoders, float", HERE / "robots" / "six.toml",
               {"measured": ("motor_position",), "measurement_noise": 1e-10}, real="float"),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Program:
    """What runs an arm: the path of the program, the folder of its export, the robot and its facts."""

    arm: Source
    path: Path
    export: Path
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


def program_of(arm: Source, build: Path = BUILD) -> Program:
    """Export and compile what is not there."""
    own = [] if arm.design is None else [arm.design / "design.json"]
    made = digest_of(arm.file, repr(arm.settings), arm.real, *own, REPOSITORY / "src" / "flexhinf")
    export = build / f"{arm.name}-{made}.export"
    if not (export / "arm.c").exists():
        (_exported if arm.design is None else _exported_design)(arm, export)
    robot = read_robot(arm.file, arm.brakes)
    header = (export / "arm.h").read_text(encoding="utf-8")
    sensors = ", ".join(sensors_of(arm, robot, header))
    text = f'#include "bench.h"\n\n{source(robot)}\nconst sensor SENSORS[] = {{{sensors}}};\n'
    digest = digest_of(made, text, *(HERE / name for name in (*PARTS, "plant.h", "bench.h", "decide.h")))
    path = build / f"{arm.name}-{digest}.runner"
    if not path.exists():
        (export / "robot.c").write_text(text, encoding="utf-8")
        _compile(export, path)
    return Program(arm, path, export, robot, _facts(robot, header), digest)


def _exported(arm: Source, folder: Path) -> None:
    """The law that a design finds, as C: the files that firmware compiles."""
    robot = fh.load_robot(arm.file)
    specification = fh.Specification(workspace="limits", **arm.settings)
    setup = tuned_setup(robot, specification, Task(workspace_of(robot)))
    code = code_of(LoopOverWorkspace(setup).controller(), "arm", arm.real, robot)
    files = [file for file in FILES if file.template in ("follow.c", "follow.h")]
    write_files(folder, {**code.files, **files_of(Export(code, (), Accuracy((), (), ""), {}), files)})


def _exported_design(arm: Source, folder: Path) -> None:
    """A design of the caller's, by the command; RuntimeError where it refuses."""
    words = ["export", "c", str(arm.design), "--name", "arm", "--real", arm.real, "--out", str(folder)]
    command = [sys.executable, "-m", "flexhinf", *words, "--accept-estimates", "--accept-unmet"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"flexhinf {' '.join(words)}\n{done.stdout}{done.stderr}")


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


def noise_of(arm: Source) -> tuple[float, float | None, float]:
    """What the design assumes of encoders: standard deviations where joints turn, rad, and slide, m, and the step of
    values."""
    if arm.design is None:
        return arm.settings.get("measurement_noise", USUAL_NOISE) ** 0.5, None, 0.0
    design = (arm.design / "design.toml").read_text(encoding="utf-8")
    quantum = re.search(r"\bquantisation = ([0-9.e-]+)", design)
    return *noise_in(design), float(quantum[1]) if quantum else 0.0


def sensors_of(arm: Source, robot: Robot, header: str) -> list[str]:
    """Rows of `sensor` in C, in the order of the exported measurements."""
    noise, sliding, step = noise_of(arm)
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
