"""The proved step as the criterion of a design: a search for the largest proved step, or for the smallest proved gain.

`search_proved_step` tries the candidates of docs/weights.md, "The preset `proved`"; for the nominal robot also those of
the preset damped. `prove_box` proves one law for every robot within its tolerances. The gain is from the disturbances
to the z of `measured_problem`, which is the same for all laws of a robot. The storage function is a common quadratic V
(`flexhinf.certify.box`) for a linear law, otherwise a multiple of the law's own V; its level set contains the step of
every robot.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from flexhinf.analysis.optimiser import bisected
from flexhinf.certify import Certificate, box, cells, claim, proof, starts
from flexhinf.certify.certificate import path_start
from flexhinf.designs.problem.presets import DesignProblem, choose, measured_problem
from flexhinf.designs.specification import FIELDS, Specification
from flexhinf.errors import FlexhinfError, InvalidInput, refuse_if
from flexhinf.hinf import HJISolution, smallest_gamma, solve_hji
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

Ranges = Mapping[str, tuple[float, float]]

#: Factor of the level over the largest V of the starts; factors of γ over the sampled one, tried in turn.
ROOM, MARGINS = 1.003, (1.05, 1.15, 1.4)

#: Factors of γ over the smallest one of a common quadratic V, tried in turn: definite matrices need room for
#: enclosures. A proof by cells uses the last factor only, as fewer cells are needed with a larger margin.
QUADRATIC_MARGINS = (1.02, 1.05, 1.1, 1.6)


class NotWithinTolerances(InvalidInput):
    """The refusal of a law that cannot be proved for all robots within the tolerances."""

    def __init__(self, found: str, advice: str = "preset='proved', which searches a law that can") -> None:
        super().__init__("The law is not proved for all robots within the tolerances.", found, advice)


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxProof:
    """A law with its step that is proved for all robots within the tolerances."""

    solution: HJISolution
    problem: GeneralisedPlant  # The problem whose disturbance and penalty define the gain
    step: float  # Step from rest to rest at the goal, rad or m; negative from above the goal
    gamma: float = np.inf  # The proved γ; before the proof, the sampled one
    scale: float = 1.0  # The storage function is scale · V, with V of the law
    p: np.ndarray | None = None  # (n, n); the storage function of a linear law is ½ xᵀPx with this P instead
    common: box.CommonValue | None = None  # Source of P
    certificate: Certificate | None = None  # None before the proof
    cpu_seconds: float = 0.0  # CPU time of the proof, s

    def value(self, x: np.ndarray) -> Any:
        """The storage function at deviations (n,) or (N, n) from the goal."""
        return (
            self.scale * self.solution.value(x) if self.p is None else 0.5 * np.sum((x @ self.p) * x, axis=-1)
        )

    @property
    def inner_level(self) -> float:
        """Largest level of the law's own V whose level set lies in the proved region."""
        assert self.certificate is not None
        if self.p is None:
            return self.certificate.level / self.scale
        largest = np.linalg.eigvals(np.linalg.solve(self.solution.P, self.p)).real.max()
        return self.certificate.level / float(largest)


AnyBoxProof = TypeVar("AnyBoxProof", bound=BoxProof)


def step_start(statement: Certificate, solution: HJISolution, step: float) -> claim.Start:
    """Starts of a step without a jump of the input: by a formula for each robot, otherwise from a table."""
    side = 1.0 if step < 0.0 else -1.0
    start = starts.robot_start(statement, side) or starts.tabled_start(solution, statement, abs(step), side)
    if start is None:
        raise NotWithinTolerances("no start without a jump of the input was found for this plant")
    return start


def common_box(law: AnyBoxProof, ranges: Ranges) -> AnyBoxProof:
    """The linear law with the smallest γ for which a common quadratic V exists, and with that V."""
    common = box.common_value(box.tolerance_statement(law.solution, law.problem, ranges, 1.0))
    if common is None:
        raise NotWithinTolerances("no quadratic V decreases at all corners of the tolerances")
    return replace(law, gamma=common.smallest, p=common.p(max(QUADRATIC_MARGINS)), common=common)


