"""Certificates of a design: regions of its laws, its step for all tolerances, and the proof within a design.

`certify_design` proves the laws of all degrees that a design solves, without a limit of time. `prove_design`, as part
of a design, has a limit of CPU time; if it proves nothing it returns the reason.

`attenuation` compares the level γ with the running loop. The gain of a disturbance found by search is a lower bound of
the true gain. Sampling, delay, estimator and limits use a part of the region's level (`flexhinf.analysis.dissipation`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flexhinf.analysis import Attained, BudgetTerm, budget_terms, worst_disturbance
from flexhinf.certify import Certificate, cells, claim, starts
from flexhinf.certify.box import parameter_ranges
from flexhinf.certify.proof import certify, check_decay
from flexhinf.designs import plans, proved_step
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.designs.problem.presets import measured_problem
from flexhinf.designs.specification import Specification
from flexhinf.designs.synthesis.steps import DegreeChoice, Synthesis, checked_penalty, synthesise
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure, refuse_if
from flexhinf.hinf import HJISolution
from flexhinf.plant import GeneralisedPlant
from flexhinf.processors import single_blas
from flexhinf.robot import Robot

#: With more states no disturbance is searched for: one ascent takes minutes.
MOST_SEARCHED = 15

#: Length of the disturbances, in lengths of the step response, and the longest, s.
STEPS, LONGEST_DISTURBANCE = 2.0, 20.0


@dataclass(frozen=True, eq=False)
class Attenuation:
    """The worst disturbance that was found, and the dissipation budget of the step."""

    # The worst disturbance found with the true state fed back (a lower bound of the gain), with which V stays below the
    # sampled level, or below the proved one of the preset proved; None if none was searched for, or the search failed
    attained: Attained | None
    # Budget of the step; its level is infinite without a region. It is empty where the step diverges or starts outside
    # the region, with more than `MOST_SEARCHED` states and no region (each term takes a compiled loop), and for the
    # preset proved: with uncertain parameters its law is not the gradient of the proved V
    budget: tuple[BudgetTerm, ...]
    failure: str = ""  # Why the search for a disturbance failed; empty where it did not

    @property
    def lasts(self) -> bool:
        """Whether the sum of all terms of the budget stays within the region's level in the simulated run of the
        step."""
        return not self.budget or bool(self.budget[-1].budget.kept)


def searches_disturbance(states: int, rays: int) -> bool:
    """Whether a worst disturbance is searched for: only with few states and a sampled region."""
    return states <= MOST_SEARCHED and rays > 0


def attenuation(setup: LoopSetup, synthesis: Synthesis, duration: float) -> Attenuation:
    """The worst disturbance and the budget, with the chosen solution at the goal.

    `duration`: of the step, s.
    """
    s, law, chosen, proved = setup.specification, synthesis.solution, synthesis.chosen, synthesis.proved
    level = chosen.level if chosen.looked and np.isfinite(chosen.level) and chosen.level > 0.0 else None
    problem, attained, failure = synthesis.problem, None, ""
    if proved is not None and proved.certificate is not None:
        # The penalty whose gain is proved, and its region.
        problem, level = proved.problem, proved.inner_level
    if level is not None and searches_disturbance(len(law.state_names), synthesis.rays):
        attained, failure = _attained(problem, law, s, level, STEPS * duration)
    terms: tuple[BudgetTerm, ...] = ()
    if proved is None and (level is not None or len(law.state_names) <= MOST_SEARCHED):
        x, u = setup.robot.operating_point(setup.start)
        with suppress(NumericalFailure):
            budget = budget_terms(
                law,
                setup.model,
                s.period,
                np.inf if level is None else level,
                latency=s.known_latency,
                delay=s.unknown_delay or None,
                estimator=setup.estimator(setup.start),
                saturation=setup.limits.saturated,
                start="bumpless",
                initial_state=x,
                initial_input=u,
                duration=duration,
                noise=setup.noise,
                seed=s.seed,
            )
            terms = tuple(budget)
    return Attenuation(attained, within_level(terms), failure)


def _attained(
    problem: GeneralisedPlant, law: HJISolution, s: Specification, level: float, horizon: float
) -> tuple[Attained | None, str]:
    length = min(LONGEST_DISTURBANCE, horizon)
    try:
        return worst_disturbance(problem, law, None, s.period, level=level, horizon=length, seed=s.seed), ""
    except FlexhinfError as error:
        return None, " ".join(str(error).split())


def within_level(terms: tuple[BudgetTerm, ...]) -> tuple[BudgetTerm, ...]:
    """The terms of the budget; none where the step starts above the level, so that no budget is left."""
    return () if terms and terms[-1].budget.start > terms[-1].budget.level else terms


#: CPU seconds that the proof for all tolerances of one degree may take in `certify_design`.
BOX_SECONDS = 120.0

#: Advice for a robot of several joints; {} is the call or command.
SAMPLED_ADVICE = (
    "{}, which samples a region of the linear law, looks at the corners of the tolerances and at sampled robots, and "
    "proves nothing"
)


class SeveralJoints(InvalidInput):
    """The refusal of a robot whose law has too many states for a proof."""


class NothingProved(InvalidInput):
    """No level of a law is proved; its advice begins with the options of a command that may prove one."""


@dataclass(frozen=True, eq=False)
class CertifiedDegree:
    """The proof of the law of one degree of V; `used` says whether the design uses this law."""

    choice: DegreeChoice
    used: bool
    certificate: Certificate | None  # None where nothing was proved; then `reason` says why
    steps: tuple[starts.ProvedStep, ...]  # Runs from the largest proved starts
    reason: str
    cpu_seconds: float
    # The proof for all robots within the tolerances; None for one of the nominal robot
    box: proved_step.BoxProof | None = None


@single_blas()
def certify_design(
    robot: Robot,
    s: Specification,
    progress: Callable[[str], None],
    share: Callable[[int, float], None],
    *,
    decay: float = 0.0,
    observer: float | None = None,
    tolerances: bool = False,
    threads: int | None = None,
) -> tuple[CertifiedDegree, ...]:
    """The laws of a design at its goal, and the proof of each, with the true state fed back.

    `s`: its `checked_gamma_ratio` and `checked_penalty` state the claim.
    `progress`, `share`: called with the name of each step before it begins; with the cells done and the estimated
        share of a proof.
    `decay`, `observer`: as `HJISolution.certify`.
    `tolerances`: whether to prove the design's step for all robots within the tolerances, instead of a region of the
    nominal robot. The preset proved always does.
    """
    if len(robot.joint_names) > 1:
        raise SeveralJoints(
            "A proof in so many states would not end.",
            f"expected a robot of one joint, with at most {claim.MOST_STATES} states, got {len(robot.joint_names)} "
            "joints: cells grow 10 to 23 times with each state",
            SAMPLED_ADVICE.format("a design with degrees = (2,), damping = 0.3 and rays = 50"),
        )
    plans.refuse_workspace(s, robot, "A proof")
    check_decay(decay)
    refuse_if(
        tolerances and not robot.uncertain,
        f"The robot {robot.name!r} states no tolerances.",
        "expected parameters with a tolerance, got none",
        "tolerance = 10 beside a value in the robot's file, or leave out `tolerances`",
    )
    proofs, synthesis = (
        list[CertifiedDegree](),
        synthesise(robot, replace(s, rays=0), progress),
    )  # no region is sampled
    gamma = s.checked_gamma_ratio * synthesis.design_problem.gamma_star
    penalty = checked_penalty(s.checked_penalty, synthesis.problem.plant)
    boxed = _step_law(robot, s, synthesis) if tolerances or synthesis.proved else None
    for choice in synthesis.choices:
        progress(f"degree {choice.degree}: proof{' for all tolerances' if boxed else ''}")
        began, box, certificate, steps, reason = time.process_time(), synthesis.proved, None, (), ""
        try:
            if boxed is not None:
                if box is None:
                    law, ranges = boxed
                    own = proved_step.sampled_box(replace(law, solution=choice.solution), ranges)
                    box = proved_step.prove_box(
                        robot, own, ranges, seconds=BOX_SECONDS, threads=threads, progress=share
                    )
                certificate = box.certificate
            elif (margin := choice.solution.checked_margin(gamma, penalty)).definite:
                certificate = certify(
                    choice.solution,
                    gamma,
                    penalty,
                    decay=decay,
                    observer=observer,
                    threads=threads,
                    progress=share,
                    about=proved_step.about_text(robot, synthesis.goal, choice.degree),
                )
            else:
                reason = margin.reason()
            steps = () if certificate is None else starts.proved_steps(choice.solution, certificate)
        except (InvalidInput, NumericalFailure) as error:  # this degree is not proved; another may be
            if (certificate is not None) if boxed else isinstance(error, InvalidInput):
                raise  # the length of a proved step, which settles
            reason = proved_step.reason_of(error) if boxed else error.found
        seconds, used = time.process_time() - began, choice is synthesis.chosen
        proofs.append(CertifiedDegree(choice, used, certificate, steps, reason, seconds, box))
    return tuple(proofs)


def _step_law(
    robot: Robot, s: Specification, synthesis: Synthesis
) -> tuple[proved_step.BoxProof, proved_step.Ranges]:
    """The chosen law with the design's step and the z and d of `measured_problem`; and the ranges of the tolerances."""
    problem, step = measured_problem(robot, synthesis.goal, s), float((synthesis.goal - synthesis.start)[0])
    return (
        proved_step.BoxProof(solution=synthesis.solution, problem=problem, step=step),
        parameter_ranges(robot, problem.plant),
    )


