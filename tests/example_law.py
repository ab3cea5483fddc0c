"""A law in a file of its own, as CONTRIBUTING.md prints it: no other file names it."""

import numpy as np

from flexhinf.baselines import MotorPD
from flexhinf.design.laws import IN_USE, LawKind, LawOver, register


def gains(model, numbers):
    """Torques (n, 5n) per deviation of links, their velocities, motors, their velocities, and per integral."""
    w, none = model.bandwidths(numbers), np.zeros((len(model.pose),) * 2)
    inertia = np.diag(np.diag(model.home.link_inertia) + model.home.motor_inertia)
    return np.hstack([none, none, -inertia * w**2, -2.0 * inertia * w, none])


register(
    LawKind(
        "pd-critical",
        "PD on the motor side, critically damped",
        group=IN_USE,
        source="Tomei 1991",
        model="inertia",
        make=lambda problem, bandwidth: MotorPD.tuned(problem, bandwidth=bandwidth, damping=1.0),
        tuned=("bandwidth", "estimator_noise", "motor_noise"),
        sensors=(("motor_position",),),
        over=LawOver(gains, ("bandwidth",), ({"share": 1.0}, {"share": 0.5})),
    )
)
