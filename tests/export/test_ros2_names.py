"""Interfaces of the package for ROS 2 have the names of the joints, each once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.builders import driven_robot, linear_law
from tests.export.test_rest import elastic_controller
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export.controller_c import code_of
from flexhinf.export.rendering import render_c
from flexhinf.export.ros2 import ros2_values

yaml = pytest.importorskip("yaml")

PERIOD = 1e-3


def test_interfaces_are_named_after_the_joints_of_the_robot(tmp_path: Path) -> None:
    """Two joints whose names in C are one had each other's interfaces."""
    joints, file = ("left/j1", "left_j1"), tmp_path / "arm.toml"
    text = (Path(fh.__file__).parent / "robot/catalogue/planar-two-link.toml").read_text()
    file.write_text(text.replace('"shoulder"', f'"{joints[0]}"').replace('"elbow"', f'"{joints[1]}"'))
    robot = fh.load_robot(file)
    code = code_of(elastic_controller(robot), "arm", "double", robot)
    values = {**code.values, "follows": True, **ros2_values(code, np.zeros(1))}
    parameters, source = (
        render_c(f"ros2/controller.{kind}", "arm", code.real, **values) for kind in ("yaml", "cpp")
    )
    stated = yaml.safe_load(parameters)["arm_controller"]["ros__parameters"]
    assert set(joints) < set(stated["constraints"])
    for kind, quantities in (("measurements", ("position", "motor_position")), ("inputs", ("voltage",))):
        interfaces = [group["interface"] for group in stated[kind].values()]
        assert interfaces == [f"{joint}/{quantity}" for quantity in quantities for joint in joints]
        assert "{" + ", ".join(f'"{interface}"' for interface in interfaces) + "}" in source


@pytest.mark.parametrize("drive", ["velocity", "position"])
def test_a_drive_has_the_interface_of_what_it_takes(drive: str) -> None:
    robot = driven_robot("planar-two-link", drive)
    law = linear_law(plant := robot.plant(), np.zeros((2, len(plant.states))))
    code = code_of(fh.Controller(law, None, PERIOD, 1.0), "arm", "double", robot)
    parameters = render_c(
        "ros2/controller.yaml",
        "arm",
        code.real,
        **code.values,
        follows=False,
        **ros2_values(code, np.zeros(2)),
    )
    inputs = yaml.safe_load(parameters)["arm_controller"]["ros__parameters"]["inputs"]
    assert [group["interface"] for group in inputs.values()] == [
        f"{joint}/{drive}" for joint in robot.joint_names
    ]


class Twins(fh.Law):
    """A law of two states that are both the position of the only joint."""

    state_names, input_names = ("link_position", "link_position_joint"), ("u",)
    operating_point, operating_input, law_data = np.zeros(2), np.zeros(1), np.ones(2)

    def evaluate_law(self, x: Any, data: Any) -> Any:
        return np.array([-(data @ x)])


def test_two_signals_of_one_interface_are_refused_by_name() -> None:
    code = code_of(fh.Controller(Twins(), None, PERIOD, 1.0), "arm", "double")
    with refused_with(InvalidInput, "joint/position", "'link_position'", "'link_position_joint'"):
        ros2_values(code, np.zeros(1))