def proved(
    proofs: tuple[CertifiedDegree, ...], degree: int | None, tolerances: bool = False
) -> CertifiedDegree:
    """The proof of a degree, or of the one that the design uses; InvalidInput where there is none."""
    wanted = [proof for proof in proofs if (proof.used if degree is None else proof.choice.degree == degree)]
    if wanted and wanted[0].certificate is not None:
        return wanted[0]
    others = [f"--degree {proof.choice.degree}" for proof in proofs if proof.certificate is not None]
    if not wanted:
        solved = [proof.choice.degree for proof in proofs]
        raise InvalidInput(
            f"The design does not solve degree {degree}.",
            f"expected one of the degrees {solved}, got {degree}",
            f"`degrees` with {degree} among them, or --degree {solved[0]}",
        )
    reason = wanted[0].reason
    what = "the degree that the design uses" if degree is None else f"degree {degree}"
    if tolerances:
        raise proved_step.NotWithinTolerances(
            f"expected a gain that can be proved of {what}, got: {reason}",
            f"{others[-1]}, which is proved" if others else "--preset proved, or --degrees 2",
        )
    raise NothingProved(
        f"Nothing is proved of {what}.",
        f"expected a level that can be proved, got: {reason}",
        f"{others[-1]}, of which a level is proved"
        if others
        else "--preset damped --degrees 2, or weights on all states and a smaller `checked_penalty`",
    )


