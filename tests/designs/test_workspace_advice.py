"""What is tried after a design that misses: limits with room, the order of changes, and the time that they take."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import flexhinf as fh
from flexhinf.designs import advice
from flexhinf.designs.advice import (
    QUANTILE,
    Trial,
    advise,
    changes,
    limit_change,
    relaxable,
    unseen,
    with_room,
)
from flexhinf.designs.requirements import REQUIREMENTS, Requirement


@pytest.mark.parametrize("tail", ["exponential", "half-normal", "uniform"])
def test_a_limit_with_room_keeps_the_share_that_it_promises(tail: str) -> None:
    """By 40 moves of known distributions: the true quantile lies below in nine of ten cases, and so do all of 40 later
    moves, where the worst of the first is passed in every second."""
    random = np.random.default_rng(5)
    first, later = (
        {
            "exponential": lambda: random.exponential(size=(300, 40)),
            "half-normal": lambda: np.abs(random.normal(size=(300, 40))),
            "uniform": lambda: random.uniform(size=(300, 40)),
        }[tail]()
        for _ in range(2)
    )
    beyond = 1.0 - QUANTILE
    quantile = {
        "exponential": -np.log(beyond),
        "half-normal": norm.isf(0.5 * beyond),
        "uniform": QUANTILE,
    }[tail]
    bounds = np.array([with_room(values) for values in first.tolist()])
    assert np.mean(bounds >= quantile) >= 0.9
    assert np.mean(bounds >= later.max(axis=1)) >= 0.9
    assert np.mean(first.max(axis=1) >= later.max(axis=1)) < 0.6
    assert np.median(bounds) < 3.0 * quantile  # of use
    assert with_room([0.3, 0.3]) == 0.3


def missed(name: str, times: float, field: str | None = None) -> Requirement:
    row = REQUIREMENTS[name]
    own = row.field if field is None else field
    return row.judge(None, 1.0, times if row.at_most else 1.0 / times, "", field=own)


def fake(robot: Any, lines: list[Requirement], **fields: Any) -> Any:
    """As much of a design as says what may be tried."""
    return SimpleNamespace(specification=fh.Specification(**fields), robot=robot, missed=lines)


def test_a_limit_has_room_for_robots_at_corners_and_is_kept_by_the_nominal_one(
    robot_of: Callable[[str], Any],
) -> None:
    """Nominal moves, which err less, would make it smaller; their number is not told."""
    corners = np.random.default_rng(3).exponential(size=60)

    def offered(nominal: list[float], sampled: list[float]) -> tuple[float, str]:
        design = fake(robot_of("planar-two-link"), [missed("remaining", 2.0)])
        design.moves, design.sampled = (
            [SimpleNamespace(motion=[{"remaining_error": each}]) for each in errors]
            for errors in (nominal, sampled)
        )
        design.specification = dataclasses.replace(design.specification, remaining_error=10.0)
        change = limit_change(design)
        assert change is not None
        return float(change.fields["remaining_error"]), change.what

    room = with_room(corners.tolist())
    limit, said = offered([0.01] * 20, corners.tolist())
    assert room <= limit <= 1.1 * room
    assert ("60" in said, "80" in said) == (True, False)
    assert offered([1.2 * limit] * 20, corners.tolist())[0] >= 1.2 * limit
    assert "20" in offered(corners[:20].tolist(), [])[1]


def test_changes_are_of_what_is_missed_and_can_be_followed(
    robot_of: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moves are not slowed down for a margin, nor a computer made faster for a speed; every text is read again."""
    monkeypatch.setattr(advice, "limit_change", lambda design: None)
    arm, both = robot_of("planar-two-link"), ("link_position", "motor_position")
    for lines, said in (
        ([missed("at_limit", 2.0)], ["peak_speed", "peak_speed"]),
        ([missed("corners", 3.0)], ["measurement_noise", "period"]),
        ([missed("remaining", 2.0)], ["measurement_noise"]),
        (
            [missed("speed", 2.0), missed("corners", 2.0)],
            ["measurement_noise", "peak_speed", "period", "peak_speed"],
        ),
    ):
        found = list(changes(fake(arm, lines, measured=both)))
        assert [name for change in found for name in change.fields] == said
        assert len({change.text for change in found}) == len(found)
        for change in found:
            s = change.to(fh.Specification(measured=both))
            assert [getattr(s, name) for name in change.fields] != [None]
    encoders = list(changes(fake(arm, [missed("corners", 3.0)])))[-1]
    assert encoders.to(fh.Specification()).measured == ("link_position", "motor_position")