def sampled_box(law: AnyBoxProof, ranges: Ranges) -> AnyBoxProof:
    """The law with the γ for which a proof is tried, and its storage function.

    A linear law has the quadratic V of the smallest gain for all slopes of the plant's functions. Other laws, and a
    linear one without such a V, have a multiple of their own V, with the smallest γ that no sample of the region
    refuses.
    """
    if law.solution.degree == 2:
        with suppress(NotWithinTolerances):  # on a region the slopes are smaller, so a V may exist there
            return common_box(law, ranges)
    statement = box.tolerance_statement(law.solution, law.problem, ranges, 1.0)
    values = starts.largest_values(
        statement, step_start(statement, law.solution, law.step), np.linspace(0.0, abs(law.step), 200)
    )
    about = float(law.problem.r2[0, 0] / law.solution.expansion.r2[0, 0])
    gamma, scale = box.sampled_gain(statement, ROOM * float(values.max()), about)
    if not np.isfinite(gamma):
        raise NotWithinTolerances(
            f"at some corner of the tolerances the inequality holds with no γ on the region of a step of "
            f"{abs(law.step):.4g}"
        )
    return replace(law, gamma=gamma, scale=scale)


def prove_box(
    robot: Robot,
    law: AnyBoxProof,
    ranges: Ranges,
    *,
    margins: tuple[float, ...] | None = None,
    seconds: float = np.inf,
    most_cells: int = 100_000_000,
    threads: int | None = None,
    progress: cells.Progress | None = None,
) -> AnyBoxProof:
    """The law of `sampled_box` with its certificate, for the smallest of some gains that can be proved.

    `ranges`: see `flexhinf.certify.box.parameter_ranges`.
    `margins`: factors of γ over that of `sampled_box`, tried in turn; by default those of its storage function.
    `seconds`: CPU time of this thread for all factors; each may take half of the remaining time, the last one all of
    it.
    `most_cells`: largest number of cells of one proof.
    `progress`: as of `certify_tolerances`.
    """
    about = about_text(robot, np.asarray(law.problem.operating_point)[:1], law.solution.degree)
    began, reason = time.thread_time(), ""
    margins = margins or (MARGINS if law.p is None else QUADRATIC_MARGINS)
    for margin in margins:
        gamma, p = margin * law.gamma, law.p if law.common is None else law.common.p(margin)
        left = seconds - (time.thread_time() - began)
        limit = cells.time_limit(left if margin == margins[-1] else left / 2.0)

        def watch(cells: int, share: float, limit: cells.Progress = limit) -> None:
            limit(cells, share)
            if progress is not None:
                progress(cells, share)

        try:
            certificate = proof.certify_tolerances(
                law.solution,
                law.problem,
                ranges,
                gamma,
                step=law.step,
                scale=law.scale,
                p=p,
                about=about,
                most_cells=most_cells if law.p is None or margin == QUADRATIC_MARGINS[-1] else 0,
                threads=threads,
                progress=watch,
            )
        except proof.NotProved as error:
            reason = f"γ = {gamma:.4g}: {reason_of(error)}"
        except cells.OutOfTime:
            reason = f"γ = {gamma:.4g}: no proof was found within {seconds:g} s of CPU time"
        else:
            return replace(
                law, gamma=gamma, p=p, certificate=certificate, cpu_seconds=time.thread_time() - began
            )
    raise NotWithinTolerances(
        reason, "preset='proved', which searches a law that can, or longer `proof_seconds`"
    )


def reason_of(error: FlexhinfError) -> str:
    """The reason of an error on one line: its `found`, or `what` where that is an expected and a received value."""
    found = "" if (error.found or "").startswith("expected ") else error.found
    return " ".join((found or error.what).split()).rstrip(".")


def about_text(robot: Robot, goal: np.ndarray, degree: int) -> str:
    """Robot, goal pose (n,) with units, and degree of V, for a certificate."""
    pose = ", ".join(
        f"{value:.6g} {'m' if slides else 'rad'}"
        for value, slides in zip(goal, robot.links.slides, strict=True)
    )
    return f"{robot.name}, goal {pose}, degree {degree} of V"


#: Factors of the preset's bandwidth, dampings (None: the preset's), and γ/γ* of the candidates.
BANDWIDTHS, DAMPINGS, RATIOS = (0.8, 1.0, 1.3), (None, 0.4), (1.3, 1.5, 2.0)