@dataclass(frozen=True, eq=False)
class Evidence:
    """The data of a certificate's figures, and a lower bound of the gain that the certificate bounds."""

    certificate: Certificate  # With the attained gain, where a disturbance was found
    # surface, limit: V and r over the starts of steps, and over a plane through the point that limits the sampled level
    surface: starts.StartSurface | None
    limit: starts.LimitSlice | None
    # A smaller step with the worst disturbance, for each rule of the integrators' start
    worst: tuple[starts.WorstStep, ...]
    # The worst disturbance found by search, from rest at the goal, with which V stays below the proved level
    attained: Attained | None


def evidence(robot: Robot, s: Specification, certified: CertifiedDegree) -> Evidence:
    """Data of the figures, and the lower bound of the gain, for one certificate."""
    solution, certificate, box = certified.choice.solution, certified.certificate, certified.box
    problem = solution.problem if box is None else box.problem
    assert certificate is not None
    assert isinstance(problem, GeneralisedPlant)
    level = certificate.level if box is None else box.inner_level
    attained, _ = _attained(problem, solution, s, level, starts.longest_run(solution))
    if attained is not None:
        certificate = replace(certificate, attained_gain=attained.gain)
    if box is not None:  # the V of a box is not that of the law, and it covers many robots
        return Evidence(certificate, None, None, (), attained)
    weights = None if callable(s.checked_penalty) else checked_penalty(s.checked_penalty, robot.plant())
    return Evidence(
        certificate,
        starts.start_surface(solution, certificate, weights),
        starts.limit_slice(solution, certificate, weights),
        tuple(starts.worst_step(solution, certificate, start) for start in certificate.starts),
        attained,
    )


