"""Robots: physical parameters with tolerances and sources, and the plants made of them."""

from flexhinf.robot.paper import paper_arm
from flexhinf.robot.parameter import Parameter
from flexhinf.robot.robot import Robot

__all__ = ["Parameter", "Robot", "paper_arm"]
