"""The exported elastic robot: what MuJoCo makes of the file by itself, against our plant integrated by SciPy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.robot.mjcf_export import elastic_mjcf
from flexhinf.robot.template import template_text

mujoco: Any = pytest.importorskip("mujoco")


@pytest.mark.oracle
@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("name", ["planar-two-link", "scara", "rigid spatial-three-link", "paper"])
def test_the_model_moves_as_our_plant(name: str) -> None:
    """0.2 s of a constant input beside the one that holds home; springs are damped, no dry friction in either."""
    robot = fh.load_robot(name.removeprefix("rigid "))
    if name.startswith("rigid"):
        robot = robot.with_rigid(robot.joint_names[0])
    dry = ("coulomb_friction", "static_friction")
    kept = tuple(each for each in robot.parameters if not each.name.startswith(dry))
    robot = replace(robot, parameters=kept).damped
    model = mujoco.MjModel.from_xml_string(elastic_mjcf(robot).text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    held = data.ctrl.copy()
    assert np.abs(data.qacc).max() < 1e-9
    plant = robot.plant(extras=("joint_damping",))
    x, u = robot.operating_point(extras=("joint_damping",))
    assert held == pytest.approx(u, rel=1e-9, abs=1e-12)
    pushed = u + 0.1 * (1.0 + np.abs(u)) * np.array([1.0, -0.7, 0.4, 0.2])[: len(u)]
    data.ctrl[:] = pushed
    steps = round(0.2 / model.opt.timestep)
    mujoco.mj_step(model, data, steps)

    def flow(_: float, at: np.ndarray) -> np.ndarray:
        rates = plant.traced_flow(at, pushed, np.zeros(len(plant.disturbances)), plant.parameters.vector())
        return np.asarray(rates, dtype=float).ravel()

    ours = solve_ivp(flow, (0.0, steps * model.opt.timestep), x, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    n, moved = len(u), np.abs(ours - x)
    theirs = np.concatenate([data.qpos[:n], data.qvel[:n], data.qpos[n:], data.qvel[n:]])
    assert np.abs(theirs - ours).max() < 1e-6 * moved.max()
    assert moved[:n].max() > 1e-4
    mujoco.mj_forward(model, data)
    for signal, value in zip(plant.states, ours):
        assert data.sensor(signal).data[0] == pytest.approx(value, abs=1e-6 * moved.max())


def test_motors_are_limited_as_the_robot_says() -> None:
    robot = replace(fh.load_robot("planar-two-link"), effort_limits=(24.0, None))
    model = mujoco.MjModel.from_xml_string(elastic_mjcf(robot).text)
    assert model.actuator_ctrllimited.tolist() == [1, 0]
    assert model.actuator_ctrlrange[0].tolist() == [-24.0, 24.0]
    assert model.joint("link_position_elbow").range.tolist() == [-2.6, 2.6]
    assert model.jnt_limited.tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("drive", ["velocity", "position"])
def test_a_drive_with_a_loop_is_one_limited_actuator(tmp_path: Path, drive: str) -> None:
    (tmp_path / "arm.toml").write_text(template_text(2, drive), encoding="utf-8")
    robot = fh.load_robot(tmp_path / "arm.toml")
    model = mujoco.MjModel.from_xml_string(elastic_mjcf(robot).text)
    names = [model.actuator(i).name for i in range(model.nu)]
    assert names == [f"{drive}_command_joint1", f"{drive}_command_joint2"]
    assert model.actuator_ctrlrange[:, 1].tolist() == list(robot.effort_limits or ())
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert data.ctrl == pytest.approx(robot.operating_point()[1])
    mujoco.mj_forward(model, data)
    assert np.abs(data.qacc).max() < 1e-9


def test_the_command_writes_a_file_that_mujoco_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ["export", "mjcf", "planar-two-link"]
    assert main([*command, "--payload", "1kg@elbow"]) == 0
    assert unnamed(capsys.readouterr().err, "inductance") == []
    model = mujoco.MjModel.from_xml_path("planar-two-link.xml")
    assert model.body_mass.sum() == pytest.approx(
        3.0 + 2.0 + 1.0 + 2.0
    )  # two links, the payload, two rotors of 1 kg
    assert main(command) == 2
    assert unnamed(capsys.readouterr().err, "--force", "planar-two-link.xml") == []
    assert main([*command, "--force"]) == 0
    assert mujoco.MjModel.from_xml_path("planar-two-link.xml").body_mass.sum() == pytest.approx(7.0)