#: Fractions of the sampled level that are tried in turn until one is proved; and the factor of the level that is tried
#: last over V at the start of the step.
PROOF_SHARES, PROOF_ROOM = (0.999, 0.98, 0.9), 1.05


@dataclass(frozen=True, eq=False)
class DesignProof:
    """The proof of the law that a design uses, nominal and with the true state fed back."""

    certificate: Certificate | None  # None where nothing was proved; then `reason` says why
    reason: str = ""
    # V where the step starts, with the integrals that the controller chooses; nan without a certificate
    start: float = float("nan")
    # Of the design's step, against the proved level; none for a box of parameters, whose V is not that of the law
    budget: tuple[BudgetTerm, ...] = ()
    cpu_seconds: float = 0.0
    # The step for all robots within the tolerances, with another V and for the z of `measured_problem`; None where
    # that is not proved (`box_reason` says why), and for the preset proved, whose `certificate` is that
    box: proved_step.BoxProof | None = None
    box_reason: str = ""

    @property
    def inside(self) -> bool:
        """Whether the requested step starts inside the proved region."""
        return self.certificate is not None and self.start <= self.certificate.level

    @property
    def lasts(self) -> bool:
        """Whether hold, delay, estimator and limits spent less than the proved level leaves, in the one run of the step
        that was simulated."""
        return bool(self.budget) and self.inside and self.budget[-1].budget.kept


class StepProof(NamedTuple):
    """Whether the requested step is proved for the controller's start; read by terminal, page, status and
    design.json."""

    proved: bool  # Proved with the true state fed back, in continuous time, for the robots that `text` names
    text: str
    # Failures of the proof or of the sampled check, for the status; empty if neither was made
    missing: tuple[str, ...]


def step_proof(proof: DesignProof, chosen: DegreeChoice, inside: bool | None) -> StepProof:
    """The proof of the requested step as text. `inside`: whether the step starts in the sampled region, None without
    one."""
    certificate, loop = proof.certificate, "the step with sampling, estimator and limits"
    if proof.box is not None or proof.inside:
        box = (
            proof.box is not None
            or certificate is None
            or any(p.low < p.high for p in certificate.parameters)
        )
        text = f"is proved, for {'every robot within the tolerances' if box else 'the nominal robot'}"
        which = "the proof for all tolerances" if proof.box is not None else "this proof"
        missing = (f"{loop}, to which {which} does not extend",)
        if certificate is not None and not proof.inside:
            text += ", but starts outside the region that is proved for the nominal robot's own V"
        elif proof.budget:
            spent = (
                "is within the proved level in one simulated run"
                if proof.lasts
                else "spends more than that level"
            )
            missing = (f"{loop}, which {spent}",)
        return StepProof(True, f"The step that is asked for {text}.", missing)
    missing = ()
    if certificate is not None:
        text = f": it starts outside the proved region{', inside the sampled one' if inside else ''}"
        missing = ("the step starts outside the proved region",)
    elif not chosen.looked:
        text = ", and no region was sampled"
    elif np.isnan(chosen.level):
        text = f", and the sampled check gives no region ({chosen.limit.removeprefix('no region: ').rstrip('.')})"
    elif inside is False:
        text = ": it starts outside the sampled region"
        missing = ("the step starts outside the sampled region",)
    else:
        text = ": it starts inside a region that is sampled"
    return StepProof(False, f"Nothing is proved of the step that is asked for{text}.", missing)


