"""What a design carries of proofs: its law's region for the nominal robot, and its step for all tolerances.

Both are found within a stated time of CPU, or a sentence says why not.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from flexhinf.analysis import BudgetTerm
from flexhinf.certify.certificate import Certificate
from flexhinf.certify.proof import certify
from flexhinf.certify.search import OutOfTime, time_limit
from flexhinf.certify.terms import MOST_STATES
from flexhinf.certify.tolerances import parameter_ranges
from flexhinf.design.attenuation import Attenuation
from flexhinf.design.box_proof import BoxProof, common_box, goal_text, prove_box, reason_of
from flexhinf.design.degrees import DegreeChoice
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis import Synthesis, checked_penalty
from flexhinf.design.weights.choose import measured_problem
from flexhinf.errors import FlexhinfError, InvalidInput, NumericalFailure
from flexhinf.robot import Robot

#: Shares of the sampled level that are proved, the first that is refused followed by the next; the level for the
#: wanted step alone has this room above V where it starts.
SHARES, ROOM = (0.999, 0.98, 0.9), 1.05


@dataclass(frozen=True, eq=False)
class DesignProof:
    """What is proved of the law that a design uses, nominal and with the true state fed back.

    Attributes
    ----------
    certificate : Certificate or None
        None where nothing was proved.
    reason : str
        Why nothing was proved, else empty.
    start : float
        V where the step starts, with the integrals that the controller chooses; nan without a certificate.
    budget : tuple of BudgetTerm
        Of the design's step, against the proved level; none for a box of parameters, whose V is not that of the law.
    box : BoxProof or None
        What is proved beside it for all robots within the tolerances: the step, with another V and for the z of
        `measured_problem`; None where nothing is, and for the preset proved, whose `certificate` is that.
    box_reason : str
        Why nothing is, else empty.
    """

    certificate: Certificate | None
    reason: str = ""
    start: float = float("nan")
    budget: tuple[BudgetTerm, ...] = ()
    cpu_seconds: float = 0.0
    box: BoxProof | None = None
    box_reason: str = ""

    @property
    def inside(self) -> bool:
        """Whether the step that is asked for starts inside the proved region."""
        return self.certificate is not None and self.start <= self.certificate.level

    @property
    def lasts(self) -> bool:
        """Whether the proved level covers the step with hold, delay, estimator and limits."""
        return bool(self.budget) and self.inside and self.budget[-1].budget.kept


class StepProof(NamedTuple):
    """What is proved of the step that is asked for, as the controller starts it: terminal, page, status and
    design.json take it from here.

    Attributes
    ----------
    proved : bool
        With the true state fed back, in continuous time; for which robots, `text` says.
    text : str
        A sentence.
    missing : tuple of str
        What fails of a proof or of the sampled check, for the status; empty where neither was made of it.
    """

    proved: bool
    text: str
    missing: tuple[str, ...]


def step_proof(proof: DesignProof, chosen: DegreeChoice, inside: bool | None) -> StepProof:
    """What is proved of the step that is asked for.

    Parameters
    ----------
    chosen : DegreeChoice
        Whose sampled region speaks where nothing is proved.
    inside : bool or None
        Whether the step starts inside that; None without one.
    """
    given, loop = proof.certificate, "the step with sampling, estimator and limits"
    if proof.box is not None or proof.inside:
        box = proof.box is not None or any(p.low < p.high for p in given.parameters) if given else True
        whom = "every robot within the tolerances" if box else "the nominal robot"
        text = f"The step that is asked for is proved, for {whom}"
        if given is not None and not proof.inside:
            return StepProof(
                True, f"{text}, but starts outside the region that is proved for the nominal robot's own V.",
                (f"{loop}, to which the proof for all tolerances does not extend",),
            )  # fmt: skip
        if proof.lasts:
            return StepProof(True, f"{text}.", ())
        if proof.budget:
            return StepProof(True, f"{text}.", (f"{loop}, which spends more than the proved level",))
        which = "the proof for all tolerances" if proof.box is not None else "this proof"
        return StepProof(True, f"{text}.", (f"{loop}, to which {which} does not extend",))
    if given is not None:
        text = "Nothing is proved of the step that is asked for: it starts outside the proved region"
        text += ", inside the sampled one." if inside else "."
        return StepProof(False, text, ("the step starts outside the proved region",))
    text = "Nothing is proved of the step that is asked for"
    if not chosen.looked:
        return StepProof(False, f"{text}, and no region was sampled.", ())
    if np.isnan(chosen.level):
        return StepProof(False, f"{text}, and the law has no sampled region.", ())
    if inside is False:
        text = f"{text}: it starts outside the sampled region."
        return StepProof(False, text, ("the step starts outside the sampled region",))
    text = f"{text}: it starts inside a region that is sampled."
    return StepProof(False, text, ())


def prove_design(
    robot: Robot, s: Specification, made: Synthesis, start: float, worth: Attenuation
) -> DesignProof:
    """Prove the sampled region of a design's law, or a smaller one that still holds its step.

    Parameters
    ----------
    s : Specification
        With `proof_seconds`, the CPU time that the search may take.
    start : float
        V where the step starts.
    worth : Attenuation
        Whose budget is compared with the proved level.
    """
    chosen, began = made.chosen, time.thread_time()
    attained = None if worth.attained is None else worth.attained.gain
    if made.proved is not None and made.proved.certificate is not None:
        given = replace(made.proved.certificate, attained_gain=attained)
        return DesignProof(given, start=start, cpu_seconds=made.proved.cpu_seconds)
    refused = _refused(s, made)
    if refused:
        return DesignProof(None, refused)
    levels = [share * chosen.level for share in SHARES]
    levels += [ROOM * start] if ROOM * start < levels[-1] else []
    reasons = []
    while levels:
        left = s.proof_seconds - (time.thread_time() - began)
        try:
            found = _proved_within(robot, s, made, levels.pop(0), left / 2.0 if levels else left)
        except OutOfTime:
            reasons.append(f"no proof was found within {s.proof_seconds:g} s of CPU time")
            levels = levels[-1:]  # the smallest takes the least time
        except FlexhinfError as error:
            reasons.append(" ".join((error.found or error.what).split()))
        else:
            found = replace(found, sampled_level=chosen.level, attained_gain=attained)
            budget = tuple(
                replace(term, budget=replace(term.budget, level=found.level)) for term in worth.budget
            )
            return DesignProof(found, "", start, budget, time.thread_time() - began)
    return DesignProof(None, reasons[0], cpu_seconds=time.thread_time() - began)


def with_tolerances(robot: Robot, s: Specification, made: Synthesis, proof: DesignProof) -> DesignProof:
    """The same with the step proved for all robots within the tolerances, where the time that is left is enough.

    It is tried for linear laws of robots of one joint, where a region is proved or sampled too.
    """
    if made.proved is not None or not robot.uncertain or _refused(s, made):
        return proof
    if made.solution.degree > 2:
        reason = f"a law of degree {made.solution.degree - 1} is not tried; --degrees 2, or --preset proved"
        return replace(proof, box_reason=reason)
    problem = measured_problem(robot, made.goal, s)
    ranges = parameter_ranges(robot, problem.plant)
    law = BoxProof(solution=made.solution, problem=problem, step=float((made.goal - made.start)[0]))
    try:
        law = common_box(law, ranges)
        left = max(s.proof_seconds - proof.cpu_seconds, 0.0)
        return replace(proof, box=prove_box(robot, law, ranges, seconds=left))
    except (InvalidInput, NumericalFailure) as error:
        return replace(proof, box_reason=reason_of(error))


def _refused(s: Specification, made: Synthesis) -> str:
    """Why no proof is tried; empty where one is."""
    states = len(made.solution.state_names)
    if states > MOST_STATES:
        return f"a proof is made in at most {MOST_STATES} states, and this law has {states}"
    if not s.proof_seconds:
        return "no proof was asked for (--proof-seconds 0)"
    if made.law is not made.solution:
        return "the law is a schedule of several poses"
    if not (made.chosen.looked and 0.0 < made.chosen.level < np.inf):
        return "there is no sampled region to prove"
    return ""


def _proved_within(
    robot: Robot, s: Specification, made: Synthesis, level: float, seconds: float
) -> Certificate:
    """A certificate of one level; raises `OutOfTime` after so many seconds of this thread."""
    gamma = s.checked_gamma_ratio * made.design_problem.gamma_star
    return certify(
        made.solution, gamma, checked_penalty(s, made.design_problem), level,
        about=f"{robot.name}, goal {goal_text(robot, made.goal)}, degree {made.chosen.degree} of V",
        progress=time_limit(seconds),
    )  # fmt: skip
