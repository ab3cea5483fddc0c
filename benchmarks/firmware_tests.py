"""What the tests of the exported C notice: changes of one line, lines and outcomes of branches, for firmware_study.md.

``python -m benchmarks.firmware --only tests`` measures every row, which takes minutes, and keeps it in
benchmarks/firmware_tests.json. Each is a source of an export as the command line makes it. The changes are those of
``make mutants`` in that folder, a sample of them, drawn by a seed; lines and branches are those of ``make coverage``.
What a row had when it was first measured stays beside it.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from benchmarks.record import keep_rows, kept_rows
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.search import tuned_setup
from flexhinf.export import export_c, protected
from flexhinf.robot.workspace import workspace_of

KEPT = Path(__file__).resolve().with_suffix(".json")

#: Limit of the inputs, V; how many changes of a source are tried.
LIMIT, SAMPLE = 48.0, 100

#: By export, the seed that draws them: one that was not looked at before the tests were made.
SEEDS = {"arm": 51, "root": 86, "two": 51}

#: What is exported, by its sources: how it is called, and the robot.
SOURCES: dict[str, tuple[str, str]] = {
    "arm.c": ("one joint at a pose, unscented filter", "paper"),
    "root.c": ("one joint at a pose, extended filter", "paper"),
    "two.c": ("two joints in the workspace", "planar-two-link"),
    "two_follow.c": ("the same, trajectories", "planar-two-link"),
}


def exported(folder: Path, name: str, one_pose: Callable[[int], fh.Controller]) -> Path:
    """The export of a row, with limits of inputs, and the protection of its robot, as by default. `one_pose`: The
    controller of a design of one pose, by the number of links."""
    robot = fh.load_robot(SOURCES[f"{name}.c"][1])
    if name == "arm":
        controller = one_pose(1).fresh(saturation=LIMIT)
    elif name == "root":
        controller = _with_extended_filter(one_pose(1)).fresh(saturation=LIMIT)
    else:
        s = fh.Specification(workspace="limits", saturation=LIMIT)
        setup = tuned_setup(robot, s, Task(workspace_of(robot, s.workspace)))
        controller = setup.controller(setup.workspace.home, supervision=setup.supervision)
    controller, _ = protected(controller, robot)
    return export_c(controller, folder, name, robot=robot)


def _with_extended_filter(controller: fh.Controller) -> fh.Controller:
    """The same law behind an extended Kalman filter of the same noise, which carries a root of its covariance."""
    own = controller.estimator
    assert isinstance(own, fh.UnscentedKalmanFilter)
    mean = np.asarray(own.initial[0], dtype=float)
    start = 1e-4 * np.eye(len(mean))
    other = fh.ExtendedKalmanFilter(
        own.plant, controller.period, own.process_noise, own.measurement_noise, mean, start
    )
    return fh.Controller(controller.law, other, controller.period)


def measured(folder: Path, seed: int, sample: int = SAMPLE) -> list[dict[str, Any]]:
    """A row for each source of an export, of so many changes; 0: one of every line."""
    words = [sys.executable, "mutants.py", "--most", str(sample), "--seed", str(seed)]
    changes = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False).stdout
    covered = subprocess.run(
        ["make", "-s", "coverage", "CC=gcc"], cwd=folder, capture_output=True, text=True, check=True
    ).stdout
    rows = list[dict[str, Any]]()
    for name, noticed, of, others in re.findall(
        r"^(\w+\.c): (\d+) of (\d+) changes noticed.*?, (\d+) that no answer", changes, re.MULTILINE
    ):
        lines = re.search(
            rf"File '{name}'\nLines executed:([\d.]+)%.*\n.*\nTaken at least once:([\d.]+)%", covered
        )
        assert lines is not None, covered
        rows.append(
            {"source": name, "sample": sample, "noticed": int(noticed), "of": int(of), "no change": int(others),
             "lines": float(lines[1]), "outcomes": float(lines[2])}
        )  # fmt: skip
    return rows


def keep(one_pose: Callable[[int], fh.Controller]) -> None:
    """Measure all, and keep them beside what was measured first."""
    known = {row["source"]: row for row in kept_rows(KEPT)}
    for name, seed in SEEDS.items():
        with tempfile.TemporaryDirectory() as work:
            for row in measured(exported(Path(work) / "c", name, one_pose), seed):
                before = known.get(row["source"], row)
                first = before.get("first", [before["noticed"], before["of"]])
                known[row["source"]] = row | {"first": first}
                print(json.dumps(known[row["source"]]), flush=True)
        rows = [known[source] for source in SOURCES if source in known]
        keep_rows(KEPT, rows)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows, with the share that is noticed."""
    lines = [
        "| controller | source | changes noticed, at first | now | that no answer can show | lines "
        "| outcomes of branches |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        source = re.sub("^[a-z]+", "NAME", row["source"])
        shares = [
            f"{noticed} of {of} ({100 * noticed / of:.0f} %)"
            for noticed, of in (row["first"], (row["noticed"], row["of"]))
        ]
        cells = [SOURCES[row["source"]][0], f"`{source}`", *shares, str(row["no change"])]
        lines.append("| " + " | ".join([*cells, f"{row['lines']:.0f} %", f"{row['outcomes']:.1f} %"]) + " |")
    return "\n".join(lines)
