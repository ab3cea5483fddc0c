"""What the length of a run decides: nothing that is judged, and what a short run leaves open is not judged."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.checks import as_far_as_judged, judged_when_settled
from flexhinf.designs.judge import motion_requirements, step_requirements
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.responses import LONGEST, Response, joint_limits, motion_metrics, rests

S = Specification(saturation=10.0)
LIMITS = joint_limits(fh.load_robot("paper"), S)


def run_of(length: float, settling: float, swing: float = 0.0) -> Response:
    """A step of 0.1 rad that settles to ±2 % by an exponential, and then swings by a share of it."""
    time = np.arange(round(1e3 * length) + 1) / 1e3
    rate = np.log(50.0) / settling
    left = np.exp(-rate * time)
    away = swing * np.sin(60.0 * time) * (1.0 - left) - left
    state = np.column_stack([0.1 * (1.0 + away), 0.1 * rate * left])
    signals = {"state": state, "input": 5.0 * (left + swing)[:, None]}
    trajectory: Any = SimpleNamespace(time=time, signals=signals, diverged_at=None)
    return Response(trajectory, np.array([0.1]), np.zeros(1), ("joint",))


def lines_of(run: Response) -> list[Requirement]:
    rows = motion_metrics(LIMITS, run)
    return [
        *step_requirements(S, LIMITS, run, "the step"),
        *motion_requirements(S, LIMITS, [rows], 0.0, "the step"),
    ]


@pytest.mark.parametrize("length", [0.2, 0.35, 0.5, 0.56, 0.8, 2.0])
@pytest.mark.parametrize(("settling", "swing"), [(0.255, 0.0), (0.255, 0.01), (0.1, 0.1), (3.0, 0.0)])
def test_the_verdict_of_a_design_is_that_of_a_long_run(length: float, settling: float, swing: float) -> None:
    def again(length: float) -> Response:
        return run_of(length, settling, swing)

    found = judged_when_settled(lines_of, again(length), "the step", again)
    assert {line.what: line.met for line in found} == {
        line.what: line.met for line in lines_of(again(LONGEST))
    }
    assert all(line.judged for line in found)


@pytest.mark.parametrize("settling", [0.1, 0.255, 1.0])
def test_a_run_that_cannot_be_made_again_leaves_open_what_it_is_too_short_for(settling: float) -> None:
    verdicts = {}
    for length in (0.05, 0.2, 0.4, 0.5, 0.7, 1.0, 2.5, 5.0):
        run = run_of(length, settling)
        lines = {line.what: line for line in as_far_as_judged(lines_of(run), run, 0.0, 5.0)}
        assert not any(line.missed for line in lines.values())
        assert lines["overshoot"].judged == (length >= max(settling, 0.3))
        rest = {lines[what].judgement for what in ("remaining error", "ripple of the motors")}
        assert rest == {"met"} or not rests(run)
        verdicts[length] = rest
    assert verdicts[0.05] == {"not judged"}
    assert verdicts[5.0] == {"met"}


def test_what_a_short_run_exceeds_is_missed_and_a_run_of_full_length_is_judged() -> None:
    """An arm that swings on for ever, and one that overshoots before the run ends."""
    swinging = run_of(5.0, 0.2, 0.1)
    lines = {line.what: line for line in as_far_as_judged(lines_of(swinging), swinging, 0.0, 5.0)}
    assert lines["remaining error"].missed
    short = run_of(0.2, 0.01, 0.2)
    lines = {line.what: line for line in as_far_as_judged(lines_of(short), short, 0.0, 5.0)}
    assert lines["overshoot"].missed
    assert lines["remaining error"].judgement == "not judged"
    assert not rests(short, begun=1.0)


def test_a_run_that_diverged_is_not_made_longer() -> None:
    run = run_of(0.5, 0.2)
    gone = Response(
        cast("Any", SimpleNamespace(**{**vars(run.run), "diverged_at": 0.5})), run.goal, run.start, run.joints
    )

    def again(length: float) -> Response:
        raise AssertionError(length)

    assert any(line.missed for line in judged_when_settled(lines_of, gone, "the step", again))
