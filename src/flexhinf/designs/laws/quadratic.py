"""LQG: a linear-quadratic law of the states that an estimator knows.

It minimises Σ |W² N e|² + |v W N ė|² + |½ W³ N I|² + |u / u_max|² of the sampled model, W the
bandwidth and N = (M + J) / τ_max: a deviation costs as much as the input with which a rigid robot of that bandwidth
would meet it.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, cast

from flexhinf.designs.laws.kinds import LawKind, LawOver, register
from flexhinf.errors import NumericalFailure
from flexhinf.validation import late_package

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.arrays import Matrix, Vector
    from flexhinf.designs.laws.pose_model import PoseModel
else:
    np = late_package("numpy")

#: Weights of velocities and integrals of an LQG.
VELOCITY, INTEGRATED = 3.0, 0.5


def _lqg_at_pose(model: PoseModel, numbers: Mapping[str, Vector]) -> Matrix:
    from scipy.linalg import solve_discrete_are

    from flexhinf.analysis.linear_loop import exponential
    from flexhinf.plant.joints import joint_places

    n, plant, period = len(model.pose), model.plant, model.period
    a, b, _, _ = plant.linearise(*model.equilibrium)
    f, g = exponential(a, b, period)
    f = np.block([[f, np.zeros((plant.n, n))], [period * np.eye(n), np.zeros((n, plant.n - n)), np.eye(n)]])
    g = np.vstack([g, np.zeros((n, n))])
    limit = model.authority
    whole = model.joints.link_inertia + np.diag(model.joints.motor_inertia)
    whole = whole / (limit * model.joints.torque_per_input)[:, None]
    w = np.broadcast_to(numbers["bandwidth"], n)
    (q, dq, _, _), weights = joint_places(plant), np.zeros((3 * n, plant.n + n))
    weights[:n, q] = whole * w**2
    weights[n : 2 * n, dq] = VELOCITY * whole * w
    weights[2 * n :, plant.n :] = INTEGRATED * whole * w**3
    cost, small = np.diag(limit**-2.0), 1e-12 * np.eye(plant.n + n)
    try:
        p = cast("Matrix", solve_discrete_are(f, g, weights.T @ weights + small, cost))
    except np.linalg.LinAlgError as error:
        raise NumericalFailure(
            "There is no LQG at a pose.", f"{error}, at {model.pose.tolist()}", "--laws without lqg"
        ) from error
    return cast("Matrix", -np.linalg.solve(cost + g.T @ p @ g, g.T @ p @ f))


register(
    LawKind(
        "lqg",
        "LQR of the sampled model at each pose, with an estimator",
        "Anderson & Moore 1990",
        LawOver(_lqg_at_pose, ("bandwidth",), of_states=True),
        usual=True,
        place=14,
    )
)
