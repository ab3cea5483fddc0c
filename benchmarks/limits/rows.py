"""Rows: one file for each arm, of its design, its rivals' tuning, and what each law did in each trial.

A row is kept as soon as it is there, so that an interrupted run goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.limits.arms import ARMS, ENCODED, MEASURED, described, design_of, robot_of
from benchmarks.limits.encoders import step_of
from benchmarks.limits.laws import PLAIN, TITLES, Product, Rival, Runs, tuned
from benchmarks.limits.pushes import pushed
from benchmarks.limits.trials import CURVED, ENCODERS, FRAMES, TRIALS, follow, limits_of, many_goals, noise_of
from benchmarks.workspace.arm import Arm

__all__ = ["GROUPS", "NONE", "PUSHED", "ROWS", "Bench", "kept", "named_rows"]

#: The rows that the docs show.
ROWS = Path(__file__).resolve().parent / "rows"
MET, PUSHED, PRODUCT = "met", "pushes", "flexhinf"
#: What ``--rows`` may name at once.
GROUPS = {
    "met": [MET], "tracking": list(CURVED), "limits": list(TRIALS), "pushes": [PUSHED],
    "encoders": list(ENCODERS), "frames": list(FRAMES),
}  # fmt: skip
#: Rows of some arms alone.
FEW = {**ENCODERS, **FRAMES}
#: What is said of a rival without a law.
NONE = "no candidate is stable"
#: Noise of the encoders of joints that slide, m, in the moves by which "met" is looked at, where no design states it.
SLIDING = 1e-5


def named_rows(names: Sequence[str]) -> list[str]:
    """Rows of the groups and of the names."""
    return [row for name in names for row in GROUPS.get(name, [name])]


def kept(folder: Path, arm: str) -> dict[str, Any]:
    """All rows of an arm."""
    place = folder / f"{arm}.json"
    return json.loads(place.read_text(encoding="utf-8")) if place.exists() else {}


def made(arm: str, row: str, law: str) -> bool:
    """True where an arm has such a row of a law. Few arms have those of encoders and frames, beside PD alone, which can
    do nothing with samples that are missing; encoders of links are slow where there are some."""
    if row in FEW:
        told = law == PRODUCT or (law == "pd" and not FEW[row].missing)
        there = FEW[row].half_rate != "links" or (arm in ENCODED and ENCODED[arm].measured == MEASURED)
        return arm in ENCODED and told and there
    return arm in ARMS and (row != PUSHED or law == PRODUCT)


class Bench:
    """Makes the rows of one arm; designs and files of others are in the two folders."""

    def __init__(self, arm: str, rows: Path, designs: Path, files: Path | None) -> None:
        self.name, self.rows, self.designs = arm, rows, designs
        self.robot = robot_of(arm, files)
        self.arm = Arm.of(self.robot)
        self.data = kept(rows, arm)

    def keep(self) -> None:
        """Write what is there: under another name first."""
        self.rows.mkdir(parents=True, exist_ok=True)
        part = self.rows / f"{self.name}.part"
        part.write_text(json.dumps(self.data, indent=1) + "\n", encoding="utf-8")
        part.replace(self.rows / f"{self.name}.json")

    def law(self, name: str) -> Runs | None:
        """A law, tuned where it is a rival and has not been; None without a design, or without a stable candidate."""
        if name in (PRODUCT, PLAIN):
            found = design_of(self.designs, self.name)
            return None if found is None else Product(self.robot, found[0], name == PRODUCT)
        rivals = self.data.setdefault("tuned", {})
        if name not in rivals:
            rivals[name] = tuned(self.arm, name, noise_of(self.arm))
            self.keep()
        return None if rivals[name] is None else Rival(self.arm, name, rivals[name]["numbers"])

    def make(self, rows: Sequence[str], laws: Sequence[str], again: bool = False) -> Iterator[str]:
        """Make the rows that are missing, or all; what is to be said of each. The design is described first."""
        if (found := described(self.designs, self.name)) is not None:
            self.data["design"] = found
            self.keep()
        for name in laws:
            wanted = [row for row in rows if again or name not in self.data.get(row, {})]
            wanted = [row for row in wanted if made(self.name, row, name)]
            if not wanted:
                continue
            law = self.law(name)
            if law is None:
                yield f"{self.name} {TITLES[name]}: {'no design' if name in (PRODUCT, PLAIN) else NONE}"
                continue
            for row in wanted:
                if row == MET and name == PRODUCT and not self.data["design"]["met"]:
                    yield f"{self.name}: its design is not met"
                    continue
                self.data.setdefault(row, {})[name] = self.one(row, name, law)
                self.keep()
                yield f"{self.name} {row} {TITLES[name]}"

    def one(self, row: str, name: str, law: Runs) -> dict[str, Any]:
        """One row; a design has the noise in its moves that it assumes, rivals that by which they were tuned."""
        if row == MET:
            design = self.data.get("design", {})
            own = np.where(self.arm.slides, design.get("sliding") or SLIDING, design.get("noise", 0.0))
            return many_goals(self.arm, law, own if name == PRODUCT else noise_of(self.arm))
        if row == PUSHED:
            own, bare = law, self.law(PLAIN)
            assert isinstance(own, Product)
            assert isinstance(bare, Product)
            return pushed(self.arm, own, bare)
        if row in ENCODERS and isinstance(law, Product):
            law = law.told(step_of(self.arm, ENCODERS[row].bits))
        trials = TRIALS | FEW
        return limits_of(self.arm, law, trials[row]) if row in trials else follow(self.arm, law, row)
