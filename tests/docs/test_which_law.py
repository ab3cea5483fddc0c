"""docs/which_law.md is short, linked, and quotes other pages' numbers as they are; its tables are made parts."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from benchmarks.workspace import gamma
from benchmarks.workspace.robots import ROBOTS

from flexhinf.modal import ModalLaw
from flexhinf.modal.tolerance import error_tolerance
from flexhinf.plant import Penalty
from flexhinf.robot.workspace import workspace_of


@pytest.fixture
def pages(repository: Path) -> dict[str, str]:
    """Text by name, spaces as one."""
    names = ("which_law", "workspace", "degrees")
    return {name: (repository / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in names}


def test_the_page_is_short_and_linked(pages: dict[str, str], repository: Path) -> None:
    assert len(pages["which_law"].splitlines()) <= 120
    assert "which_law.md" in pages["workspace"]
    assert "docs/which_law.md" in (repository / "README.md").read_text(encoding="utf-8")


def test_the_quoted_gain_of_a_cubic_law_is_that_of_the_study(pages: dict[str, str]) -> None:
    quoted = re.search(r"settles up to (\d+) % earlier", " ".join(pages["which_law"].split()))
    assert quoted is not None
    sentence = re.search(r"one link to 90° settles ([^;]*);", " ".join(pages["degrees"].split()))
    assert sentence is not None
    assert max(map(int, re.findall(r"(\d+) %", sentence[1]))) == int(quoted[1])


def test_what_is_said_of_gamma_is_what_its_table_shows(pages: dict[str, str]) -> None:
    """From γ = ∞ to the smallest errors covered change by less than a half, damping grows by two to three quarters."""
    table = pages["which_law"].partition("<!-- made: which-gamma -->")[2].partition("<!-- end -->")[0]
    changed = {}
    for line in table.strip().splitlines()[2:]:
        robot, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        smallest, lqr = (
            [float(each) for each in re.findall(r"[\d.]+", cell)] for cell in (cells[0], cells[-1])
        )
        changed[robot] = [one / other for one, other in zip(smallest, lqr)]
    assert set(changed) == set(ROBOTS)
    for known, late, damping in changed.values():
        assert 1.0 / 1.5 < min(known, late) <= max(known, late) < 1.5
        assert 1.35 < damping < 1.8
    assert sum(known > 1.1 for known, *_ in changed.values()) > len(changed) // 2
    assert changed["panda"][0] < 0.9


@pytest.mark.ci("designs two laws and searches their tolerances")
def test_over_all_vibrations_small_gain_allows_what_the_page_says(pages: dict[str, str]) -> None:
    text = " ".join(pages["which_law"].split())
    said = re.search(r"latency (\d+) % on `scara` and below ([\d.]+) % on `seven-link` at 1.5 γ", text)
    assert said is not None
    allowed = [100.0 * over_all_vibrations(name) for name in ("scara", "seven-link")]
    assert round(allowed[0]) == int(said[1])
    assert 0.5 * float(said[2]) < allowed[1] < float(said[2])


def over_all_vibrations(name: str) -> float:
    """The largest error at 1.5 γ* with one sample of latency, on a grid of λ that is fine enough: from 120 to 480
    values the error of the seven-link arm falls by an eighth."""
    robot = ROBOTS[name].robot()
    problem = robot.problem(penalty=Penalty({"link_position": 1.0}))
    sampled = workspace_of(robot).sample(gamma.POSES, gamma.SEED)
    weights = gamma.pair_weights(robot, gamma.BANDWIDTHS[0], 1.5)
    gains = ModalLaw.tuned(problem, gamma.PERIOD, weights, sampled).gains
    return error_tolerance(gains, np.inf, 1, count=120).constant
