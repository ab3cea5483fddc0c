"""The arms, and their designs: by ``flexhinf design FILE``, or by the command that it names.

Files that belong to others are no part of the repository: ``--files FOLDER`` says where they are. A design is made
where its folder does not hold it yet; what the command printed is kept beside it.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.hardware.robots import ROBOTS as HARDWARE, files_of
from benchmarks.workspace.robots import ROBOTS as LIMITS

__all__ = [
    "ARMS",
    "ENCODED",
    "MEASURED",
    "SOURCES",
    "Source",
    "described",
    "design_of",
    "designed",
    "robot_of",
]

HERE = Path(__file__).resolve().parent
#: Encoders on both sides of every spring.
MEASURED = "link_position,motor_position"
#: What the last line of a design says of a command that meets all.
MEETS = "# meets every requirement"


@dataclass(frozen=True)
class Source:
    """An arm: a name of the catalogue, of `benchmarks.hardware`, or a file; and limits where that states none."""

    name: str
    about: str
    where: str = "catalogue"  # or "robots", the folder here, or "files", those of others
    measured: str = MEASURED

    @property
    def limits(self) -> dict[str, tuple[float, ...]]:
        """Limits of motors and speeds where the file states none, as in docs/workspace.md."""
        entry = LIMITS.get(self.name)
        if entry is None or entry.efforts is None or entry.speeds is None:
            return {}
        return {"effort_limits": entry.efforts, "speed_limits": entry.speeds}

    @property
    def options(self) -> list[str]:
        """The same as options of a command."""
        texts = {name: ",".join(f"{one:g}" for one in values) for name, values in self.limits.items()}
        return (
            ["--saturation", texts["effort_limits"], "--peak-speed", texts["speed_limits"]] if texts else []
        )

    def paths(self, files: Path | None) -> tuple[str, str | None]:
        """What is designed, and the file of the elastic joints of a URDF; FileNotFoundError where it is not here."""
        if self.name in HARDWARE and self.where == "catalogue":
            file, elastic = files_of(self.name)
            return str(file), None if elastic is None else str(elastic)
        if self.where == "catalogue":
            return self.name, None
        place = (HERE / "robots" if self.where == "robots" else files or HERE) / f"{self.name}.toml"
        if not place.exists():
            raise FileNotFoundError(f"{self.name}: no file {place.name} in --files {files}")
        return str(place), None

    def command(self, files: Path | None) -> list[str]:
        """The first command of an engineer, without where its report is written."""
        file, elastic = self.paths(files)
        return [
            "design",
            file,
            *(["--elastic", elastic] if elastic else []),
            "--measured",
            self.measured,
            *self.options,
        ]


#: By name: those of docs/workspace.md, those of others, and two of our own.
ARMS = {
    source.name: source
    for source in (
        Source("paper", "one joint of the paper"),
        Source("planar-two-link", "two joints"),
        Source("scara", "SCARA of the catalogue"),
        Source("spatial", "three joints"),
        Source("seven-link", "light arm of seven joints"),
        Source("ur5", "UR5"),
        Source("panda", "Panda"),
        Source("kgen3r", "seven joints, 39 N·m, payload to 2 kg, wrist without springs", "files"),
        Source("iiwa", "seven joints, 320 N·m", "files"),
        Source("iiwad", "the same, damping of the springs stated", "files"),
        Source("beltscara", "SCARA with a belt at its wrist, payload to 3 kg", "files"),
        Source("pallet", "palletiser, payload to 60 kg", "robots"),
        Source("elastic", "series elastic arm of four joints", "robots"),
    )
}  # fmt: skip
#: Arms of the trials of encoders: with those of both sides, or of the motors alone.
ALONE = {"scara-motors": Source("scara", "the SCARA with motor encoders alone", measured="motor_position")}
ENCODED = {name: ARMS[name] for name in ("planar-two-link", "pallet", "elastic")} | ALONE
#: All that can be designed.
SOURCES = ARMS | ALONE


def design_of(folder: Path, name: str) -> tuple[Path, int] | None:
    """The design of an arm that is run, and by which command it was made: the one that meets all, or the first."""
    made = [(place, k) for k in (1, 2) if (place := folder / f"{name}.{k}" / "design.json").exists()]
    for place, k in made:
        if _json(place)["met"]:
            return place.parent, k
    return (made[0][0].parent, made[0][1]) if made else None


def said(folder: Path, name: str, number: int) -> str:
    """What a command printed."""
    place = folder / f"{name}.{number}.txt"
    return place.read_text(encoding="utf-8") if place.exists() else ""


def named(text: str) -> list[str] | None:
    """The command that a design names because it meets all, without the program and its --out; None where none does."""
    lines = [line for line in text.splitlines() if line.startswith("next: ") and line.endswith(MEETS)]
    if not lines:
        return None
    words = shlex.split(lines[-1].removeprefix("next: "), comments=True)[1:]
    if "--out" in words:
        at = words.index("--out")
        del words[at : at + 2]
    return words


def designed(folder: Path, name: str, files: Path | None) -> Iterator[str]:
    """Make the design of an arm where it is missing, and the one of the command that it names; what is to be said."""
    folder.mkdir(parents=True, exist_ok=True)
    command: list[str] | None = SOURCES[name].command(files)
    for number in (1, 2):
        out = folder / f"{name}.{number}"
        if command is None:
            return
        if not (out / "design.json").exists():
            yield f"flexhinf {shlex.join(command)}"
            run = subprocess.run(
                [sys.executable, "-m", "flexhinf", *command, "--out", str(out)],
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
                env={**os.environ, "COLUMNS": "1000", "OMP_NUM_THREADS": "1"},  # a command in one line
            )  # fmt: skip
            (folder / f"{name}.{number}.txt").write_text(run.stdout, encoding="utf-8")
            if run.returncode not in (0, 1, 2):  # met, not met, refused
                raise SystemExit(f"flexhinf {shlex.join(command)} ended with {run.returncode}:\n{run.stdout}")
        command = None if number == 2 else named(said(folder, name, 1))


def described(folder: Path, name: str) -> dict[str, Any] | None:
    """Whether a design is met, by which command, what that adds to the first one, what the first one missed, the limits
    of moves, and the noise of its encoders, see `noise_in`; None without a design."""
    found = design_of(folder, name)
    if found is None:
        return None
    place, number = found
    design, first = (_json(at / "design.json") for at in (place, folder / f"{name}.1"))
    words = named(said(folder, name, 1)) or []
    turning, sliding = noise_in((place / "design.toml").read_text(encoding="utf-8"))
    return {
        "met": design["met"], "command": number, "more": added(words) if number == 2 else [],
        "missed": sorted({one["what"] for one in first["requirements"] if not one["met"]}),
        "limits": {
            one["what"]: one["limit"] for one in design["requirements"] if "robots at corners" in one["where"]
        },
        "noise": turning, "sliding": sliding,
    }  # fmt: skip


def noise_in(text: str) -> tuple[float, float | None]:
    """Standard deviations of the encoders' noise that a design file states, of joints that turn, rad, and of those that
    slide, m; None where one number is for all. It is a variance, or text in mrad and mm."""
    found = re.search(r"measurement_noise = (.*)", text)
    numbers = re.findall(r"([0-9.e-]+)(mrad|mm)?", found[1].partition("#")[0]) if found else []
    if not numbers:
        raise ValueError("the design file states no measurement_noise")
    if not numbers[0][1]:
        return float(np.sqrt(float(numbers[0][0]))), None
    own = {unit: 1e-3 * float(size) for size, unit in numbers}
    return own["mrad"], own.get("mm")


def added(words: list[str]) -> list[str]:
    """Options of a command that the first one does not have."""
    pairs = itertools.pairwise(words)
    own = ("--measured", "--elastic", "--saturation", "--peak-speed")
    return [text for pair in pairs if pair[0].startswith("--") and pair[0] not in own for text in pair]


def _json(place: Path) -> dict[str, Any]:
    return json.loads(place.read_text(encoding="utf-8"))


def robot_of(name: str, files: Path | None) -> Any:
    """The robot of the file, with limits."""
    source = SOURCES[name]
    file, elastic = source.paths(files)
    return replace(fh.load_robot(file, elastic=elastic), **source.limits)
