"""Rows, each kept as a file when it is whole: a law for a robot (tuning, damping, margins), and each of its runs."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.workspace import goals as the_goals
from benchmarks.workspace.arm import Arm
from benchmarks.workspace.laws import FASTEST, LAWS, SHARES, TUNING, TUNING_SEED, Choice, Law, bandwidths
from benchmarks.workspace.linear import MARGINS, PoseLoop, judged
from benchmarks.workspace.metrics import summary
from benchmarks.workspace.plants import PLANTS
from benchmarks.workspace.robots import ROBOTS, Entry, true_arms
from benchmarks.workspace.size import object_bytes
from benchmarks.workspace.trip import CONDITIONS, Condition, trip

__all__ = ["ROWS", "Bench", "kept", "law_name", "law_record", "row_name", "written"]

#: The rows that the docs show.
ROWS = Path(__file__).resolve().parent / "rows"

#: Where tuning looks: poses of linear loops, what their margins should be, and the largest ripple, per cent.
TUNED_POSES, TUNED_DELAY, TUNED_GAIN, TUNED_RIPPLE = 8, 1.0, 2.0, 1.5


def kept(folder: Path, name: str) -> dict[str, Any] | None:
    """A row, if it is there."""
    place = folder / f"{name}.json"
    return json.loads(place.read_text(encoding="utf-8")) if place.exists() else None


def written(folder: Path, name: str, row: dict[str, Any]) -> None:
    """Keep a row: under another name first."""
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f"{name}.part"
    part.write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
    part.replace(folder / f"{name}.json")


def law_name(robot: str, law: str, links: bool) -> str:
    """Name of the record of a law."""
    return f"{robot}.{law}{'' if links else '.motors-alone'}"


def row_name(robot: str, law: str, plant: str, condition: str) -> str:
    """Name of a row."""
    return f"{robot}.{law}.{plant}.{condition}"


# Laws ---------------------------------------------------------------------------------------------
def judged_at(
    arm: Arm, law: Law, links: bool, count: int, seed: int = the_goals.POSES_SEED
) -> dict[str, Any]:
    """The smallest of every number over random poses; None where the loop is unstable at one of them."""
    loops: list[PoseLoop] = []
    least = dict.fromkeys(MARGINS, np.inf)
    for q in the_goals.poses(arm, count, seed):
        try:
            loops.append(judged(arm, q, law.linear(q), links, enough=list(least.values())))
        except (fh.FlexhinfError, np.linalg.LinAlgError):  # no controller at this pose
            loops.append(PoseLoop(False, np.inf, np.inf, np.nan, np.nan, np.nan))
        for name in MARGINS:  # NaN, where it is unstable, ends the search at every later pose
            value = getattr(loops[-1], name)
            least[name] = min(least[name], -np.inf if np.isnan(value) else value)
    found: dict[str, Any] = {"poses": count, "stable": sum(loop.stable for loop in loops)}
    for name in ("damping", "fast"):
        least[name] = min(getattr(loop, name) for loop in loops)
    return found | {
        name: float(f"{value:.6g}") if np.isfinite(value) else None for name, value in least.items()
    }


def tuned(
    entry: Entry, arm: Arm, choice: Choice, links: bool
) -> tuple[dict[str, float], list[dict[str, Any]]]:
    """The share and the largest bandwidth of the rule in `laws`, and what every share did with the latter."""
    loaded = true_arms(entry, "payload")[0]
    moves = the_goals.moves(arm, the_goals.goals(arm, loaded, TUNING, TUNING_SEED)[0])
    fewest, fastest, tried = 4, 0.0, list[dict[str, Any]]()
    for largest in FASTEST:
        placed = [_placed(arm, choice, links, share, largest) for share in SHARES]
        if (missed := min(map(_missed, placed))) < fewest:
            fewest, fastest, tried = missed, largest, placed
        if not fewest:
            break
    first = min(one["place"] for one in tried)
    seen: dict[bytes, dict[str, Any]] = {}  # shares with which all bandwidths are the largest are one
    for one in [one for one in tried if one["place"] == first]:
        key = bandwidths(arm, one["share"], fastest).tobytes()
        if key not in seen:
            law = choice.make(arm, links, one["share"], fastest)
            run = trip(PLANTS["mujoco"], law, [arm], moves, Condition("tuning", links=links))
            seen[key] = summary(run.moves)
        one |= {name: seen[key][name] for name in ("arrived", "remaining_worst", "ripple")}

    def order(one: dict[str, Any]) -> tuple[Any, ...]:
        worst, ripple = (np.inf if one[key] is None else one[key] for key in ("remaining_worst", "ripple"))
        rings = ripple > TUNED_RIPPLE
        return rings, -one["arrived"], ripple if rings else worst

    share = min((one for one in tried if one["place"] == first), key=order)["share"]
    return {"share": share, "fastest": fastest}, tried


def _placed(arm: Arm, choice: Choice, links: bool, share: float, fastest: float) -> dict[str, Any]:
    """A candidate's margins at the poses of the tuning, and its place: 0 if it keeps both, 2 if it is unstable."""
    law = choice.make(arm, links, share, fastest)
    margins = judged_at(arm, law, links, TUNED_POSES, TUNING_SEED)
    delay, gain = margins["damped_delay"], margins["gain"]
    one = {"share": share, "place": 0, "delay": delay, "gain": gain}
    return one | {"place": (0, 1, 1, 2)[_missed(one)]}


