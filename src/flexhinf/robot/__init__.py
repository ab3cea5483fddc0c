"""Robots: physical parameters with tolerances and sources, and the plants made of them."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "ElasticJoint": "parts",
    "Joint": "dynamics",
    "Link": "parts",
    "MuJoCoPlant": "mujoco_plant",
    "Parameter": "parameter",
    "Placement": "dynamics",
    "Robot": "robot",
    "RobotFileWarning": "file_errors",
    "SingleLink": "parts",
    "assembled": "assembly",
    "catalogue": "shipped",
    "check_holding": "limits",
    "check_reference": "limits",
    "load_robot": "robot_file",
    "paper_arm": "paper",
    "single_link_robot": "assembly",
}

__all__ = [
    "ElasticJoint", "Joint", "Link", "MuJoCoPlant", "Parameter", "Placement", "Robot", "RobotFileWarning",
    "SingleLink", "assembled", "catalogue", "check_holding", "check_reference", "load_robot",
    "paper_arm", "single_link_robot",
]  # fmt: skip

if TYPE_CHECKING:
    from flexhinf.robot.assembly import assembled, single_link_robot
    from flexhinf.robot.dynamics import Joint, Placement
    from flexhinf.robot.file_errors import RobotFileWarning
    from flexhinf.robot.limits import check_holding, check_reference
    from flexhinf.robot.mujoco_plant import MuJoCoPlant
    from flexhinf.robot.paper import paper_arm
    from flexhinf.robot.parameter import Parameter
    from flexhinf.robot.parts import ElasticJoint, Link, SingleLink
    from flexhinf.robot.robot import Robot
    from flexhinf.robot.robot_file import load_robot
    from flexhinf.robot.shipped import catalogue


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'flexhinf.robot' has no attribute {name!r}")
    value = getattr(import_module(f"flexhinf.robot.{_HOME[name]}"), name)
    globals()[name] = value
    return value
