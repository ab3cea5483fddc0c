"""From a robot and a specification to certificates: the laws of all degrees that the design solves, each proved."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from flexhinf.certify.certificate import Certificate
from flexhinf.certify.proof import NotProved, certify, check_states
from flexhinf.certify.steps import ProvedStep, proved_steps
from flexhinf.design.degrees import DegreeChoice
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis import checked_penalty, synthesise
from flexhinf.errors import InvalidInput
from flexhinf.robot import Robot

__all__ = ["CertifiedDegree", "certify_design", "proved"]

Progress = Callable[[str], None]
Share = Callable[[int, float], None]


@dataclass(frozen=True, eq=False)
class CertifiedDegree:
    """What is proved of the law of one degree of V.

    Attributes
    ----------
    choice : DegreeChoice
    used : bool
        Whether it is the degree that the design uses.
    certificate : Certificate or None
        None where nothing was proved.
    steps : tuple of ProvedStep
        Runs from the largest proved starts.
    reason : str
        Why nothing was proved, else empty.
    cpu_seconds : float
    """

    choice: DegreeChoice
    used: bool
    certificate: Certificate | None
    steps: tuple[ProvedStep, ...]
    reason: str
    cpu_seconds: float


def certify_design(
    robot: Robot,
    s: Specification,
    progress: Progress,
    share: Share,
    *,
    decay: float = 0.0,
    threads: int = 1,
) -> tuple[CertifiedDegree, ...]:
    """The laws of a design at its goal, and what is proved of each, nominal and with the true state fed back.

    Parameters
    ----------
    robot : Robot
    s : Specification
        Its `checked_gamma_ratio` and `checked_penalty` state what is proved.
    progress : callable
        Called with the name of each step before it begins.
    share : callable
        Called with the cells done and the estimated share of a proof, many times.
    decay : float
        As `HJISolution.certify`.
    threads : int

    Raises
    ------
    InvalidInput, InfeasibleGamma, NotStabilisable, NotDetectable
        As the design does; and InvalidInput for a plant that the method cannot take, by name.
    """
    check_states(len(robot.problem().state_names))
    made = synthesise(robot, s, progress)
    gamma = s.checked_gamma_ratio * made.design_problem.gamma_star
    penalty = checked_penalty(s, made.design_problem)
    goal = ", ".join(f"{value:.6g}" for value in made.goal)
    found = []
    for choice in made.choices:
        progress(f"degree {choice.degree}: proof")
        began, certificate, steps, reason = time.process_time(), None, (), ""
        solution, about = choice.solution, f"{robot.name}, goal {goal}, degree {choice.degree} of V"
        margin = solution.checked_margin(gamma, penalty)
        if margin.definite:
            try:
                certificate = certify(
                    solution, gamma, penalty, decay=decay, about=about, threads=threads, progress=share
                )
                steps = proved_steps(solution, certificate)
            except NotProved as error:
                reason = error.found
        else:
            reason = margin.reason()
        seconds = time.process_time() - began
        found.append(CertifiedDegree(choice, choice is made.chosen, certificate, steps, reason, seconds))
    return tuple(found)


def proved(found: tuple[CertifiedDegree, ...], degree: int | None) -> CertifiedDegree:
    """The one whose certificate is wanted: that of a degree, or of the design.

    Raises
    ------
    InvalidInput
        It was not solved, or nothing was proved of it.
    """
    wanted = [one for one in found if (one.used if degree is None else one.choice.degree == degree)]
    others = [one.choice.degree for one in found if one.certificate is not None]
    if not wanted or wanted[0].certificate is None:
        reason = wanted[0].reason if wanted else "it was not solved"
        what = "the degree that the design uses" if degree is None else f"degree {degree}"
        raise InvalidInput(
            f"Nothing is proved of {what}.",
            f"expected a level that can be proved, got: {reason}",
            f"--degree {others[-1]}, of which a level is proved" if others
            else "weights on all states, and a smaller `checked_penalty`, so that r < 0 has a margin near the goal",
        )  # fmt: skip
    return wanted[0]
