"""The problem of a specification: penalty with its source, disturbances and level, by preset.

========  ========================================================================================================
preset    penalty
========  ========================================================================================================
paper     the robot's own; for a robot that states none, the form of Eq. (11): positions and their integrals alone
damped    found for a bandwidth and a damping, see `flexhinf.design.weights.search`
robust    the same, and every uncertain parameter a disturbance channel, see `flexhinf.design.weights.robust`
given     the penalty of the specification
========  ========================================================================================================

Without a preset: `given` with weights; `damped` with a bandwidth or a damping, or where the robot states no penalty of
its own; otherwise `paper`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from flexhinf.design.specification import RINGS, Specification
from flexhinf.design.weights.design_problem import (
    Covering,
    DesignProblem,
    Robustness,
    command_of,
    nominal_problem,
)
from flexhinf.design.weights.linear_family import LinearDesign, LinearFamily, LinearProblem, worst_members
from flexhinf.design.weights.robust import RobustProblem, find_scalings
from flexhinf.design.weights.scales import JointScales
from flexhinf.design.weights.search import DampingOutOfReach, SearchResult, TargetBehaviour, search
from flexhinf.design.weights.uncertainty import Channel, acting_corners, channels, covering_products
from flexhinf.errors import InvalidInput
from flexhinf.hinf import smallest_gamma
from flexhinf.plant import Penalty

__all__ = [
    "BANDWIDTH_FRACTION", "DAMPING", "DesignProblem", "Robustness", "choose", "preset_of", "required_damping",
]  # fmt: skip

#: Corners among which the worst for the first weights are looked for, to be members of the second search.
MANY = 400

#: Default bandwidth over the lowest frequency at which the links vibrate while the motors are held; default damping.
BANDWIDTH_FRACTION, DAMPING = 0.3, 0.2


def preset_of(robot: Any, s: Specification) -> str:
    """The preset that is meant.

    Raises
    ------
    InvalidInput
        If the specification contradicts itself.
    """
    behaviour = [f"`{name}`" for name in ("bandwidth", "damping") if getattr(s, name) is not None]
    weights = [f"`{name}`" for name in ("penalty", "effort") if getattr(s, name) is not None]
    if behaviour and weights:
        raise _contradiction(f"{behaviour[0]} and {weights[0]}", "leave out one of them")
    if s.preset in ("damped", "robust") and weights:
        raise _contradiction(f"preset={s.preset!r} and {weights[0]}", f"leave out {weights[0]}, or `preset`")
    if s.preset == "paper" and (behaviour or s.penalty is not None):
        other = (behaviour or ["`penalty`"])[0]
        advice = "preset='damped'" if behaviour else "leave out `preset`"
        raise _contradiction(f"preset='paper' and {other}", advice)
    if s.preset is not None:
        return s.preset
    if s.penalty is not None:
        return "given"
    return "damped" if behaviour or (robot.penalty is None and s.effort is None) else "paper"


def required_damping(s: Specification, target: TargetBehaviour | None = None) -> float:
    """Damping ratio that every oscillation must have, where weights are searched for: as stated, or `DAMPING`, or less
    where a design that states none was given less, see `flexhinf.design.synthesis`; then at least `RINGS`."""
    if s.damping is not None:
        return s.damping
    return DAMPING if target is None else max(RINGS, min(DAMPING, target.damping))


def _contradiction(both: str, advice: str) -> InvalidInput:
    return InvalidInput(
        f"{both} contradict each other.",
        "expected either weights, or a behaviour for which weights are found, or the preset paper; got both",
        advice,
    )


def choose(
    robot: Any, goal: np.ndarray, start: np.ndarray, s: Specification, near: DesignProblem | None = None
) -> DesignProblem:
    """The problem of a specification.

    A default damping that no weights reach, as where samples show too little of a fast vibration, yields to what they
    reach; the running loop is judged by `required_damping` all the same.

    Parameters
    ----------
    robot, goal, start, s
    near : DesignProblem, optional
        Of the same robot and preset for another bandwidth or damping, from whose weights the search begins.

    Raises
    ------
    InvalidInput
        For a contradiction, or a behaviour that cannot be met: which limit binds, and the best found.
    InfeasibleGamma, NoFeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        As the synthesis.
    """
    preset = preset_of(robot, s)
    if preset in ("damped", "robust"):
        try:
            return _searched(robot, goal, start, s, preset, None if near is None else near.search)
        except DampingOutOfReach as refused:
            if s.damping is not None or not refused.reached:
                raise
            return _searched(robot, goal, start, replace(s, damping=refused.reached), preset, None)
    penalty, source, priced = _stated(robot, goal, s)
    problem = nominal_problem(robot, goal, s, penalty)
    star = smallest_gamma(problem)
    return DesignProblem(preset, penalty, source, priced, problem, problem, star, s.gamma_ratio * star)


def _stated(robot: Any, goal: np.ndarray, s: Specification) -> tuple[Penalty, str, str]:
    """A penalty that is stated, with the sources of its weights and of R2."""
    own = robot.penalty
    if s.penalty is not None:
        penalty, source, priced = Penalty.of(s.penalty), "option --penalty", "ours"
        if isinstance(s.penalty, Penalty):
            priced = source
        elif own is not None:
            penalty, priced = replace(penalty, effort=own.effort), "the robot's file"
    elif own is not None:
        penalty, source, priced = own, "the robot's file", "the robot's file"
    else:
        scales = JointScales.of(robot.plant(), robot.operating_point(goal))
        weights = scales.weights(np.full(len(goal), BANDWIDTH_FRACTION * scales.held), 0.0)
        kept = ("link_position", "link_position_integral")
        penalty = Penalty({name: _number(weights[name]) for name in kept}, 1.0)
        source, priced = "ours: the form of Eq. (11), scaled to the robot", "ours"
    if s.effort is not None:
        penalty, priced = replace(penalty, effort=s.effort), "option --effort"
    return penalty, source, priced


def _number(values: np.ndarray) -> Any:
    return values.tolist() if len(values) > 1 else float(values[0])


def _searched(
    robot: Any, goal: np.ndarray, start: np.ndarray, s: Specification, preset: str, near: SearchResult | None
) -> DesignProblem:
    plant, equilibrium = robot.plant(), robot.operating_point(goal)
    family, scales = LinearFamily.of(robot, goal, period=s.period), JointScales.of(plant, equilibrium)
    target = TargetBehaviour(_bandwidths(s, scales, len(goal)), required_damping(s))
    torques = None
    if s.disturbances is not None:
        names = nominal_problem(robot, goal, s, scales.penalty(target.bandwidth, 0.0)).disturbances or ()
        torques = np.eye(len(plant.disturbances))[:, [plant.disturbances.index(name) for name in names]]

    def nominal(target_frequency: np.ndarray, damping: np.ndarray) -> LinearProblem:
        return LinearProblem.of(
            family, scales.rows(target_frequency, damping), command_of(s) is not None, torques
        )

    def synthesis(target_frequency: np.ndarray, damping: np.ndarray) -> LinearDesign:
        linear = nominal(target_frequency, damping)
        star = linear.gamma_star()
        return linear.design(s.gamma_ratio * star, star)

    @cache
    def many() -> LinearFamily:
        return LinearFamily.of(robot, goal, MANY, seed=1)

    found, family = _widened(many, target, family, synthesis, scales.held, near)
    source = f"found for {_words(target)}"
    if preset == "damped":
        penalty = scales.penalty(found.chosen.target_frequency, found.chosen.damping_weights)
        problem = nominal_problem(robot, goal, s, penalty)
        star = smallest_gamma(problem)
        return DesignProblem(
            preset, penalty, source, "ours", problem, problem, star, s.gamma_ratio * star, target, found
        )

    tolerances = tolerance_channels(robot, [goal, start])
    scalings = find_scalings(
        RobustProblem(_linear_problem(found, nominal), family.torques, tolerances), s.gamma_ratio
    )

    covering = Covering(
        robot, goal, s, scales, family, torques, tolerances, scalings,
        acting_corners(robot, goal, nominal_problem(robot, goal, s, scales.penalty(target.bandwidth, 0.0))),
    )  # fmt: skip

    def covered(factor: float) -> DesignProblem:
        """With all tolerances enlarged by a factor."""
        larger = replace(covering, enlarged=factor)

        def robust_synthesis(target_frequency: np.ndarray, damping: np.ndarray) -> LinearDesign:
            return larger.linear(target_frequency, damping).design(s.gamma_ratio, larger.channels_at(1.0))

        found, _ = _widened(many, target, family, robust_synthesis, scales.held)
        source = f"found for {_words(target)}, beside the channels of the tolerances"
        return larger.problem(found.chosen.target_frequency, found.chosen.damping_weights, 1.0).checked(
            target, found, source
        )

    first = covered(1.0)
    if scalings.fraction < 1.0:
        return first
    return covering_products(first, covered, _failing)


def tolerance_channels(robot: Any, poses: Sequence[np.ndarray]) -> tuple[Channel, ...]:
    """The channels of a robot's tolerances, each at that of the poses where it does most.

    Raises
    ------
    InvalidInput
        If there are none.
    """
    found = channels(robot, poses)
    if not found:
        raise InvalidInput(
            f"The robot {robot.name!r} states no tolerances that the preset robust could stand for.",
            "expected parameters with a tolerance that changes how the robot moves, got none",
            "tolerance = 10 beside a value in the robot's file, or preset='damped'",
        )
    return found


def _failing(made: DesignProblem) -> int:
    assert made.robustness is not None
    return made.robustness.failing_corners


def _widened(
    many: Callable[[], LinearFamily],
    target: TargetBehaviour,
    family: LinearFamily,
    synthesis: Any,
    held: float,
    near: SearchResult | None = None,
) -> tuple[SearchResult, LinearFamily]:
    """A search, and again with the worst of many corners among the members."""
    start = None if near is None else near.chosen
    if len(family.a) == 1:
        return search(target, family, synthesis, held, near=start), family
    found = search(target, family, synthesis, held, each=False) if near is None else near
    wider = family.with_members(many(), worst_members(many(), found.chosen.design.gain))
    return search(target, wider, synthesis, held, near=start), wider


def _linear_problem(found: SearchResult, nominal: Any) -> LinearProblem:
    return nominal(found.chosen.target_frequency, found.chosen.damping_weights)


def _bandwidths(s: Specification, scales: JointScales, joints: int) -> np.ndarray:
    required = BANDWIDTH_FRACTION * scales.held if s.bandwidth is None else s.bandwidth
    values = np.atleast_1d(np.asarray(required, dtype=float))
    if len(values) not in (1, joints):
        raise InvalidInput(
            "The bandwidths do not fit the joints.",
            f"expected one number or {joints}, got {values.tolist()}",
            "one bandwidth for all joints",
        )
    return np.broadcast_to(values, (joints,)).copy()


def _words(target: TargetBehaviour) -> str:
    low, high = target.bandwidth.min(), target.bandwidth.max()
    band = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
    return f"{band} rad/s and a damping ratio of {target.damping:.3g}"
