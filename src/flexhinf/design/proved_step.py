"""The proved step as a criterion of a design: weights and degree for the largest one, or for the smallest proved gain.

Candidates are laws of the preset robust, and for the nominal robot of damped too, over bandwidths, dampings, γ/γ* and
degrees of V. Of each, a step without a jump of the input is run on the nominal robot, for its largest input, and
`sampled_gain` says which γ is worth a proof, for the robot's own penalty and command: the same d and z for all
candidates. They are proved in order, the best first, until one is.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.certify import Certificate
from flexhinf.certify.proof import NotProved
from flexhinf.certify.robot_starts import largest_values, path_start, robot_start, tabled_start
from flexhinf.certify.sampled_gain import sampled_gain
from flexhinf.certify.search import OutOfTime, time_limit
from flexhinf.certify.tolerances import certify_tolerances, parameter_ranges, tolerance_statement
from flexhinf.design.joint_limits import joint_limits
from flexhinf.design.specification import Specification
from flexhinf.design.weights.choose import DesignProblem, choose, measured_problem
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.hinf import HJISolution, solve_hji
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

__all__ = ["ProvedLaw", "proved_law", "search_proved_step"]

#: Factors of the preset's bandwidth, dampings (None: the preset's), and γ/γ* of the candidates.
BANDWIDTHS, DAMPINGS, RATIOS = (0.8, 1.0, 1.3), (None, 0.4), (1.3, 1.5, 2.0)

#: A level is taken so much above the largest V of the starts; γ so much above what sampling finds, in turn.
ROOM, MARGINS = 1.003, (1.05, 1.15, 1.4)

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


@dataclass(frozen=True, eq=False)
class ProvedLaw:
    """A law with the step that is proved.

    Attributes
    ----------
    solution : HJISolution
    problem : GeneralisedPlant
        Whose disturbance and penalty the gain is of.
    step : float
        Rest to rest, to the goal; rad or m, negative from above it.
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
        Laws within the limit whose inequality no sample refused.
    cpu_seconds : float
        That the proof took.
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
    cpu_seconds: float = 0.0


def proved_law(
    robot: Robot, s: Specification, goal: np.ndarray, start: np.ndarray, progress: Callable[[str], None]
) -> ProvedLaw:
    """The law of the preset proved: the smallest proved gain of the step within the largest input, for all tolerances.

    It is about the law with the true state fed back. A robot that states no tolerances is nominal. What the
    specification states of bandwidth, damping, degrees and γ/γ* is not searched for.

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
        tolerances=1.0 if robot.uncertain else 0.0, most_seconds=s.proof_seconds, specification=s, progress=progress,
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
    most_cells : int
    most_seconds : float
        Of one proof, CPU time.
    specification : Specification, optional
        Its bandwidth is what the factors are of; its disturbances, checked penalty, period and others are those
        of the candidates.
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
            for candidate in _laws(robot, goal, step, factor, damping, ratios, degrees, preset, base):
                judged = _judged(candidate, measured, ranges, step, effort_limit)
                if isinstance(judged, str):
                    reasons.append(judged)
                else:
                    found.append(judged)
        except FlexhinfError as error:  # no weights for this bandwidth and damping
            reasons.append(_one_line(error))
    found.sort(key=lambda c: (-round(abs(c.step), 3), c.gamma) if step is None else (0.0, c.gamma))
    unit = "m" if robot.links.slides[0] else "rad"
    about = f"{robot.name}, goal {float(goal[0]):.6g} {unit}"
    for candidate, margin in itertools.product(found, MARGINS):
        gamma, began = margin * candidate.gamma, time.thread_time()
        progress(f"prove a step of {abs(candidate.step):.4g} with gamma = {gamma:.4g}")
        try:
            certificate = certify_tolerances(
                candidate.solution, measured, ranges, gamma, step=candidate.step, scale=candidate.scale, about=about,
                most_cells=most_cells, progress=time_limit(most_seconds),
            )  # fmt: skip
        except NotProved as error:
            reasons.append(f"γ = {gamma:.4g}: {_one_line(error)}")
        except OutOfTime:
            reasons.append(f"γ = {gamma:.4g}: no proof within {most_seconds:g} s of CPU time")
        else:
            seconds = time.thread_time() - began
            return replace(
                candidate, gamma=gamma, certificate=certificate, candidates=len(found), cpu_seconds=seconds
            )
    raise _not_proved(found, reasons, effort_limit)


def _one_line(error: FlexhinfError) -> str:
    return " ".join((error.found or error.what).split())


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
            solve_hji(chosen.problem, ratio * chosen.gamma_star, degree), chosen.nominal, 0.0, np.inf, 1.0, np.inf,
            bandwidth, first.target.damping, ratio, replace(chosen, gamma=ratio * chosen.gamma_star),
        )
        for ratio in ratios
        for degree in degrees
    ]  # fmt: skip


def _judged(
    candidate: ProvedLaw, measured: GeneralisedPlant, ranges: Any, step: float | None, limit: float
) -> ProvedLaw | str:
    """The candidate with its step, the input that this takes, and the sampled γ; or why there is none."""
    solution, side = candidate.solution, 1.0 if step is not None and step < 0.0 else -1.0
    try:
        statement = tolerance_statement(solution, measured, ranges, 1.0)
        longest = LONGEST if step is None else abs(step)
        start = robot_start(statement, side) or tabled_start(solution, statement, longest, side)
        if start is None:
            return "no start without a jump of the input was found for this plant"

        def peak(amplitude: float) -> float:
            x = path_start(statement, start, amplitude)
            return _peak_effort(solution, measured, x, LENGTH / float(np.min(candidate.bandwidth)))

        largest = _largest(peak, longest, limit, step is not None)
        if largest is None:
            return f"a step of {longest:.4g} takes an input of {peak(longest):.3g}"
        level = ROOM * float(largest_values(statement, start, np.linspace(0.0, largest, 200)).max())
        about = float(measured.r2[0, 0] / solution.expansion.r2[0, 0])
        gain = sampled_gain(statement, level, about)
    except FlexhinfError as error:
        return _one_line(error)
    if not np.isfinite(gain.gamma):
        return "with no γ the inequality holds at all corners of the tolerances"
    return replace(
        candidate, problem=measured, step=-side * largest, gamma=gain.gamma, scale=gain.scale,
        peak_effort=peak(largest),
    )  # fmt: skip


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
