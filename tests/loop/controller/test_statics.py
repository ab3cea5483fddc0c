"""What a robot at rest elsewhere needs more: against the robots' own equilibria, with couplings, curves, payloads."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.robot.test_coupling import belt

import flexhinf as fh
from flexhinf.loop.controller.statics import Statics
from flexhinf.plant import Parameters
from flexhinf.robot import Parameter
from flexhinf.robot.gears import over_stiffness

BOTH = ("link_position", "motor_position")

#: A gear with 0.6, 1 and 1.4 of its stiffness, and corners that the weight passes.
CURVE = {"first_torque": 1.0, "second_torque": 4.0}
SLOPES = {"first_stiffness": 0.6, "second_stiffness": 1.0, "third_stiffness": 1.4}
POSITION = ', drive = "position", drive_bandwidth = 60.0, drive_damping_ratio = 0.7, load_share = 0.3'


def geared(robot: fh.Robot) -> fh.Robot:
    numbers = {
        f"{name}_{joint}": value * robot.nominal[f"stiffness_{joint}"] if name in SLOPES else value
        for joint in robot.joint_names
        for name, value in (SLOPES | CURVE).items()
    }
    return robot.with_parameters(*(Parameter(name, value) for name, value in numbers.items()))


def statics_of(model: fh.Plant) -> Statics:
    found = Statics.of(SimpleNamespace(plant=model), ())  # type: ignore[arg-type]
    assert found is not None
    return found


def shown(
    robot: fh.Robot, here: np.ndarray, there: np.ndarray, curved: bool = False
) -> tuple[np.ndarray, ...]:
    """The command that moves at a pose with what it is shown at another one, and what it is shown."""
    model, n = robot.plant(BOTH), len(robot.joint_names)
    statics = statics_of(model)
    curves = [over_stiffness(Parameters(robot.plant_parameters()))] if curved else []
    extras = "stiffness_curve" if curved else ()
    rest = np.concatenate(robot.operating_point(here, extras))
    moving = rest + np.random.default_rng(1).normal(size=rest.size) * np.repeat(
        [0.0, 1.0], [n, rest.size - n]
    )
    command = moving.copy()
    command[:n] = there
    expected = moving + np.concatenate(robot.operating_point(there, extras)) - rest
    return statics.shifted(moving, command, model.parameters.vector(), *curves), expected


@pytest.mark.parametrize("kind", ["plain", "coupled", "both coupled", "curved", "by position", "all"])
def test_twists_and_inputs_are_those_of_the_pose_and_what_the_command_accelerates_stays(
    kind: str, tmp_path: Path
) -> None:
    values = {"plain": {"coupling": "{ elbow = 1.0 }"}}.get(kind, {})
    if kind in ("both coupled", "all"):
        values = {"coupling": "{ shoulder = 0.8, elbow = -1.2 }"}
    curved = kind in ("curved", "all")
    robot = belt(tmp_path, motor=POSITION if kind in ("by position", "all") else "", **values)
    robot = geared(robot) if curved else robot
    found, expected = shown(robot, np.array([0.4, 0.9]), np.array([-0.7, 1.3]), curved)
    assert found == pytest.approx(expected, abs=1e-12)


def test_the_payload_of_the_model_is_in_it() -> None:
    """A robot with a payload, and the parameters of one with it."""
    here, there = np.array([0.3, 0.5]), np.array([2.0, -0.4])
    loaded = fh.load_robot("planar-two-link", payload="1kg")
    assert np.allclose(*shown(loaded, here, there), atol=1e-12)
    bare = fh.load_robot("planar-two-link").plant(BOTH)
    statics, r = statics_of(bare), np.concatenate(loaded.operating_point(here))
    command = np.concatenate([there, r[2:]])
    more = [statics.shifted(r, command, robot.plant(BOTH).parameters.vector()) - r for robot in
            (loaded, fh.load_robot("planar-two-link"))]  # fmt: skip
    assert more[0] == pytest.approx(np.concatenate(loaded.operating_point(there)) - r, abs=1e-12)
    assert np.abs(more[0] - more[1]).max() > 0.1


def test_a_command_that_is_shown_where_it_is_stays_bit_for_bit(tmp_path: Path) -> None:
    robot = belt(tmp_path)
    statics, r = statics_of(robot.plant(BOTH)), np.random.default_rng(0).normal(size=10)
    assert np.array_equal(statics.shifted(r, r.copy(), robot.plant(BOTH).parameters.vector()), r)


def test_models_that_are_no_such_robots_have_none() -> None:
    """Without a model, with coils, and a law that does not read the motors."""
    robot = fh.load_robot("planar-two-link")
    coils, plain = (SimpleNamespace(plant=robot.plant(BOTH, inductance=on)) for on in (True, False))
    assert Statics.of(None, ()) is None
    assert Statics.of(coils, ()) is None  # type: ignore[arg-type]
    assert Statics.of(plain, (0, 1, 2, 3)) is None  # type: ignore[arg-type]
    assert Statics.of(plain, tuple(range(8))) is not None  # type: ignore[arg-type]
