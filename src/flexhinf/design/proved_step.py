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

from flexhinf.certify import Certificate
from flexhinf.certify.proof import NotProved
from flexhinf.certify.robot_starts import largest_values, path_start, robot_start, tabled_start
from flexhinf.certify.sampled_gain import sampled_gain
from flexhinf.certify.tolerances import certify_tolerances, parameter_ranges, tolerance_statement
from flexhinf.design.specification import Specification
from flexhinf.design.weights.choose import DesignProblem, choose
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.hinf import HJISolution, solve_hji
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

__all__ = ["ProvedLaw", "search_proved_step"]

#: Factors of the preset's bandwidth, dampings (None: the preset's), and γ/γ* of the candidates.
BANDWIDTHS, DAMPINGS, RATIOS = (0.8, 1.0, 1.3), (None, 0.4), (1.3, 1.5, 2.0)

#: A level is taken so much above the largest V of the starts; γ so much above what sampling finds, in turn.
ROOM, MARGINS = 1.003, (1.05, 1.15, 1.4)

#: The longest step that is looked for, rad or m, and the number of halvings that find the largest one.
LONGEST, HALVINGS = np.pi, 7

#: A step is run for this many times the inverse bandwidth.
LENGTH = 12.0


@dataclass(frozen=True, eq=False)
class ProvedLaw:
    """A law with the step that is proved.

    Attributes
    ----------
    solution : HJISolution
    problem : GeneralisedPlant
        Whose disturbance and penalty the gain is of.
    step : float
        Rest to rest, to the goal; rad or m.
    gamma : float
        Proved; of the sampled candidates, what sampling found.
    scale : float
        The storage function is scale · V.
    peak_effort : float
        Largest |u| of the step on the nominal robot.
    bandwidth : ndarray
    damping : float
    ratio : float
        γ/γ* of the law's own design.
    design_problem : DesignProblem
        Whose solution the law is; its γ is the law's.
    certificate : Certificate or None
        None before the proof.
    candidates : int
    """

    solution: HJISolution
    problem: GeneralisedPlant
    step: float
    gamma: float
    scale: float
    peak_effort: float
    bandwidth: np.ndarray
    damping: float
    ratio: float
    design_problem: DesignProblem
    certificate: Certificate | None = None
    candidates: int = 1


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
    specification: Specification | None = None,
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
        Wanted: the smallest proved γ is looked for. Default: the largest step, up to π.
    effort_limit : float
        Largest |u| of the step on the nominal robot, V or N·m.
    tolerances : float
        Of which the proof holds, over those that the robot states: 1 for all, 0 for the nominal robot.
    degrees, bandwidths, dampings, ratios : sequence
        Degrees of V, factors of the preset's bandwidth, dampings (None: the preset's), γ/γ*. A degree above 2 needs an
        equilibrium that stays, or `tolerances` 0.
    most_cells : int
        Of one proof.
    specification : Specification, optional
        Its bandwidth is what the factors are of; its limits, period and other fields are those of the candidates.
    progress : callable
        Called with what comes next.

    Raises
    ------
    InvalidInput
        No candidate is within the limit, or none can be proved.
    """
    if len(robot.joint_names) != 1:
        raise InvalidInput(
            "A step is proved for robots of one joint.",
            f"expected one joint, got {len(robot.joint_names)} in {robot.name!r}",
            "preset='robust'",
        )
    base = specification or Specification()
    measured = robot.problem(pose=goal)
    ranges = parameter_ranges(robot, measured.plant, tolerances) if tolerances else {}
    found: list[ProvedLaw] = []
    presets = (("robust",) if robot.uncertain else ()) + (() if ranges else ("damped",))
    for preset, factor, damping in itertools.product(presets, bandwidths, dampings):
        progress(
            f"candidates: {preset}, {factor:g} times its bandwidth, damping {damping or 'of the preset'}"
        )
        for candidate in _laws(robot, goal, step, factor, damping, ratios, degrees, preset, base):
            judged = _judged(candidate, measured, ranges, step, effort_limit)
            found += [] if judged is None else [judged]
    found.sort(key=lambda c: (-round(c.step, 3), c.gamma) if step is None else (0.0, c.gamma))
    for candidate, margin in itertools.product(found, MARGINS):
        gamma = margin * candidate.gamma
        progress(f"prove a step of {candidate.step:.4g} with gamma = {gamma:.4g}")
        try:
            certificate = certify_tolerances(
                candidate.solution, measured, ranges, gamma, step=candidate.step, scale=candidate.scale,
                about=f"{robot.name}, goal {float(goal[0]):.6g}", most_cells=most_cells,
            )  # fmt: skip
        except NotProved:
            continue
        return replace(candidate, gamma=gamma, certificate=certificate, candidates=len(found))
    raise InvalidInput(
        "No step could be proved.",
        f"expected a law within {effort_limit:g} whose inequality holds, got {len(found)} candidates and no proof",
        "a larger effort limit, a smaller step, smaller tolerances, or other bandwidths and dampings",
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
) -> list[ProvedLaw]:
    """The laws of one bandwidth and damping; none where the preset finds no weights."""
    pose = np.asarray(goal, dtype=float)
    start = pose - (np.pi / 2 if step is None else step)
    s = replace(base, pose=tuple(pose), start=tuple(start), preset=preset, damping=damping)
    try:
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
                solve_hji(chosen.problem, ratio * chosen.gamma_star, degree), chosen.nominal, 0.0, np.inf, 1.0, np.inf,
                bandwidth, first.target.damping, ratio, replace(chosen, gamma=ratio * chosen.gamma_star),
            )
            for ratio in ratios
            for degree in degrees
        ]  # fmt: skip
    except FlexhinfError:
        return []


def _judged(
    candidate: ProvedLaw, measured: GeneralisedPlant, ranges: Any, step: float | None, limit: float
) -> ProvedLaw | None:
    """The candidate with its step, the input that this takes, and the sampled γ; None beyond the limit or without γ."""
    solution = candidate.solution
    try:
        statement = tolerance_statement(solution, measured, ranges, 1.0)
        longest = LONGEST if step is None else step
        start = robot_start(statement) or tabled_start(solution, statement, longest)
        if start is None:
            return None

        def peak(amplitude: float) -> float:
            x = path_start(statement, start, amplitude)
            return _peak_effort(solution, measured, x, LENGTH / float(np.min(candidate.bandwidth)))

        largest = _largest(peak, longest, limit, step is not None)
        if largest is None:
            return None
        level = ROOM * float(largest_values(statement, start, np.linspace(0.0, largest, 200)).max())
        about = float(measured.r2[0, 0] / solution.expansion.r2[0, 0])
        gain = sampled_gain(statement, level, about)
    except FlexhinfError:
        return None
    if not np.isfinite(gain.gamma):
        return None
    return replace(
        candidate,
        problem=measured,
        step=largest,
        gamma=gain.gamma,
        scale=gain.scale,
        peak_effort=peak(largest),
    )


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
