"""A law in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

import numpy as np

from flexhinf.baselines import MotorPD
from flexhinf.design.laws import IN_USE, LawKind, LawOver, register


def about_a_pose(problem, bandwidth):
    return MotorPD.tuned(problem, bandwidth=bandwidth, damping=1.0)


def over_a_workspace(model, numbers):
    """Torques (n, 5n) per deviation of links, their velocities, motors, their velocities, and integral."""
    w, none = model.bandwidths(numbers), np.zeros((len(model.pose),) * 2)
    inertia = np.diag(np.diag(model.home.link_inertia) + model.home.motor_inertia)
    return np.hstack([none, none, -inertia * w**2, -2.0 * inertia * w, none])


over = LawOver(over_a_workspace, names=("bandwidth",), variants=({"share": 1.0}, {"share": 0.5}))
tuned = ("bandwidth", "estimator_noise", "motor_noise")
what = "pd-critical", "critically damped PD", IN_USE, "Tomei 1991", "inertia"
register(LawKind(*what, make=about_a_pose, tuned=tuned, over=over))
