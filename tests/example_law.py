"""A law in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

import numpy as np

from flexhinf.designs.laws import LawKind, LawOver, register


def gains(model, numbers):
    """Torques (n, 5n) per deviation of links, their velocities, motors, their velocities, and integral."""
    w, none = model.bandwidths(numbers), np.zeros((len(model.pose),) * 2)
    inertia = np.diag(np.diag(model.home.link_inertia) + model.home.motor_inertia)
    return np.hstack([none, none, -inertia * w**2, -2.0 * inertia * w, none])


over = LawOver(gains, names=("bandwidth",), variants=({"share": 1.0}, {"share": 0.5}))
register(LawKind("pd-critical", "critically damped PD", "Tomei 1991", over, sensors=("motor_position",)))
