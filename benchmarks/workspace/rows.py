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
from benchmarks.workspace.arm import Arm, damped
from benchmarks.workspace.laws import LAWS, TUNING, TUNING_SEED, Choice, Law, Numbers, Overcoming, bandwidths
from benchmarks.workspace.linear import LEAST, MARGINS, PoseLoop, judged
from benchmarks.workspace.metrics import MOST, summary
from benchmarks.workspace.plants import PLANTS
from benchmarks.workspace.robots import ROBOTS, Entry, true_arms
from benchmarks.workspace.size import object_bytes
from benchmarks.workspace.trip import CONDITIONS, Condition, trip

__all__ = ["ROWS", "Bench", "kept", "law_name", "law_record", "row_name", "written"]

#: The rows that the docs show.
ROWS = Path(__file__).resolve().parent / "rows"

#: Poses of linear loops at which tuning looks; lines of the criterion that it counts in moves, and all.
TUNED_POSES, DRIVEN = 20, 2
#: Moves that may show that a candidate is not the best.
FIRST = 2
LINES = len(LEAST) + DRIVEN


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


def make_missing(kind: str, row: Callable[[fh.Robot], dict[str, Any]]) -> int:
    """Make the rows ``ROBOT.kind`` that are not there, one of each robot; returns the exit code of a program."""
    for name in ROBOTS:
        if kept(ROWS, f"{name}.{kind}") is None:
            written(ROWS, f"{name}.{kind}", row(ROBOTS[name].robot()))
    return 0


def law_name(robot: str, law: str, links: bool) -> str:
    """Name of the record of a law."""
    return f"{robot}.{law}{'' if links else '.motors-alone'}"


def row_name(robot: str, law: str, plant: str, condition: str) -> str:
    """Name of a row."""
    return f"{robot}.{law}.{plant}.{condition}"