#: The longest step that is tried, rad or m, and the number of bisections for the largest one.
LONGEST, HALVINGS = np.pi, 7

#: Length of a step, as a multiple of the inverse bandwidth.
LENGTH = 12.0

#: Reasons that are shown where nothing is proved.
REASONS = 3

#: Fields that contradict the preset proved, and why.
CONTRADICTIONS = {
    "via": "one law at the goal, whose gain is proved",
    "rays": "a region that is proved, and none that is sampled",
    "checked_gamma_ratio": "the smallest gain that can be proved, which is searched for",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class ProvedLaw(BoxProof):
    """Result of a search for a law that can be proved, with the proof."""

    bandwidth: np.ndarray  # rad/s
    damping: float  # Damping ratio for which the weights were searched
    ratio: float  # γ/γ* of the law's own design
    design_problem: DesignProblem  # The problem that the law solves, at the law's γ
    peak_effort: float = np.inf  # Largest |u| of the step of the nominal robot, V or N·m
    candidates: int = 1  # Number of laws within the input limit whose inequality no sample refused
    gamma_star: float = np.nan  # γ* of `problem`: nominal robot near the goal, any law; before the proof NaN


def _check(robot: Robot, s: Specification) -> None:
    for name, why in CONTRADICTIONS.items():
        if (value := getattr(s, name)) and value != FIELDS[name].default:
            raise InvalidInput(
                f"preset='proved' and `{name}` contradict each other.",
                f"expected {why}, got {name}={value!r}",
                f"leave out `{name}`, or preset='robust'",
            )
    refuse_if(
        not s.proof_seconds,
        "preset='proved' needs time for a proof.",
        "expected seconds of CPU time that one proof may take, got proof_seconds=0",
        "proof_seconds=20",
    )
    refuse_if(
        len(robot.joint_names) != 1,
        "A step is proved for robots of one joint.",
        f"expected one joint, got {len(robot.joint_names)} in {robot.name!r}",
        "preset='robust', or no pose, for a law that is proved for a workspace",
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

    `robot`: with one joint.
    `goal`: (1,), rad or m.
    `step`: the wanted step, negative from above the goal, for which the smallest γ is proved. Default: the largest step
    from below, up to π, is searched for.
    `effort_limit`: largest |u| of the step on the nominal robot, V or N·m.
    `tolerances`: fraction of the stated tolerances for which the proof holds: 1 for all, 0 for the nominal robot.
    `degrees`, `bandwidths`, `dampings`, `ratios`: degrees of V, factors of the preset's bandwidth, dampings (None:
        the preset's), γ/γ*. A degree above 2 needs an equilibrium that stays, or `tolerances` 0.
    `most_seconds`: largest CPU time of one proof.
    `specification`: the candidates have its disturbances, checked penalty, period and so on; `bandwidths` are factors
    of its bandwidth.
    `admits`: called with each law before its proof, the best first. It returns "", or the reason to skip this law and
    all that are as fast.
    `progress`: called with what comes next.
    Raises InvalidInput: no candidate is within the limit, or none can be proved.
    """
    base = specification or Specification()
    _check(robot, base)
    pose = np.asarray(goal, dtype=float)
    start, measured = pose - (np.pi / 2 if step is None else step), measured_problem(robot, pose, base)
    ranges = box.parameter_ranges(robot, measured.plant, tolerances) if tolerances else {}
    candidates: list[ProvedLaw] = []
    reasons: list[str] = []
    presets = (("robust",) if robot.uncertain else ()) + (() if ranges else ("damped",))
    for preset, factor, damping in itertools.product(presets, bandwidths, dampings):
        progress(
            f"candidates: {preset}, {factor:g} times its bandwidth, damping {damping or 'of the preset'}"
        )
        try:
            s = replace(base, preset=preset, damping=damping, pose=tuple(pose), start=tuple(start))
            chosen = choose(robot, pose, start, s)
            assert chosen.target is not None
            bandwidth, searched_damping = factor * chosen.target.bandwidth, chosen.target.damping
            if factor != 1.0:
                chosen = choose(robot, pose, start, replace(s, bandwidth=tuple(bandwidth.tolist())))
            laws = [
                ProvedLaw(
                    solution=solve_hji(chosen.problem, ratio * chosen.gamma_star, degree),
                    problem=measured,
                    step=np.nan if step is None else step,
                    bandwidth=bandwidth,
                    damping=searched_damping,
                    ratio=ratio,
                    design_problem=replace(chosen, gamma=ratio * chosen.gamma_star),
                )
                for ratio in ratios
                for degree in degrees
            ]
        except FlexhinfError as error:  # there are no weights for this bandwidth and damping
            reasons.append(reason_of(error))
            continue
        for law in laws:
            try:
                candidates.append(_within(law, ranges, step, effort_limit))
            except FlexhinfError as error:
                reasons.append(reason_of(error))
    candidates.sort(key=lambda c: (-round(abs(c.step), 3), c.gamma) if step is None else (0.0, c.gamma))
    slow_enough = np.inf  # rad/s: laws as fast as a skipped one are skipped too
    for candidate in candidates:
        if float(np.min(candidate.bandwidth)) >= slow_enough:
            continue
        if refused := admits(candidate):
            reasons.append(refused)
            slow_enough = float(np.min(candidate.bandwidth))
            continue
        for margin in MARGINS if candidate.p is None else QUADRATIC_MARGINS:
            progress(f"prove a step of {abs(candidate.step):.4g} with gamma = {margin * candidate.gamma:.4g}")
            try:
                proved = prove_box(
                    robot, candidate, ranges, margins=(margin,), seconds=most_seconds, most_cells=most_cells
                )
            except NotWithinTolerances as error:
                reasons.append(reason_of(error))
            else:
                return replace(proved, candidates=len(candidates), gamma_star=smallest_gamma(measured))
    often = sorted(dict.fromkeys(reasons), key=lambda reason: -reasons.count(reason))[:REASONS]
    within = f"whose step stays within {effort_limit:g} and " if np.isfinite(effort_limit) else ""
    raise InvalidInput(
        "No step could be proved.",
        f"expected a law {within}whose inequality holds, got {len(candidates)} candidates and no proof: "
        + "; ".join(often),
        "a larger `peak_effort`, a smaller step, smaller tolerances, another bandwidth or damping, or longer "
        "`proof_seconds`",
    )


def _within(candidate: ProvedLaw, ranges: Any, step: float | None, limit: float) -> ProvedLaw:
    solution, measured = candidate.solution, candidate.problem
    wanted = LONGEST if step is None else step
    statement = box.tolerance_statement(solution, measured, ranges, 1.0)
    start = step_start(statement, solution, wanted)

    def peak(amplitude: float) -> float:
        duration = LENGTH / float(np.min(candidate.bandwidth))
        return _peak_effort(solution, measured, path_start(statement, start, amplitude), duration)

    largest = abs(wanted)
    if not peak(largest) <= limit:  # this refuses NaN too
        width = (1.0 if step is not None else 2.0**-HALVINGS) * largest
        largest, _ = bisected(lambda tried: peak(tried) <= limit, 0.0, largest, width, relative=False)
    if not largest:
        raise NotWithinTolerances(f"a step of {abs(wanted):.4g} takes an input of {peak(abs(wanted)):.3g}")
    step = float(np.copysign(largest, wanted))
    return sampled_box(replace(candidate, step=step, peak_effort=peak(largest)), ranges)


def _peak_effort(solution: HJISolution, measured: GeneralisedPlant, x: np.ndarray, duration: float) -> float:
    from scipy.integrate import solve_ivp

    operating_input, far = np.asarray(measured.operating_input, dtype=float), 1e3 * (1.0 + np.abs(x).max())

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        f, _, g2, _ = measured.fields(state[None])
        return f[0] + g2[0] @ solution.inputs(state[None])[0]

    def diverged(t: float, state: np.ndarray) -> float:
        return float(far - np.abs(state).max())

    diverged.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(rates, (0.0, duration), x, method="LSODA", rtol=1e-6, atol=1e-8, events=diverged)
    return float(np.abs(operating_input + solution.inputs(run.y.T)).max()) if run.status == 0 else np.inf
