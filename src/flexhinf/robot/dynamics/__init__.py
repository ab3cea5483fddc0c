"""Rigid-body dynamics of trees of joints on any element: forward, inverse, mass matrix."""

from flexhinf.robot.dynamics.algorithms import forward_dynamics, inverse_dynamics, mass_matrix
from flexhinf.robot.dynamics.bodies import Body, bodies_of, lumped, matrix_of, six_of
from flexhinf.robot.dynamics.tree import Joint, Placement, Tree

__all__ = [
    "Body",
    "Joint",
    "Placement",
    "Tree",
    "bodies_of",
    "forward_dynamics",
    "inverse_dynamics",
    "lumped",
    "mass_matrix",
    "matrix_of",
    "six_of",
]