def _missed(one: dict[str, Any]) -> int:
    """Margins that a candidate misses; 3 where it is unstable."""
    delay, gain = one["delay"], one["gain"]
    return 3 if delay is None or gain is None else (delay < TUNED_DELAY) + (gain < TUNED_GAIN)


def numbers(choice: Choice, record: dict[str, Any], folder: Path) -> tuple[Any, ...]:
    """What a law is made with, beside its robot and its sensors."""
    return (record["share"], record["fastest"]) if choice.tuned else (folder,)


def law_record(entry: Entry, choice: Choice, links: bool, poses: int, folder: Path) -> dict[str, Any]:
    """A law for a robot: its tuning, what its design took, and its linear loops at random poses."""
    arm, record = Arm.of(entry.robot()), dict[str, Any]()
    began = time.process_time()
    if choice.tuned:
        chosen, record["tuning"] = tuned(entry, arm, choice, links)
        record |= chosen
        law = choice.make(arm, links, *numbers(choice, record, folder))
        record["design_cpu"] = time.process_time() - began
    else:
        try:
            law = choice.make(arm, links, folder)
        except fh.FlexhinfError as error:
            return {"poses": poses, "refused": str(error).splitlines()[0]}
        record |= getattr(law, "note", {"design_cpu": time.process_time() - began})
        record["object_bytes"] = object_bytes(getattr(law, "controller", None))
    return record | judged_at(arm, law, links, poses)


def statics(arm: Arm, arms: Sequence[Arm], moves: Sequence[the_goals.Move]) -> float:
    """What remains, rad or m, where the motors stand where the nominal robot's would at the goals: the largest error of
    a link of a true robot."""
    return max(
        float(np.abs(true.sagged(arm.rest(move.goal)[0]) - move.goal).max())
        for true in arms
        for move in moves
    )


# Runs ---------------------------------------------------------------------------------------------
class Bench:
    """The rows of robots, laws, plants and conditions, made one after the other where they are missing.

    A row that was made for another number of goals or poses is made anew.
    """

    def __init__(self, folder: Path, goals: int, poses: int, done: Callable[[], Any] = lambda: None) -> None:
        self.folder, self.goals, self.poses, self.done = folder, goals, poses, done
        self._moves: dict[tuple[str, bool], tuple[list[the_goals.Move], int]] = {}

    def moves(self, robot: str, steps: bool) -> tuple[list[the_goals.Move], int]:
        """The moves of a robot, and how many goals were left out."""
        if (robot, steps) not in self._moves:
            entry = ROBOTS[robot]
            arm, loaded = Arm.of(entry.robot()), true_arms(entry, "payload")[0]
            goals, left = the_goals.goals(arm, loaded, self.goals)
            made = (the_goals.steps if steps else the_goals.moves)(arm, goals)
            self._moves = {(robot, steps): (made, left)}  # those of one robot at a time: they are large
        return self._moves[robot, steps]

    def law(self, robot: str, law: str, links: bool = True) -> dict[str, Any] | None:
        """The record of a law, made where it is missing; None where the law needs sensors that are not there."""
        choice, name = LAWS[law], law_name(robot, law, links)
        if choice.needs_links and not links:
            return None
        record = kept(self.folder, name)
        if record is None or record["poses"] != self.poses:
            self.folder.mkdir(parents=True, exist_ok=True)
            record = law_record(ROBOTS[robot], choice, links, self.poses, self.folder)
            written(self.folder, name, record)
        return record

    def has(self, robot: str, law: str, plant: str, condition: str) -> bool:
        """Whether a row is there, for this number of goals."""
        row = kept(self.folder, row_name(robot, law, plant, condition))
        return row is not None and row["goals"] == self.goals

    def row(self, robot: str, law: str, plant: str, condition: str) -> dict[str, Any] | None:
        """A row, made where it is missing; None where the law cannot be run so."""
        name, choice, how = row_name(robot, law, plant, condition), LAWS[law], CONDITIONS[condition]
        if self.has(robot, law, plant, condition):
            return kept(self.folder, name)
        record = self.law(robot, law, how.links)
        if record is None or "refused" in record:
            return None
        entry = ROBOTS[robot]
        arm, (moves, left) = Arm.of(entry.robot()), self.moves(robot, how.steps)
        made = choice.make(arm, how.links, *numbers(choice, record, self.folder))
        arms = true_arms(entry, how.robots)
        found = trip(lambda true: PLANTS[plant](true, how.friction), made, arms, moves, how, self.done)
        row = {
            "robot": robot, "law": law, "plant": plant, "condition": condition, "goals": self.goals,
            "left_out": left, "refused_steps": found.refused, "step_cpu": found.step_cpu, **summary(found.moves),
        }  # fmt: skip
        if not how.links:
            row["statics"] = statics(arm, arms, moves)
        written(self.folder, name, row)
        return row
