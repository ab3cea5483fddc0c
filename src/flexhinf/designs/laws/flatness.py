"""Feedback linearisation with flatness feedforward, with and without the integral of the link's error.

Over a workspace each link's error is a chain, e⁗ + Σ a_i e^(i) + a_I I = 0: with K (w − z) the spring's torque and
G' = ∂G/∂q

    τ = J K⁻¹ (M v + (K + G') z̈) + K (w − z) + B ẇ,    z̈ = M⁻¹ (K (w − z) − G' z),    v = −Σ a_i z^(i) − a_I I.

Its poles are those of a Bessel filter of order five, or three with the joint's own vibration left where it is, damped.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from flexhinf.designs.laws.kinds import BOTH, LawKind, LawOver, register
from flexhinf.errors import refuse_if
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Matrix, Vector
    from flexhinf.designs.laws.pose_model import PoseModel
else:
    np = late_package("numpy")

#: Damping of a vibration that is left where it is.
LEFT = 0.5


def _at_pose(model: PoseModel, numbers: Mapping[str, Vector], integral: bool) -> Matrix:
    from flexhinf.baselines.placed_laws import bessel_coefficients

    j, n = model.joints, len(model.pose)
    rigid = [name for name, elastic in zip(model.names, model.elastic) if not elastic]
    refuse_if(
        rigid,
        "Flatness of this form needs a spring at each joint.",
        f"expected elastic joints, got rigid ones: {rigid}",
        "--laws without flatness and flatness-i",
    )
    turns = np.sqrt(j.stiffness * (1.0 / np.diag(j.link_inertia) + 1.0 / j.motor_inertia))
    chains = list[np.ndarray]()
    for w, turn in zip(model.bandwidths(numbers), turns):
        order = 4 + integral
        if numbers.get("vibration", 0.0):  # left where it is
            low = np.append(bessel_coefficients(order - 2, w), 1.0)[::-1]
            chain = np.polymul(low, (1.0, 2.0 * LEFT * turn, turn**2))[:0:-1]
        else:
            chain = bessel_coefficients(order, w)
        chains.append(chain if integral else np.append(0.0, chain))
    summed, *rates = np.array(chains).T
    m, slope, k = j.link_inertia, j.gravity_slope, np.diag(j.stiffness)
    z, dz, w, dw = np.eye(4 * n).reshape(4, n, 4 * n)
    inverse = np.linalg.inv(m)
    ddz, dddz = (inverse @ (k @ (b - a) - slope @ a) for a, b in ((z, w), (dz, dw)))
    v = -sum(a[:, None] * row for a, row in zip(rates, (z, dz, ddz, dddz)))
    soft = (j.motor_inertia / j.stiffness)[:, None]
    feedback = soft * (m @ v + (k + slope) @ ddz) + k @ (w - z) + j.motor_damping[:, None] * dw
    return np.hstack([feedback, -soft * m * summed])


_VIBRATIONS = ({"vibration": 0.0}, {"vibration": 1.0})

register(
    LawKind(
        "flatness",
        "feedback linearisation with flatness feedforward",
        "Spong 1987; De Luca & Book 2016",
        LawOver(partial(_at_pose, integral=False), ("bandwidth",), _VIBRATIONS),
        BOTH,
        place=12,
    )
)
register(
    LawKind(
        "flatness-i",
        "flatness with the integral of the link's error",
        "Spong 1987; De Luca & Book 2016, with an integral",
        LawOver(partial(_at_pose, integral=True), ("bandwidth",), _VIBRATIONS),
        BOTH,
        usual=True,
        place=13,
    )
)