# Laws ---------------------------------------------------------------------------------------------
def judged_at(
    arm: Arm, law: Law, links: bool, count: int, seed: int = the_goals.POSES_SEED,
    enough: dict[str, float] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The smallest of every number over random poses; None where the loop is unstable at one of them.

    Margins beyond `enough` are not sought, and are `enough` then.
    """
    loops: list[PoseLoop] = []
    least = {name: np.inf if enough is None else enough[name] for name in MARGINS}
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


def lines_of(loops: dict[str, Any]) -> dict[str, bool]:
    """Whether linear loops keep each line of the criterion; none where one of them is unstable."""
    stable = loops["stable"] == loops["poses"]
    return {
        name: stable and loops[name] is not None and loops[name] >= least for name, least in LEAST.items()
    }


def tuned(entry: Entry, arm: Arm, choice: Choice, links: bool) -> tuple[Numbers, list[dict[str, Any]]]:
    """What the rule in `laws` chooses, and all candidates that it looked at.

    None is driven that is unstable, or on that cannot be the best any more.
    """
    loaded = true_arms(entry, "payload")[0]
    moves = the_goals.moves(arm, the_goals.goals(arm, loaded, TUNING, TUNING_SEED)[0])
    tried, seen = list[dict[str, Any]](), set[str]()

    def order(one: dict[str, Any]) -> tuple[float, ...]:
        worst = one.get("remaining_worst")
        return one["lines"], one["stable"], one.get("arrived", 0), -np.inf if worst is None else -worst

    for candidates in choice.candidates:
        judged = list[dict[str, Any]]()
        for numbers in candidates:
            same = _same(arm, numbers)
            if same not in seen:
                seen.add(same)
                judged.append(_judged(arm, choice, links, numbers))
        for one in sorted(judged, key=lambda one: -one["lines"]):
            if one["stable"] == TUNED_POSES:
                law = Overcoming(choice.make(arm, links, **one["numbers"]), arm)
                _driven(one, law, arm, moves, links, max(map(order, tried), default=(-1.0,)))
            tried.append(one)
        if max(map(order, tried))[0] == LINES:
            break
    return max(tried, key=order)["numbers"], tried


def _driven(
    one: dict[str, Any],
    law: Law,
    arm: Arm,
    moves: Sequence[the_goals.Move],
    links: bool,
    best: tuple[float, ...],
) -> None:
    """Add what a candidate does in the moves; in the first of them, or in none, where it comes behind the best."""
    linear, at_most = one["lines"], (one["lines"] + DRIVEN, one["stable"], len(moves), 0.0)
    for count in sorted({min(FIRST, len(moves)), len(moves)}):
        if at_most < best:
            return
        condition = Condition("tuning", links=links)
        run = summary(trip(PLANTS["mujoco"], law, [damped(arm)], moves[:count], condition).moves)
        worst, ripple = (np.inf if run[key] is None else run[key] for key in ("remaining_worst", "ripple"))
        one |= {name: run[name] for name in ("moves", "arrived", "remaining_worst", "ripple")}
        one["lines"] = linear + (ripple <= MOST["ripple"]) + (run["arrived"] == count)
        at_most = one["lines"], one["stable"], len(moves) - count + run["arrived"], -worst


def _same(arm: Arm, numbers: Numbers) -> str:
    """What candidates that are the same law have in common: shares that are beyond the largest bandwidth are one."""
    rest = dict(numbers)
    if "share" in rest:
        rest["w"] = bandwidths(arm, rest.pop("share"), rest.pop("fastest")).tolist()
    return json.dumps(rest)


def _judged(arm: Arm, choice: Choice, links: bool, numbers: Numbers) -> dict[str, Any]:
    """A candidate's linear loops at the poses of the tuning, and how many lines they keep."""
    law = choice.make(arm, links, **numbers)
    loops = judged_at(arm, law, links, TUNED_POSES, TUNING_SEED, LEAST)
    kept = {name: loops[name] for name in ("stable", *LEAST)}
    return {"numbers": numbers, "lines": sum(lines_of(loops).values())} | kept


def made(
    choice: Choice, arm: Arm, links: bool, record: dict[str, Any], folder: Path, overcomes: bool = True
) -> Law:
    """The law of a record, that overcomes dry friction or does not; one that is designed is loaded from the folder."""
    if choice.tuned:
        law = choice.make(arm, links, **record["numbers"])
        return Overcoming(law, arm) if overcomes else law
    product: Any = choice.make(arm, links, folder)
    if overcomes:
        product.overcome()
    return product


def law_record(entry: Entry, choice: Choice, links: bool, poses: int, folder: Path) -> dict[str, Any]:
    """A law for a robot: its tuning, what its design took, and its linear loops at random poses."""
    arm, record = Arm.of(entry.robot()), dict[str, Any]()
    began = time.process_time()
    if choice.tuned:
        record["numbers"], record["tuning"] = tuned(entry, arm, choice, links)
        law = made(choice, arm, links, record, folder)
        record["design_cpu"] = time.process_time() - began
    else:
        try:
            law = made(choice, arm, links, record, folder)
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
        """Whether a row is there, for this number of goals, and with dry friction fed forward where it is to be."""
        row = kept(self.folder, row_name(robot, law, plant, condition))
        fed = CONDITIONS[condition].friction
        return row is not None and row["goals"] == self.goals and row.get("fed_forward") == fed

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
        controller = made(choice, arm, how.links, record, self.folder, how.friction)
        arms = true_arms(entry, how.robots)
        found = trip(lambda true: PLANTS[plant](true, how.friction), controller, arms, moves, how, self.done)
        row = {
            "robot": robot, "law": law, "plant": plant, "condition": condition, "goals": self.goals,
            "fed_forward": how.friction, "left_out": left, "refused_steps": found.refused,
            "step_cpu": found.step_cpu, **summary(found.moves),
        }  # fmt: skip
        if not how.links:
            row["statics"] = statics(arm, arms, moves)
        written(self.folder, name, row)
        return row