def test_joints_that_samples_do_not_show_are_tried_rigid_by_a_file(
    robot_of: Callable[[str], Any], tmp_path: Path
) -> None:
    """First of all changes, by the eigenvalues of the plant; the file that is written is that robot."""
    arm = robot_of("planar-two-link")
    fastest = np.abs(np.linalg.eigvals(arm.plant().linearise(*arm.operating_point())[0]).imag).max()
    assert unseen(arm, 0.9 * np.pi / fastest) == ()
    period = 1.1 * np.pi / fastest
    assert len(unseen(arm, period)) == 1
    change = next(changes(fake(arm, [missed("corners", 3.0)], period=period)))
    assert (change.rigid, change.fields) == (unseen(arm, period), {})
    arm.with_rigid(*change.rigid).save(tmp_path / "rigid.toml")
    saved = fh.load_robot(tmp_path / "rigid.toml")
    assert saved.rigid == change.rigid
    assert saved == arm.with_rigid(*change.rigid)


def test_limits_that_would_be_far_away_are_not_offered() -> None:
    assert relaxable(missed("remaining", 3.9))
    assert not relaxable(missed("remaining", 4.1))
    assert not relaxable(missed("corners", 2.0))  # no limit keeps an unstable robot
    assert relaxable(missed("corners", 2.0, field="gain_margin"))


