"""A limit of the input: the bandwidth gives way, or the specification is refused with what would do."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.designs import Specification, design
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.problem.presets import choose
from flexhinf.designs.synthesis import by_step
from flexhinf.designs.synthesis.by_step import WIDTH, Task, problem_within_effort
from flexhinf.errors import InvalidInput

GOAL, START = np.array([np.pi / 2]), np.array([0.0])
Named = Callable[[str], Any]


def asked(**options: Any) -> Specification:
    return Specification(**{"preset": "damped", "degrees": (2,), "draws": 0, **options})


def choose_within_effort(robot: Any, s: Specification, progress: Any = lambda text: None) -> Any:
    """The problem of a specification whose step keeps the limit, with the default noise levels of the estimator."""
    return problem_within_effort(Task(robot, s, GOAL, START, progress), choose(robot, GOAL, START, s), None)


def peak_of(robot: Any, s: Specification, bandwidth: float) -> float:
    """Largest input of the step of the nominal robot, for a bandwidth."""
    game = choose(robot, GOAL, START, asked(bandwidth=bandwidth))
    law = fh.solve_hji(game.problem, game.gamma, 2)
    run = LoopSetup(robot, s, law, GOAL, START, unlimited=True).step(6.0).run
    return float(np.abs(run.signals["input"]).max())


@pytest.mark.ci("designs for many bandwidths")
def test_a_default_bandwidth_is_lowered_to_about_the_largest_that_keeps_the_limit(robot_of: Named) -> None:
    robot, s = robot_of("paper"), asked(peak_effort=14.0)
    free = choose_within_effort(robot, asked(peak_effort=60.0))
    game = choose_within_effort(robot, s)
    assert free.target is not None
    assert game.target is not None
    found, whole = game.target.bandwidth[0], free.target.bandwidth[0]
    assert 0.5 * whole < found < 0.95 * whole
    assert peak_of(robot, s, whole) > 14.0
    assert peak_of(robot, s, found) <= 14.0
    assert peak_of(robot, s, (1.0 + 2 * WIDTH) * found) > 14.0


@pytest.mark.ci("designs for many bandwidths")
def test_robots_within_the_tolerances_count_too(robot_of: Named) -> None:
    """Some of them need more volts than the nominal robot, so the bandwidth is lower."""
    robot = robot_of("paper")
    alone, drawn = (choose_within_effort(robot, asked(peak_effort=15.0, draws=n)) for n in (0, None))
    assert alone.target is not None
    assert drawn.target is not None
    assert drawn.target.bandwidth[0] < 0.98 * alone.target.bandwidth[0]


@pytest.mark.ci("designs for many bandwidths")
def test_sampled_robots_are_run_at_the_first_and_at_the_found_bandwidth_only(
    robot_of: Named, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[np.ndarray] = []
    whole = by_step.sampled_runs

    def counted(*given: Any) -> Any:
        looked.append(whole(*given).inputs.max())
        return whole(*given)

    monkeypatch.setattr(by_step, "sampled_runs", counted)
    found = choose_within_effort(robot_of("paper"), asked(peak_effort=15.0, draws=12, duration=1.0))
    assert found.target is not None
    assert len(looked) == 2
    assert looked[0] > 15.0 >= looked[1]


@pytest.mark.ci("designs for many bandwidths")
def test_an_asked_bandwidth_is_refused_and_what_is_advised_does(robot_of: Named) -> None:
    robot = robot_of("paper")
    with pytest.raises(InvalidInput) as refused:
        choose_within_effort(robot, asked(peak_effort=14.0, bandwidth=4.0))
    what, found, advice = str(refused.value).splitlines()
    assert unnamed(what, "peak", "input") == []
    assert re.search(r" 14 .*; .* 4 rad/s", found)
    best = float(re.search(r"bandwidth of ([\d.]+) rad/s$", found).group(1))  # type: ignore[union-attr]
    assert f"bandwidth={best:.3g}" in advice
    takes = float(re.search(r"takes ([\d.]+)", found).group(1))  # type: ignore[union-attr]
    assert takes == pytest.approx(peak_of(robot, asked(), 4.0), rel=1e-3)
    again = choose_within_effort(robot, asked(peak_effort=14.0, bandwidth=0.98 * best))
    assert again.target is not None
    assert again.target.bandwidth[0] == pytest.approx(0.98 * best)


@pytest.mark.ci("designs for many bandwidths")
def test_a_limit_that_hardly_holds_the_arm_is_refused(robot_of: Named) -> None:
    """10.9 V hold it; within the tolerances more."""
    with refused_with(InvalidInput, "peak_effort", "input", 10.95) as refused:
        choose_within_effort(robot_of("paper"), asked(peak_effort=10.95, draws=12))
    assert " 10.95" in str(refused.value)


@pytest.mark.parametrize("option", ["peak_effort", "saturation"])
@pytest.mark.parametrize("poses", [{"pose": (np.pi / 2,)}, {"pose": (0.0,), "start": (1.5,)},
                                   {"pose": (0.0,), "via": ((1.5,),)}])  # fmt: skip
def test_a_pose_that_the_motor_cannot_hold_is_refused_before_any_work(
    robot_of: Named, option: str, poses: dict[str, Any]
) -> None:
    told: list[str] = []
    with refused_with(InvalidInput, "'joint'", "hold") as refused:
        design(robot_of("paper"), asked(**{option: 10.0}, **poses), told.append)
    assert re.search(r" 10 V, got 10\.[89]", str(refused.value))
    assert len(told) == 1


def test_a_step_to_where_it_starts_is_refused_before_any_work(robot_of: Named) -> None:
    told: list[str] = []
    with refused_with(InvalidInput, "move", "[0.3]"):
        design(robot_of("paper"), asked(pose=(0.3,), start=(0.3,)), told.append)
    assert len(told) == 1


def test_a_dead_zone_as_large_as_the_step_is_refused_before_any_work(robot_of: Named) -> None:
    told: list[str] = []
    with refused_with(InvalidInput, "dead zone", "'elbow'", "0.2 rad", "10 rad"):
        design(
            robot_of("planar-two-link"),
            asked(pose=(0.3, 0.2), start=(0.3, 0.4), integral_dead_zone=(10.0, 10.0)),
            told.append,
        )
    assert len(told) == 1


@pytest.mark.ci("two syntheses")
def test_without_a_limit_or_a_search_nothing_is_tried(robot_of: Named) -> None:
    told: list[str] = []
    choose_within_effort(robot_of("paper"), asked(), told.append)
    choose_within_effort(robot_of("paper"), Specification(preset="paper", peak_effort=12.0), told.append)
    assert told == []
