"""Rows of the study, each kept as a file when it is whole: a comparison, and a campaign of the design, of each robot.

A campaign has as many robots of the tolerances as moves, each robot with a move of its own, and then the search for
the worst robot in the move of the worst sample. That of planar-two-link is killed after two batches and continued.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.compared.commands import Spent, Stopped, killed, ran
from benchmarks.hardware.robots import files_of
from flexhinf.campaign import (
    CampaignJudgement,
    Journal,
    MergedTable,
    MetricLimit,
    Replayed,
    merged,
    stored_worst,
)
from flexhinf.designs.campaign_folder import stored_campaign
from flexhinf.pages import worst_text
from flexhinf.pages.campaign_text import interval_text

__all__ = ["BUILD", "KINDS", "LIMIT", "ROBOTS", "ROWS", "Robot", "kept", "make", "nearest"]

#: Largest limit that is for rounding alone.
ROUNDING = 1e-6

#: The rows that the docs show; where commands write.
ROWS = Path(__file__).resolve().parent / "rows"
BUILD = Path(__file__).resolve().parents[2] / "build" / "compared"

#: Most processor seconds of a robot: of its comparison and its campaign together.
LIMIT = 1800.0

#: Samples of a batch of the journal; batches that are written when the campaign of `Robot.killed` is killed.
BATCH, WRITTEN = 256, 2

#: Samples of the shorter campaign beside it, and of the one of a single step.
FEW = 1000

BOTH = ("link_position", "motor_position")


@dataclass(frozen=True)
class Robot:
    """A robot of the study: its file, its sensors, other lines of its design file, and the samples of its campaign."""

    file: str
    measured: tuple[str, ...] = BOTH
    more: str = ""
    samples: int = 1000
    killed: bool = False  # whether its campaign is killed, continued, and measured beside a shorter one

    def has(self, kind: str) -> bool:
        """Whether it has a row of a kind."""
        return kind != "scale" or self.killed

    def design(self, name: str, task: str = 'workspace = "limits"') -> str:
        """Write its design file, whose path is returned."""
        file = BUILD / f"{name}.toml"
        file.parent.mkdir(parents=True, exist_ok=True)
        lines = (
            "[design]",
            f"robot = {json.dumps(self.file)}",
            f"measured = {json.dumps(self.measured)}",
            task,
        )
        file.write_text("\n".join((*lines, self.more)).rstrip() + "\n", encoding="utf-8")
        return str(file)


#: By name.
ROBOTS = {
    "planar-two-link": Robot("planar-two-link", ("link_position",), samples=10_000, killed=True),
    "scara": Robot("scara"),
    "spatial-three-link": Robot("spatial-three-link", samples=300),
    "panda-like": Robot(str(files_of("arm")[0]), more="measurement_noise = 1e-10"),
    "vertical-rig": Robot("vertical-rig"),
}

#: A single step of the killed robot: the task of its other design.
STEP = 'pose = "35deg,20deg"\nstart = "0,0"'


def kept(name: str) -> dict[str, Any] | None:
    """A row, if it is there."""
    file = ROWS / f"{name}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None


def _keep(name: str, row: dict[str, Any]) -> None:
    part = ROWS / f"{name}.part"
    part.write_text(json.dumps(row, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    part.replace(ROWS / f"{name}.json")


def _left(name: str, other: str) -> float:
    """Processor seconds that the other row of a robot leaves."""
    return LIMIT - (kept(f"{name}.{other}") or {}).get("cpu_s", 0.0)


def make(name: str, kind: str) -> str:
    """Make a row and keep it; returns what became of it."""
    try:
        found = KINDS[kind](name)
    except Stopped as stopped:
        found = {**vars(stopped.spent), "stopped": str(stopped)}
    _keep(f"{name}.{kind}", found)
    return f"{name}, {kind}: " + (found.get("stopped") or f"{found['cpu_s']:.0f} CPU s")


# Comparisons ----------------------------------------------------------------------------------------
def _comparison(name: str) -> dict[str, Any]:
    """The numbers of a comparison as it writes them."""
    folder = BUILD / f"{name}.laws"
    shutil.rmtree(folder, ignore_errors=True)
    spent = ran(["compare", ROBOTS[name].design(name), "--out", str(folder)], _left(name, "campaign"))
    return {**vars(spent), **json.loads((folder / "comparison.json").read_text(encoding="utf-8"))}


# Campaigns ------------------------------------------------------------------------------------------
def _campaign(name: str) -> dict[str, Any]:
    """Success, the requirement nearest to its limit, and the worst robot and move in it."""
    robot, folder = ROBOTS[name], BUILD / f"{name}.campaign"
    shutil.rmtree(folder, ignore_errors=True)
    words = ["campaign", robot.design(name), "--samples", str(robot.samples), "--out", str(folder)]
    limit = _left(name, "laws")
    ended = killed(words, limit, lambda: _batches(folder) >= WRITTEN) if robot.killed else Spent()
    spent = ran(words, limit - ended.cpu_s)
    judged = _judged(folder)
    metric, use = nearest(judged)
    assert judged.success is not None
    interval = interval_text(judged.success)
    row: dict[str, Any] = {"samples": judged.count, "failures": judged.failures, "interval": interval}
    row |= _failed(judged)
    worst = judged.worst(metric)
    row |= {
        "metric": metric,
        "use": use,
        "sample": worst,
        "move": {} if worst is None else _ends(judged, worst),
    }
    row |= {"killed": vars(ended) if robot.killed else None, "continued": vars(spent)}
    total = ended + spent
    try:
        search = ran([*words, "--worst-case", "--metric", metric, "--starts", "1"], limit - total.cpu_s)
    except Stopped as stopped:
        return {**vars(total + stopped.spent), **row, "search": str(stopped)}
    case = stored_worst(Journal.existing(folder), metric)
    found = {"sample": case.sample, "use": case.found.value, "status": case.found.status, "runs": case.runs}
    found |= {"cpu_s": search.cpu_s}
    return {**vars(total + search), **row, "search": {**found, "text": worst_text(judged, case)}}


def _failed(judged: CampaignJudgement) -> dict[str, Any]:
    """How many runs did not end as they should, by status; and how many of the others miss a requirement, by metric."""
    status = judged.column("status").astype(str)
    lost, counts = np.unique(status[status != "completed"], return_counts=True)
    missed = judged.violations[status == "completed"].sum(axis=0).tolist()
    return {
        "lost": dict(zip(lost.tolist(), counts.tolist())),
        "missed": {rule.metric: count for rule, count in zip(judged.requirements, missed) if count},
    }


def _batches(folder: Path) -> int:
    return len([*folder.glob("shards/batch-*.parquet")])


def _judged(folder: Path) -> CampaignJudgement:
    table = _table(folder)
    texts = table.journal.about.get("requirements", [])
    return CampaignJudgement(table, tuple(MetricLimit.of(text, table.journal.metrics) for text in texts))


def _table(folder: Path) -> MergedTable:
    journal = Journal.existing(folder)
    return merged(journal, journal.shards()[0])


def nearest(judged: CampaignJudgement) -> tuple[str, float]:
    """The requirement whose worst sample is nearest to its limit, or farthest beyond it; and that sample's metric.

    What must be zero, as the distance beyond a joint's range, has a limit for rounding alone: no share of it is meant.
    """

    def use(rule: MetricLimit) -> float:
        values = judged.column(rule.metric)
        return float(np.nanmax(values)) / rule.limit if np.isfinite(values).any() else 0.0

    rule = max((rule for rule in judged.requirements if rule.limit > ROUNDING), key=use)
    return rule.metric, use(rule)


def _ends(judged: CampaignJudgement, sample: int) -> dict[str, float]:
    """Start and goal of the move of a sample."""
    names = [name for name in judged.table.columns if name.startswith(("start", "goal"))]
    return {name: float(judged.column(name)[sample]) for name in names}


# Ten thousand moves ---------------------------------------------------------------------------------
def _scale(name: str) -> dict[str, Any]:
    """Rate, memory and bits of the long campaign, which was killed, beside a whole short one and a single step."""
    robot, folder, long = ROBOTS[name], BUILD / f"{name}.few", BUILD / f"{name}.campaign"
    row = kept(f"{name}.campaign")
    if row is None or not row.get("killed"):
        raise RuntimeError(f"{name}: its campaign stands before")
    shutil.rmtree(folder, ignore_errors=True)
    few = ran(["campaign", robot.design(name), "--samples", str(FEW), "--out", str(folder)], LIMIT)
    campaign, journal = stored_campaign(long)
    worst = row["sample"]
    durations = [campaign.sample(k).options.get("duration", 0.0) for k in range(200)]
    fresh = robot.samples - WRITTEN * BATCH
    try:
        step = _single_step(robot, name)
    except Stopped:
        step = None
    return {
        **vars(few),
        "moves": fresh,
        "moves_cpu_s": row["continued"]["cpu_s"],
        "move_s": float(np.mean(durations)),
        "memory_mb": {
            str(FEW): few.memory_mb,
            str(robot.samples): max(row[part]["memory_mb"] for part in ("killed", "continued")),
        },
        "report_mb": ran(["campaign", "merge", str(long)], LIMIT).memory_mb,
        "same": _same_rows(folder, long),
        "replayed": {
            str(k): Replayed(campaign, journal, k).same for k in (0, FEW - 1, worst, robot.samples - 1)
        },
        "step": step,
    }


def _same_rows(few: Path, long: Path) -> bool:
    """Whether the rows of a short campaign are the first ones of a long one, bit by bit."""
    first, second = _table(few).columns, _table(long).columns
    return tuple(first) == tuple(second) and all(
        first[name].tobytes() == second[name][: len(first[name])].tobytes()
        if first[name].dtype != object
        else first[name].tolist() == second[name][: len(first[name])].tolist()
        for name in first
    )


def _single_step(robot: Robot, name: str) -> dict[str, float]:
    """Samples and processor seconds of the campaign of a step at one pose, its design and first batch apart."""
    folder = BUILD / f"{name}.step"
    shutil.rmtree(folder, ignore_errors=True)
    words = ["campaign", robot.design(f"{name}-step", STEP), "--samples", str(FEW), "--out", str(folder)]
    ran([*words, "--shard", f"1/{-(-FEW // BATCH)}"], LIMIT)
    spent = ran(words, LIMIT)
    duration = float(Journal.existing(folder).settings["duration"])
    return {"samples": FEW - BATCH, "cpu_s": spent.cpu_s, "step_s": duration}


#: Rows of a robot by kind, in the order in which they are made.
KINDS = {"laws": _comparison, "campaign": _campaign, "scale": _scale}
