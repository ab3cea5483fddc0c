"""Laws of other kinds in a controller for a workspace: their gains at the commanded pose, and numbers that users state.

`flexhinf.designs.laws` has their formulas.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from flexhinf.arrays import Matrix, Vector
from flexhinf.baselines.posed_laws import GainsOnTheWay
from flexhinf.designs.laws import LawOver, law_kind
from flexhinf.designs.laws.pose_model import PoseModel
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant.joints import ElasticJoints, elastic_joints, joint_places

#: Poses whose gains are kept.
KEPT = 2000

#: Numbers of a law by name: one, or one for each joint.
Gains = Mapping[str, tuple[float, ...]]


def over_of(name: str) -> LawOver:
    """How the gains of a law are made at a pose."""
    over = law_kind(name).over
    assert over is not None, "only such laws are made of numbers"
    return over


def _arrays(numbers: Mapping[str, object]) -> Mapping[str, Vector]:
    return {name: np.atleast_1d(np.asarray(x, dtype=float)) for name, x in numbers.items()}


def _pose_model(setup: WorkspaceSetup, pose: Vector, joints: ElasticJoints, home: ElasticJoints) -> PoseModel:
    places = joint_places(setup.model)
    return PoseModel(
        setup.model,
        setup.robot.operating_point(pose),
        pose,
        setup.specification.period,
        setup.authority,
        joints,
        home,
        setup.joints,
        places[0] != places[2],
    )


def rival_law(setup: WorkspaceSetup, name: str, numbers: Mapping[str, object]) -> GainsOnTheWay:
    """The law of a name with these numbers, one or one for each joint, in the place of a setup's own law.

    Raises `InvalidInput` for a law that does not fit the robot.
    """
    plant, own, over = setup.model, _arrays(numbers), over_of(name)
    places, home = joint_places(plant), np.asarray(setup.robot.home, dtype=float)

    @lru_cache(KEPT)
    def at(pose: bytes) -> ElasticJoints:
        return elastic_joints(plant, *setup.robot.operating_point(np.frombuffer(pose)), rigid=True)

    @lru_cache(KEPT)
    def gains(pose: bytes) -> Matrix:
        q = np.frombuffer(pose)
        model = _pose_model(setup, q, at(pose), at(home.tobytes()))
        found = over.make(model, own)
        if over.of_states:
            return found
        n, slope = len(q), np.zeros((len(q), plant.n + len(q)))
        states = found[:, : 4 * n] + model.joints.torque_driven if model.joints.inner else found[:, : 4 * n]
        np.add.at(slope.T, places.ravel(), states.T)
        slope[:, plant.n :] = found[:, 4 * n :]
        return slope / model.joints.torque_per_input[:, None]

    def gain(pose: Vector) -> Matrix:
        return gains(np.ascontiguousarray(pose, dtype=float).tobytes())

    integrate = setup.law.integrate
    return GainsOnTheWay(
        plant=plant, equilibrium=setup.robot.operating_point(home), integrate=integrate, gain=gain
    )


def home_bandwidths(setup: WorkspaceSetup, numbers: Mapping[str, object]) -> Vector:
    """ω_j (n,) of a law with these numbers at home, rad/s: what the springs leave of the stated bandwidth."""
    home = np.asarray(setup.robot.home, dtype=float)
    joints = elastic_joints(setup.model, *setup.robot.operating_point(home), rigid=True)
    return _pose_model(setup, home, joints, joints).bandwidths(_arrays(numbers))


def check_numbers(name: str, numbers: Mapping[str, object], joints: int) -> dict[str, tuple[float, ...]]:
    """The numbers that a user states for a law, each (1,) or (n,).

    Raises `InvalidInput` for a law without such numbers, for another name, length or sign, for what is no finite
    number, and for gains that are neither made of a bandwidth nor stated.
    """
    over, found = law_kind(name).over, dict[str, tuple[float, ...]]()
    known = () if over is None else over.names
    refuse_if(
        not known,
        f"The law {name!r} has no numbers.",
        f"expected no table of gains for it, got [{name}]",
        f"leave out [{name}]; --laws {name} compares it",
    )
    for key, value in numbers.items():
        refuse_if(
            key not in known,
            f"The law {name!r} has no number {key!r}.",
            f"expected some of {', '.join(known)}, got {key!r}",
            f"bandwidth = 20.0 in the table of {name}",
        )
        try:
            row = np.atleast_1d(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            row = np.full(1, np.nan)
        if row.shape not in ((1,), (joints,)) or isinstance(value, bool) or not np.all(np.isfinite(row)):
            raise InvalidInput(
                f"{key} of the law {name!r} does not fit the robot.",
                f"expected a finite number, or a list of {joints}, got {str(value)[:80]}",
                f"{key} = {[1.0] * joints}, in the order of the joints",
            )
        positive = key in ("bandwidth", "rotor_inertia")
        refuse_if(
            bool(np.any(row <= 0.0 if positive else row < 0.0)),
            f"{key} of the law {name!r} has the wrong sign.",
            f"expected {'positive numbers' if positive else 'numbers >= 0'}, got {row.tolist()}",
            "errors are fed back with the opposite sign already",
        )
        found[key] = tuple(row.tolist())
    whole = "bandwidth" in found or ({"kp", "kd"} <= {*found} and ("ki" in found or "ki" not in known))
    refuse_if(
        not whole,
        f"The gains of the law {name!r} are not all stated.",
        f"expected bandwidth, or {', '.join(key for key in known if key[0] == 'k')}; got {', '.join(found)}",
        "bandwidth = 20.0, in rad/s",
    )
    return found