def prove_design(
    robot: Robot, s: Specification, synthesis: Synthesis, start: float, worth: Attenuation
) -> DesignProof:
    """Prove the sampled region of a design's law, or a smaller region that contains its step, in `proof_seconds` of CPU
    time.

    `start`: V at the start of the step. `worth`: the attenuation whose budget is compared with the proved level.
    """
    chosen, proved, began = synthesis.chosen, synthesis.proved, time.thread_time()
    attained = None if worth.attained is None else worth.attained.gain
    if proved is not None and proved.certificate is not None:
        certificate = replace(proved.certificate, attained_gain=attained)
        return DesignProof(certificate, start=start, cpu_seconds=proved.cpu_seconds)
    if refused := _refused(s.proof_seconds, synthesis):
        return DesignProof(None, refused)
    levels, reasons = [share * chosen.level for share in PROOF_SHARES], list[str]()
    levels += [PROOF_ROOM * start] if PROOF_ROOM * start < levels[-1] else []
    while levels:
        left, level = s.proof_seconds - (time.thread_time() - began), levels.pop(0)
        try:
            certificate = certify(
                synthesis.solution,
                s.checked_gamma_ratio * synthesis.design_problem.gamma_star,
                checked_penalty(s.checked_penalty, synthesis.problem.plant),
                level,
                about=proved_step.about_text(robot, synthesis.goal, chosen.degree),
                progress=cells.time_limit(left / 2.0 if levels else left),
            )
        except cells.OutOfTime:
            reasons.append(f"no proof was found within {s.proof_seconds:g} s of CPU time")
            levels = levels[-1:]  # the smallest region takes the least time
        except FlexhinfError as error:
            reasons.append(" ".join((error.found or error.what).split()))
        else:
            certificate = replace(certificate, sampled_level=chosen.level, attained_gain=attained)
            budget = (replace(t, budget=replace(t.budget, level=certificate.level)) for t in worth.budget)
            return DesignProof(
                certificate, "", start, within_level(tuple(budget)), time.thread_time() - began
            )
    return DesignProof(None, reasons[0], cpu_seconds=time.thread_time() - began)


def with_tolerances(robot: Robot, s: Specification, synthesis: Synthesis, proof: DesignProof) -> DesignProof:
    """`proof`, with the step also proved for all robots within the tolerances if the remaining time is enough.

    This is tried for linear laws of robots of one joint that have a proved or sampled region.
    """
    degree = synthesis.solution.degree
    if synthesis.proved is not None or not robot.uncertain or _refused(s.proof_seconds, synthesis):
        return proof
    if degree > 2:
        return replace(
            proof, box_reason=f"a law of degree {degree - 1} is not tried; --degrees 2, or --preset proved"
        )
    (law, ranges), left = _step_law(robot, s, synthesis), max(s.proof_seconds - proof.cpu_seconds, 0.0)
    try:
        return replace(
            proof, box=proved_step.prove_box(robot, proved_step.common_box(law, ranges), ranges, seconds=left)
        )
    except (InvalidInput, NumericalFailure) as error:
        return replace(proof, box_reason=proved_step.reason_of(error))


def _refused(seconds: float, synthesis: Synthesis) -> str:
    states, chosen = len(synthesis.solution.state_names), synthesis.chosen
    if states > claim.MOST_STATES:
        return f"a proof is made in at most {claim.MOST_STATES} states, and this law has {states}"
    if not seconds:
        return "no proof was asked for (--set proof_seconds=0)"
    if synthesis.law is not synthesis.solution:
        return "the law is a schedule of several poses"
    return "" if (chosen.looked and 0.0 < chosen.level < np.inf) else "there is no sampled region to prove"