def test_trials_end_with_their_time_and_the_first_that_meets_all(
    robot_of: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock of its own: a trial looks at it between poses, and one that ran out of time counts as not tried."""
    clock = itertools.count()
    monkeypatch.setattr(advice, "cpu_seconds", lambda: next(clock))
    lines = [missed("speed", 2.0), missed("corners", 2.0)]
    design, tried = fake(robot_of("planar-two-link"), lines, measurement_noise=1e-10), []

    monkeypatch.setattr(advice, "unseen", lambda robot, period: ())

    def designed(robot: Any, s: Any, progress: Any, watch: Any, like: Any, changed: Any) -> Any:
        tried.append(tuple(changed))
        for _ in range(5):
            watch(())
        kept = dataclasses.replace(lines[0], found=0.5)
        return SimpleNamespace(requirements=(kept,), missed=()) if "period" in changed else watch(lines)

    monkeypatch.setattr(advice, "design_workspace", designed)
    found = advise(design, 1e3)
    assert [trial.met for trial in found.trials] == [False, True]
    assert tried == [("peak_speed",), ("period",)]
    assert found.found is not None
    assert found.found.change.fields == {"period": "0.5ms"}
    short = advise(design, 9.0)
    assert ([*short.trials[0].change.fields], len(short.trials), short.found) == (["peak_speed"], 1, None)
    assert [*short.left[0].fields] == ["period"]
    begun = next(clock)
    advise(design, 3.0)
    assert next(clock) - begun < 8
    assert short.nearest is None  # what the rest of its requirements would have been, nobody knows
    assert not Trial(short.left[0], (), whole=False).met


@pytest.mark.parametrize(("helps", "named"), [("period", "period"), ("nothing", "remaining_error")])
def test_other_limits_are_tried_first_and_named_where_nothing_cheaper_meets_all(
    robot_of: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, helps: str, named: str
) -> None:
    """They need no other law, so that time is left for what costs the user less; what costs more is not tried."""
    lines = [missed("remaining", 2.0), missed("corners", 2.0, field="gain_margin"), missed("speed", 2.0)]
    design, tried = fake(robot_of("planar-two-link"), lines, measurement_noise=1e-10), []
    room = advice.Change("a limit", {"remaining_error": "0.002"})
    monkeypatch.setattr(advice, "limit_change", lambda made, margins=True: room if made is design else None)

    def designed(robot: Any, s: Any, progress: Any, watch: Any, like: Any, changed: Any) -> Any:
        tried.append(*changed)
        met = {*changed} & {helps, "remaining_error"}
        return SimpleNamespace(requirements=() if met else lines, missed=() if met else lines)

    monkeypatch.setattr(advice, "design_workspace", designed)
    found = advise(design, 1e3)
    assert tried == ["remaining_error", "peak_speed", "period"]
    assert found.found is not None
    assert [*found.found.change.fields] == [named]
    assert found.left == ()


@pytest.mark.parametrize(
    ("limit", "order"),
    [
        ("gain_margin", ["measurement_noise", "gain_margin", "period"]),
        ("ripple", ["ripple", "measurement_noise", "period"]),
    ],
)
def test_margins_which_are_sought_follow_finer_sensors(
    robot_of: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch, limit: str, order: list[str]
) -> None:
    """A search for margins may take all of the time in which finer sensors would have met all."""
    lines = [missed("corners", 2.0, field="gain_margin")]
    design, tried = fake(robot_of("planar-two-link"), lines), []
    room = advice.Change("a limit", {limit: "1.5"})
    monkeypatch.setattr(advice, "limit_change", lambda made, margins=True: room if made is design else None)

    def designed(robot: Any, s: Any, progress: Any, watch: Any, like: Any, changed: Any) -> Any:
        tried.append(*changed)
        missing = [] if limit in changed else lines
        return SimpleNamespace(requirements=missing, missed=missing)

    monkeypatch.setattr(advice, "design_workspace", designed)
    found = advise(design, 1e3).found
    assert tried == order
    assert found is not None
    assert [*found.change.fields] == [limit]


def test_limits_that_the_design_keeps_are_judged_to_their_end(
    robot_of: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A trial takes 12 looks at a clock: more than a design's time of 10, less than half as much more. What costs less
    has no time then."""
    lines, clock = [missed("remaining", 2.0), missed("corners", 2.0, field="gain_margin")], itertools.count()
    design = fake(robot_of("planar-two-link"), lines, measurement_noise=1e-10)
    room = advice.Change("a limit", {"remaining_error": "0.002"})
    monkeypatch.setattr(advice, "limit_change", lambda made, margins=True: room)
    monkeypatch.setattr(advice, "cpu_seconds", lambda: next(clock))

    def designed(robot: Any, s: Any, progress: Any, watch: Any, like: Any, changed: Any) -> Any:
        for _ in range(12):
            watch(())
        return SimpleNamespace(requirements=(), missed=())

    monkeypatch.setattr(advice, "design_workspace", designed)
    found = advise(design, 10.0)
    assert [[*trial.change.fields] for trial in found.trials] == [["remaining_error"]]
    assert found.found is not None
    assert advise(design, 6.0).found is None


def test_a_change_and_limits_that_its_design_would_keep_are_one_command(
    robot_of: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = [missed("corners", 2.0, field="gain_margin"), missed("speed", 2.0)]
    design, tried = fake(robot_of("planar-two-link"), lines, measurement_noise=1e-10), []
    room = advice.Change("a limit", {"remaining_error": "0.002"})
    monkeypatch.setattr(advice, "limit_change", lambda made, margins=True: None if made is design else room)

    def designed(robot: Any, s: Any, progress: Any, watch: Any, like: Any, changed: Any) -> Any:
        tried.append((*changed, s.remaining_error, s.peak_speed is not None))
        missing = [] if "remaining_error" in changed else lines
        return SimpleNamespace(requirements=missing, missed=missing, specification=s, robot=robot)

    monkeypatch.setattr(advice, "design_workspace", designed)
    found = advise(design, 1e3)
    assert found.found is not None
    assert [*found.found.change.fields] == ["peak_speed", "remaining_error"]
    assert tried[:2] == [("peak_speed", None, True), ("remaining_error", (0.002,), True)]
    assert [line[0] for line in tried[2:]] == ["period", "peak_speed", "measured"]
