"""The proved step as a criterion of a design: weights and degree for the largest one, or for the smallest proved gain.

Candidates are laws of the preset robust, and for the nominal robot of damped too, over bandwidths, dampings, γ/γ* and
degrees of V. Of each, a step without a jump of the input is run on the nominal robot, for its largest input, and
`sampled_gain` says which γ is worth a proof, for the robot's own penalty and command: the same d and z for all
candidates. They are proved in order, the best first, until one is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.certify.box import parameter_ranges, tolerance_statement
from flexhinf.certify.evaluation import path_start
from flexhinf.design.box_proof import (
    BoxProof,
    NotWithinTolerances,
    margins_of,
    prove_box,
    reason_of,
    sampled_box,
    step_start,
)
from flexhinf.design.joint_limits import joint_limits
from flexhinf.design.problem.presets import DesignProblem, choose, measured_problem
from flexhinf.design.specification import Specification
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.hinf import HJISolution, solve_hji
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

#: Factors of the preset's bandwidth, dampings (None: the preset's), and γ/γ* of the candidates.
BANDWIDTHS, DAMPINGS, RATIOS = (0.8, 1.0, 1.3), (None, 0.4), (1.3, 1.5, 2.0)

#: The longest step that is looked for, rad or m, and the number of halvings that find the largest one.
LONGEST, HALVINGS = np.pi, 7

#: A step is run for this many times the inverse bandwidth.
LENGTH = 12.0

#: Reasons that are shown where nothing is proved.
SHOWN = 3

#: Fields that contradict the preset proved, and why.
CONTRADICTIONS = {
    "via": "one law at the goal, whose gain is proved",
    "rays": "a region that is proved, and none that is sampled",
    "checked_gamma_ratio": "the smallest gain that can be proved, which is searched for",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class ProvedLaw(BoxProof):
    """The law that was searched for, with its proof.

    Attributes
    ----------
    bandwidth : ndarray
        rad/s.
    ratio : float
        γ/γ* of the law's own design.
    design_problem : DesignProblem
        Whose solution the law is; its γ is the law's.
    peak_effort : float
        Largest |u| of the step on the nominal robot.
    candidates : int
        Laws within the limit whose inequality no sample refused.
    """

    bandwidth: np.ndarray
    damping: float
    ratio: float
    design_problem: DesignProblem
    peak_effort: float = np.inf
    candidates: int = 1


def proved_law(
    robot: Robot,
    s: Specification,
    goal: np.ndarray,
    start: np.ndarray,
    admits: Callable[[ProvedLaw], str],
    progress: Callable[[str], None],
) -> ProvedLaw:
    """The law of the preset proved: the smallest proved gain of the step within the largest input, for all tolerances.

    The proof is about the law with the true state fed back; `admits` may refuse one for what it does with the
    estimator. A robot that states no tolerances is nominal. What the specification states of bandwidth, damping,
    degrees and γ/γ* is not searched for.

    Raises
    ------
    InvalidInput
        A contradiction, more than one joint, or no proof.
    """
    _check(robot, s)
    stated: dict[str, Any] = {} if s.bandwidth is None else {"bandwidths": (1.0,)}
    stated |= {} if s.damping is None else {"dampings": (s.damping,)}
    stated |= {} if s.degrees is None else {"degrees": s.degrees}
    stated |= {} if s.gamma_ratio == Specification().gamma_ratio else {"ratios": (s.gamma_ratio,)}
    return search_proved_step(
        robot, goal.tolist(), float((goal - start)[0]), effort_limit=float(joint_limits(robot, s).effort[0]),
        tolerances=1.0 if robot.uncertain else 0.0, most_seconds=s.proof_seconds, specification=s, admits=admits,
        progress=progress,
        **stated,
    )  # fmt: skip


def _check(robot: Robot, s: Specification) -> None:
    default = Specification()
    for name, why in CONTRADICTIONS.items():
        if (value := getattr(s, name)) and value != getattr(default, name):
            raise InvalidInput(
                f"preset='proved' and `{name}` contradict each other.",
                f"expected {why}, got {name}={value!r}",
                f"leave out `{name}`, or preset='robust'",
            )
    if not s.proof_seconds:
        raise InvalidInput(
            "preset='proved' needs time for a proof.",
            "expected seconds of CPU time that one proof may take, got proof_seconds=0",
            "proof_seconds=20",
        )
    if len(robot.joint_names) != 1:
        raise InvalidInput(
            "A step is proved for robots of one joint.",
            f"expected one joint, got {len(robot.joint_names)} in {robot.name!r}",
            "preset='robust'",
        )


def search_proved_step(
    robot: Robot,
    goal: Sequence[float],
    step: float | None = None,
    *,
    effort_limit: float = np.inf,
    tolerances: float = 1.0,
    degrees: Sequence[int] = (2,),
    bandwidths: Sequence[float] = BANDWIDTHS,
    dampings: Sequence[float | None] = DAMPINGS,
    ratios: Sequence[float] = RATIOS,
    most_cells: int = 5_000_000,
    most_seconds: float = np.inf,
    specification: Specification | None = None,
    admits: Callable[[ProvedLaw], str] = lambda law: "",
    progress: Callable[[str], None] = lambda text: None,
) -> ProvedLaw:
    """The largest proved step to a goal, or the smallest proved γ for a wanted one.

    Parameters
    ----------
    robot : Robot
        With one joint.
    goal : (1,)
        rad or m.
    step : float, optional
        Wanted, negative from above the goal: the smallest proved γ is looked for. Default: the largest step from below,
        up to π.
    effort_limit : float
        Largest |u| of the step on the nominal robot, V or N·m.
    tolerances : float
        Of which the proof holds, over those that the robot states: 1 for all, 0 for the nominal robot.
    degrees, bandwidths, dampings, ratios : sequence
        Degrees of V, factors of the preset's bandwidth, dampings (None: the preset's), γ/γ*. A degree above 2 needs an
        equilibrium that stays, or `tolerances` 0.
    most_seconds : float
        Of one proof, CPU time.
    specification : Specification, optional
        Its bandwidth is what the factors are of; its disturbances, checked penalty, period and others are those
        of the candidates.
    admits : callable
        Called with each law before it is proved, the best first: why it is left out, with all that are as fast, or "".
    progress : callable
        Called with what comes next.

    Raises
    ------
    InvalidInput
        No candidate is within the limit, or none can be proved.
    """
    base = specification or Specification()
    _check(robot, base)
    measured = measured_problem(robot, np.asarray(goal, dtype=float), base)
    ranges = parameter_ranges(robot, measured.plant, tolerances) if tolerances else {}
    found: list[ProvedLaw] = []
    reasons: list[str] = []
    presets = (("robust",) if robot.uncertain else ()) + (() if ranges else ("damped",))
    for preset, factor, damping in itertools.product(presets, bandwidths, dampings):
        progress(
            f"candidates: {preset}, {factor:g} times its bandwidth, damping {damping or 'of the preset'}"
        )
        try:
            for candidate in _laws(
                robot, goal, step, factor, damping, ratios, degrees, preset, base, measured
            ):
                try:
                    found.append(_within(candidate, ranges, step, effort_limit))
                except FlexhinfError as error:
                    reasons.append(reason_of(error))
        except FlexhinfError as error:  # no weights for this bandwidth and damping
            reasons.append(reason_of(error))
    found.sort(key=lambda c: (-round(abs(c.step), 3), c.gamma) if step is None else (0.0, c.gamma))
    limits: Any = {"seconds": most_seconds, "most_cells": most_cells}
    slow_enough = np.inf  # rad/s: what is as fast as a law that was left out is left out too
    for candidate in found:
        if float(np.min(candidate.bandwidth)) >= slow_enough:
            continue
        if refused := admits(candidate):
            reasons.append(refused)
            slow_enough = float(np.min(candidate.bandwidth))
            continue
        for margin in margins_of(candidate):
            gamma = margin * candidate.gamma
            progress(f"prove a step of {abs(candidate.step):.4g} with gamma = {gamma:.4g}")
            try:
                proved = prove_box(robot, candidate, ranges, margins=(margin,), **limits)
            except NotWithinTolerances as error:
                reasons.append(reason_of(error))
            else:
                return replace(proved, candidates=len(found))
    raise _not_proved(found, reasons, effort_limit)


def _not_proved(found: Sequence[ProvedLaw], reasons: Sequence[str], limit: float) -> InvalidInput:
    """The error with the reasons that were met most often."""
    often = sorted(dict.fromkeys(reasons), key=lambda reason: -reasons.count(reason))[:SHOWN]
    within = f"whose step stays within {limit:g} and " if np.isfinite(limit) else ""
    return InvalidInput(
        "No step could be proved.",
        f"expected a law {within}whose inequality holds, got {len(found)} candidates and no proof: {'; '.join(often)}",
        "a larger `peak_effort`, a smaller step, smaller tolerances, another bandwidth or damping, or longer "
        "`proof_seconds`",
    )


def _laws(
    robot: Robot,
    goal: Any,
    step: float | None,
    factor: float,
    damping: Any,
    ratios: Any,
    degrees: Any,
    preset: Any,
    base: Specification,
    measured: GeneralisedPlant,
) -> list[ProvedLaw]:
    """The laws of one bandwidth and damping; raises as `choose` where the preset finds no weights."""
    pose = np.asarray(goal, dtype=float)
    start = pose - (np.pi / 2 if step is None else step)
    s = replace(base, pose=tuple(pose), start=tuple(start), preset=preset, damping=damping)
    first = choose(robot, pose, start, s)
    assert first.target is not None
    bandwidth = factor * first.target.bandwidth
    chosen = (
        first
        if factor == 1.0
        else choose(robot, pose, start, replace(s, bandwidth=tuple(bandwidth.tolist())))
    )
    return [
        ProvedLaw(
            solution=solve_hji(chosen.problem, ratio * chosen.gamma_star, degree), problem=measured,
            step=np.nan if step is None else step, bandwidth=bandwidth, damping=first.target.damping, ratio=ratio,
            design_problem=replace(chosen, gamma=ratio * chosen.gamma_star),
        )
        for ratio in ratios
        for degree in degrees
    ]  # fmt: skip


def _within(candidate: ProvedLaw, ranges: Any, step: float | None, limit: float) -> ProvedLaw:
    """The candidate with its step, the input that this takes, and the sampled γ; raises where there is none."""
    solution, measured = candidate.solution, candidate.problem
    wanted = LONGEST if step is None else step
    statement = tolerance_statement(solution, measured, ranges, 1.0)
    start = step_start(statement, solution, wanted)

    def peak(amplitude: float) -> float:
        x = path_start(statement, start, amplitude)
        return _peak_effort(solution, measured, x, LENGTH / float(np.min(candidate.bandwidth)))

    largest = _largest(peak, abs(wanted), limit, step is not None)
    if largest is None:
        raise NotWithinTolerances(f"a step of {abs(wanted):.4g} takes an input of {peak(abs(wanted)):.3g}")
    step = float(np.copysign(largest, wanted))
    return sampled_box(replace(candidate, step=step, peak_effort=peak(largest)), ranges)


def _largest(peak: Callable[[float], float], longest: float, limit: float, wanted: bool) -> float | None:
    """The longest step within the limit; None for a wanted one that is not, and where even short ones are not."""
    if peak(longest) <= limit:
        return longest
    low, high = 0.0, longest
    for _ in range(0 if wanted else HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if peak(middle) <= limit else (low, middle)
    return low or None


def _peak_effort(solution: HJISolution, measured: GeneralisedPlant, x: np.ndarray, duration: float) -> float:
    """Largest |u| from a state (n,) on, of the nominal robot; inf where the run diverges."""
    from scipy.integrate import solve_ivp

    held = np.asarray(measured.operating_input, dtype=float)
    far = 1e3 * (1.0 + np.abs(x).max())

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        f, _, g2, _ = measured.fields(state[None])
        return f[0] + g2[0] @ solution.inputs(state[None])[0]

    def diverged(t: float, state: np.ndarray) -> float:
        return float(far - np.abs(state).max())

    diverged.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(rates, (0.0, duration), x, method="LSODA", rtol=1e-6, atol=1e-8, events=diverged)
    if run.status != 0:
        return float("inf")
    return float(np.abs(held + solution.inputs(run.y.T)).max())
