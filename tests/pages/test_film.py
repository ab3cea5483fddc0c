"""The film of a run: what it shows, how it is encoded, what is refused before any work."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.deployed_run import DeployedRun, prepare_run
from flexhinf.errors import InvalidInput
from flexhinf.export import RealTimeRun
from flexhinf.pages import film as module
from flexhinf.pages.design import step as arm_figure
from flexhinf.pages.film import ArmFilm, check_film, write_film
from flexhinf.robot.kinematics import WIDEST

# Two loops that run once: 0.8 s instead of 1.5 s.
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.skipif(find_spec("mujoco") is None, reason="missing: mujoco"),
]


def controller_of(robot: fh.Robot, limit: Any) -> fh.Controller:
    weights = {"link_position": 60, "link_position_integral": 300}
    return arm_controller(
        robot, weights=weights, at=[0.2, 0.1], q=1e-9, r=1e-8, p0=1e-6, limit=limit, start="bumpless"
    )


@pytest.fixture(scope="module")
def made() -> tuple[DeployedRun, RealTimeRun]:
    robot = fh.load_robot("planar-two-link")
    controller = controller_of(robot, (-9.0, 8.0))
    s = Specification(start="0.2,0.1", pose="0.4,0.3", duration=0.3)
    prepared = prepare_run(controller, (robot, s), robot, s)
    return prepared, fh.run_realtime(prepared.loop, **prepared.arguments, real_time=False)


@pytest.mark.ci("draws a film")
def test_what_is_drawn(made: tuple[DeployedRun, RealTimeRun]) -> None:
    film = ArmFilm(*made)
    assert film.factor > 1
    assert np.abs(film.factor * film.windup).max() <= WIDEST
    np.testing.assert_array_equal(film.limits, [9.0, 9.0])
    np.testing.assert_array_equal(film.command[0], [0.4, 0.3])
    link, joint, motor = film.hands(0)[1]
    # the angle between the hands is the wind-up, as many times larger as the title says
    sides = [np.arctan2(*(point - joint)) for point in (link, motor)]
    assert abs(sides[1] - sides[0]) == pytest.approx(film.factor * abs(film.windup[0, 1]), abs=1e-9)
    assert film.position_unit == "°"


@pytest.mark.ci("encodes films")
@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_the_film_is_played_slowly_and_ends_at_the_end(
    ending: str, made: tuple[DeployedRun, RealTimeRun], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.3 s in at least `SHORTEST` seconds, here half of one; every picture differs from the first."""
    if ending == ".mp4" and module._encoder() is None:
        pytest.skip("missing: ffmpeg")
    monkeypatch.setattr(module, "SHORTEST", 0.5)
    path = write_film(*made, tmp_path / f"arm{ending}")
    if ending == ".gif":
        from PIL import Image

        with Image.open(path) as picture:
            assert (picture.n_frames, picture.size) == (10, (960, 540))  # type: ignore[attr-defined]
            assert picture.info["duration"] == 50
            first = np.asarray(picture.convert("RGB"))
            picture.seek(9)
            apart = np.abs(first.astype(int) - np.asarray(picture.convert("RGB"))).max(axis=2)
            assert apart[60:].max() > 50
            assert apart[:60, 760:].max() > 50  # the clock at the top
    else:
        told = subprocess.run(
            [str(module._encoder()), "-i", str(path)], capture_output=True, text=True, check=False
        )
        assert "h264" in told.stderr
        assert "1280x720" in told.stderr
        assert "30 fps" in told.stderr
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


@pytest.mark.ci("draws a film until it fails")
def test_an_encoder_that_fails_leaves_nothing(
    made: tuple[DeployedRun, RealTimeRun], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_encoder", lambda: "false")
    monkeypatch.setattr(module, "SHORTEST", 0.1)
    with refused_with(InvalidInput, "film", "arm.mp4"):
        write_film(*made, tmp_path / "arm.mp4")
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_filmed_is_refused_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, what in (
        ("arm.avi", r"\.mp4 or \.gif(?s:.)*arm\.avi"),
        ("missing/arm.gif", "film(?s:.)*missing"),
    ):
        with pytest.raises(InvalidInput, match=what):
            check_film(tmp_path / name)
    monkeypatch.setattr(module, "_encoder", lambda: None)
    with refused_with(InvalidInput, "flexhinf[video]"):
        check_film(tmp_path / "arm.mp4")
    assert check_film(tmp_path / "arm.gif")


@pytest.mark.ci("compiles and runs a loop")
def test_of_a_run_without_samples_there_is_no_film_and_of_one_that_diverged_a_part(
    made: tuple[DeployedRun, RealTimeRun],
) -> None:
    prepared, run = made
    signals = {"state": np.zeros((0, 8)), "input": np.zeros((0, 2))}
    empty: Any = SimpleNamespace(trajectory=replace(run.trajectory, time=np.zeros(0), signals=signals))
    with refused_with(InvalidInput, "sample"):
        ArmFilm(prepared, empty)
    diverged = run.trajectory.signals["input"].copy()
    diverged[20:] = np.nan
    broken = replace(run.trajectory, signals={**run.trajectory.signals, "input": diverged})
    assert len(ArmFilm(prepared, replace(run, trajectory=broken)).time) == 20


@pytest.mark.ci("compiles one more loop")
def test_a_rigid_joint_has_its_motor_at_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its states have no motor: in the film and in the figure of a report the motors stand where they are."""
    robot = replace(fh.load_robot("planar-two-link"), rigid=("shoulder",))
    s = Specification(start="0.2,0.1", pose="0.4,0.3", duration=0.01)
    prepared = prepare_run(controller_of(robot, None), (robot, s), robot, s)
    run = fh.run_realtime(prepared.loop, **prepared.arguments, real_time=False)
    film = ArmFilm(prepared, run)
    np.testing.assert_array_equal(film.windup[:, 0], 0.0)
    np.testing.assert_array_equal(film.motors[:, 1], run.trajectory.signal("state", "motor_position_elbow"))
    drawn: list[np.ndarray] = []
    monkeypatch.setattr(arm_figure, "arm_figure", lambda robot, time, links, motors, at: drawn.append(motors))
    response = prepared.response(run)
    arm_figure.arm_of(SimpleNamespace(step=response, setup=prepared))  # type: ignore[arg-type]
    np.testing.assert_array_equal(drawn[0], film.motors)
