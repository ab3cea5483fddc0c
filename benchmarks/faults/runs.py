"""Runs of arms with faults, drawn by a seed, several at a time, and kept as they come.

A run is known by its arm, its fault and a seed of its own, from which all else is drawn: the robot within its
tolerances, the moves, the noise, when the fault comes, to which joint, how large.
"""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.faults.arms import BUILD, Program
from benchmarks.faults.kinds import FAULTS, HARMLESS, MOVES, MOVES_OF_A_RUN, Fault, drawn, fitting
from benchmarks.faults.verdict import HARM

__all__ = ["ALL", "Campaign", "Planned", "keep_smallest", "one", "smallest_of"]

#: Faults, what is harmless, and moves, by name.
ALL: Mapping[str, Fault] = {**FAULTS, **HARMLESS, MOVES.name: MOVES}
#: Smallest sizes that move an arm by 0.05 rad where nothing stops it, by arm and fault.
SMALLEST = Path(__file__).resolve().parent / "smallest.json"
#: Runs that a program is asked for at once.
CHUNK = 12


@dataclass(frozen=True)
class Planned:
    """A run that is to be made."""

    arm: str
    fault: str
    seed: int

    @property
    def key(self) -> str:
        """What names it."""
        return f"{self.arm}/{self.fault}/{self.seed}"


def _smallest_file(program: Program) -> Path:
    """Of the arms here one that is kept; of another one beside its program."""
    return SMALLEST if program.arm.design is None else program.path.with_suffix(".json")


def kept_smallest(program: Program) -> dict[str, float]:
    """Smallest sizes of an arm's faults; none where they were not looked for."""
    file = _smallest_file(program)
    return json.loads(file.read_text(encoding="utf-8")).get(program.arm.name, {}) if file.exists() else {}


def keep_smallest(program: Program) -> None:
    """Look for the smallest sizes of an arm's faults, and keep them."""
    file = _smallest_file(program)
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    known[program.arm.name] = smallest_of(program)
    file.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def one(program: Program, planned: Planned, trace: Path | None = None, **more: Any) -> dict[str, Any]:
    """What was found in one run; `more` are keys for the runner."""
    return _made(program, [planned], trace, **more)[0]


def _made(
    program: Program, runs: Sequence[Planned], trace: Path | None = None, **more: Any
) -> list[dict[str, Any]]:
    smallest = kept_smallest(program)
    requests = [drawn(ALL[run.fault], program.facts, smallest, run.seed) | more for run in runs]
    reasons = [
        {"hidden": ALL[run.fault].hidden(program.facts), "slow": ALL[run.fault].slow(program.facts)}
        for run in runs
    ]
    found = program.lines(requests, trace)
    return [
        {"arm": run.arm, "fault": run.fault}
        | why
        | {key: request[key] for key in ("joint", "magnitude", "x")}
        | row
        for run, request, why, row in zip(runs, requests, reasons, found, strict=True)
    ]


@dataclass(frozen=True)
class Campaign:
    """`count` runs of every fault and harmless event, and `moves` moves, of some arms; kept in `folder`."""

    programs: Mapping[str, Program]
    seed: int
    count: int
    moves: int
    folder: Path = BUILD / "rows"

    def planned(self) -> list[Planned]:
        """All runs; those of a fault with fewer runs are the first of more."""
        found = list[Planned]()
        for name, program in self.programs.items():
            harmless = [fault for fault in HARMLESS.values() if fault.needs(program.facts)]
            for fault in (*fitting(program.facts), *harmless, MOVES):
                many = -(-self.moves // MOVES_OF_A_RUN) if fault is MOVES else self.count
                chance = random.Random(f"{self.seed}/{name}/{fault.name}")
                found += [Planned(name, fault.name, chance.getrandbits(40)) for _ in range(many)]
        return found

    def _file(self, arm: str) -> Path:
        return self.folder / f"{arm}-{self.programs[arm].digest}-{self.seed}.jsonl"

    def rows(self) -> list[dict[str, Any]]:
        """The rows of the plan that are there, in its order."""
        kept = {
            f"{row['arm']}/{row['fault']}/{row['seed']}": row
            for arm in self.programs
            if self._file(arm).exists()
            for row in map(json.loads, self._file(arm).read_text(encoding="utf-8").splitlines())
        }
        return [kept[run.key] for run in self.planned() if run.key in kept]

    def make(self, advance: Callable[[int], object] = lambda count: None) -> None:
        """Make the rows that are missing; `advance` is told how many more are there."""
        self.folder.mkdir(parents=True, exist_ok=True)
        kept = {f"{row['arm']}/{row['fault']}/{row['seed']}" for row in self.rows()}
        missing = [run for run in self.planned() if run.key not in kept]
        advance(len(kept))
        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            for rows in pool.map(self._chunk, _chunks(missing)):
                with self._file(rows[0]["arm"]).open("a", encoding="utf-8") as file:
                    file.write("".join(f"{json.dumps(row)}\n" for row in rows))
                advance(len(rows))

    def _chunk(self, runs: Sequence[Planned]) -> list[dict[str, Any]]:
        return _made(self.programs[runs[0].arm], runs)


def _chunks(runs: Sequence[Planned]) -> Iterator[Sequence[Planned]]:
    """Runs of one arm at a time."""
    begin = 0
    for k in range(1, len(runs) + 1):
        if k == len(runs) or runs[k].arm != runs[begin].arm or k - begin == CHUNK:
            yield runs[begin:k]
            begin = k


# Smallest sizes -------------------------------------------------------------------------------------
#: Seeds of the runs in which a smallest size is looked for, steps of its range (a large jump is refused and moves
#: nothing, so it is looked for from below), and halvings of the step.
TRIED, STEPS, HALVINGS = (1, 2, 3), 8, 3


def smallest_of(program: Program) -> dict[str, float]:
    """For each fault with sizes the smallest x by which one of three runs moves the arm by 0.05 rad while nothing stops
    it; faults that never move it so far are left out."""
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        sized = [fault for fault in fitting(program.facts) if fault.sized]
        found = pool.map(lambda fault: _smallest(program, fault), sized)
        return {fault.name: x for fault, x in zip(sized, found, strict=True) if x is not None}


def _smallest(program: Program, fault: Fault) -> float | None:
    def moves(x: float) -> bool:
        requests = [drawn(fault, program.facts, {}, seed, x) | {"never": 1} for seed in TRIED]
        return any(row["wrong"] > HARM for row in program.lines(requests))

    ratio = (fault.high / fault.low) ** (1.0 / STEPS)
    found = next((k for k in range(STEPS + 1) if moves(fault.low * ratio**k)), None)
    if not found:
        return None if found is None else fault.low
    low, high = fault.low * ratio ** (found - 1), fault.low * ratio**found
    for _ in range(HALVINGS):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if moves(middle) else (middle, high)
    return float(f"{high:.3g}")
