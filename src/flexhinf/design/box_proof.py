"""The proof of one law for every robot within its tolerances, on a region that holds a step.

The gain is from the disturbances to the z of `measured_problem`, which is the same for all laws of a robot. For a
linear law the storage function is a common quadratic V, see `flexhinf.certify.box_gain`; for others it is a
multiple of the law's own. Its level holds the step of every robot without a jump of its input.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from flexhinf.certify import Certificate
from flexhinf.certify.box import tolerance_statement
from flexhinf.certify.box_gain import CommonValue, common_value, sampled_gain
from flexhinf.certify.cells import OutOfTime, Progress, time_limit
from flexhinf.certify.claim import Start
from flexhinf.certify.proof import NotProved, certify_tolerances
from flexhinf.certify.starts import largest_values, robot_start, tabled_start
from flexhinf.errors import FlexhinfError, InvalidInput
from flexhinf.hinf import HJISolution
from flexhinf.plant import GeneralisedPlant
from flexhinf.robot import Robot

Ranges = Mapping[str, tuple[float, float]]

#: A level is taken so much above the largest V of the starts; γ so much above what sampling finds, in turn.
ROOM, MARGINS = 1.003, (1.05, 1.15, 1.4)

#: γ over the smallest one of a common quadratic V, in turn: room for enclosures, where definite matrices prove it.
#: Cells are looked at with the last one alone: they become fewer with the margin.
QUADRATIC_MARGINS = (1.02, 1.05, 1.1, 1.6)


class NotWithinTolerances(InvalidInput):
    """A law that cannot be proved for all robots within the tolerances."""

    def __init__(self, found: str, advice: str = "preset='proved', which searches a law that can") -> None:
        super().__init__("The law is not proved for all robots within the tolerances.", found, advice)


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxProof:
    """A law with the step that is proved for all robots within the tolerances.

    Attributes
    ----------
    problem : GeneralisedPlant
        Whose disturbance and penalty the gain is of.
    step : float
        Rest to rest, to the goal; rad or m, negative from above it.
    gamma : float
        Proved; before the proof, what sampling found.
    scale : float
        The storage function is scale · V,
    p : ndarray, shape (n, n), or None
        or ½ xᵀPx with this P, of a linear law.
    common : CommonValue or None
        Where P is from.
    certificate : Certificate or None
        None before the proof.
    cpu_seconds : float
        That the proof took.
    """

    solution: HJISolution
    problem: GeneralisedPlant
    step: float
    gamma: float = np.inf
    scale: float = 1.0
    p: np.ndarray | None = None
    common: CommonValue | None = None
    certificate: Certificate | None = None
    cpu_seconds: float = 0.0

    def value(self, x: np.ndarray) -> Any:
        """The storage function at deviations (n,) or (N, n) from the goal."""
        return (
            self.scale * self.solution.value(x) if self.p is None else 0.5 * np.sum((x @ self.p) * x, axis=-1)
        )

    @property
    def inner_level(self) -> float:
        """Of the law's own V: the largest whose level set lies in the proved region."""
        assert self.certificate is not None
        if self.p is None:
            return self.certificate.level / self.scale
        return self.certificate.level / float(
            np.linalg.eigvals(np.linalg.solve(self.solution.P, self.p)).real.max()
        )


Law = TypeVar("Law", bound=BoxProof)


def step_start(statement: Certificate, solution: HJISolution, step: float) -> Start:
    """The path of starts of a step without a jump of the input, each robot its own where that has a form.

    Raises
    ------
    NotWithinTolerances
        There is no such path.
    """
    side = 1.0 if step < 0.0 else -1.0
    start = robot_start(statement, side) or tabled_start(solution, statement, abs(step), side)
    if start is None:
        raise NotWithinTolerances("no start without a jump of the input was found for this plant")
    return start


def common_box(law: Law, ranges: Ranges) -> Law:
    """The same with the smallest γ that a common quadratic V of a linear law has, and such a V.

    Raises
    ------
    NotWithinTolerances
        No quadratic V decreases at all corners of the tolerances, whatever the slopes of the plant's functions.
    InvalidInput
        The method does not apply to the plant.
    """
    found = common_value(tolerance_statement(law.solution, law.problem, ranges, 1.0))
    if found is None:
        raise NotWithinTolerances("no quadratic V decreases at all corners of the tolerances")
    return replace(law, gamma=found.smallest, p=found.p(max(QUADRATIC_MARGINS)), common=found)


def sampled_box(law: Law, ranges: Ranges) -> Law:
    """The same with a γ that is worth a proof, and its storage function.

    For a linear law that is the quadratic V of the smallest gain for all slopes of the plant's functions; otherwise,
    and where there is none, a multiple of the law's own V, with the smallest γ that no sample of the region refuses.

    Raises
    ------
    NotWithinTolerances
        No γ is left, so that there is nothing to prove.
    InvalidInput
        The plant, or the law at this goal, is none that the method can take.
    """
    if law.solution.degree == 2:
        try:
            return common_box(law, ranges)
        except NotWithinTolerances:
            pass  # on a region, where the slopes are smaller, there may be one
    statement = tolerance_statement(law.solution, law.problem, ranges, 1.0)
    start = step_start(statement, law.solution, law.step)
    values = largest_values(statement, start, np.linspace(0.0, abs(law.step), 200))
    about = float(law.problem.r2[0, 0] / law.solution.expansion.r2[0, 0])
    gamma, scale = sampled_gain(statement, ROOM * float(values.max()), about)
    if not np.isfinite(gamma):
        raise NotWithinTolerances(
            f"at some corner of the tolerances the inequality holds with no γ on the region of a step of "
            f"{abs(law.step):.4g}"
        )
    return replace(law, gamma=gamma, scale=scale)


def prove_box(
    robot: Robot,
    law: Law,
    ranges: Ranges,
    *,
    margins: tuple[float, ...] | None = None,
    seconds: float = np.inf,
    most_cells: int = 100_000_000,
    threads: int = 1,
    progress: Progress | None = None,
) -> Law:
    """The law of `sampled_box` with its certificate, for the smallest of some gains that can be proved.

    Parameters
    ----------
    ranges : mapping
        See `flexhinf.certify.proof.parameter_ranges`.
    margins : tuple of float, optional
        γ over that of `sampled_box`, in turn; by default those of its storage function.
    seconds : float
        CPU time of this thread for all of them; each may take half of what is left, the last one all.
    most_cells : int
        Of one proof.
    progress : callable, optional
        As of `certify_tolerances`.

    Raises
    ------
    NotWithinTolerances
        None is proved.
    """
    goal = np.asarray(law.problem.operating_point)[:1]
    about = f"{robot.name}, goal {goal_text(robot, goal)}, degree {law.solution.degree} of V"
    began, reason = time.thread_time(), ""
    margins = margins or margins_of(law)
    for margin in margins:
        gamma, p = margin * law.gamma, law.p if law.common is None else law.common.p(margin)
        left = seconds - (time.thread_time() - began)
        limit = time_limit(left if margin == margins[-1] else left / 2.0)

        def watch(cells: int, share: float, limit: Progress = limit) -> None:
            limit(cells, share)
            if progress is not None:
                progress(cells, share)

        try:
            certificate = certify_tolerances(
                law.solution, law.problem, ranges, gamma, step=law.step, scale=law.scale, p=p, about=about,
                most_cells=most_cells if law.p is None or margin == QUADRATIC_MARGINS[-1] else 0, threads=threads,
                progress=watch,
            )  # fmt: skip
        except NotProved as error:
            reason = f"γ = {gamma:.4g}: {reason_of(error)}"
        except OutOfTime:
            reason = f"γ = {gamma:.4g}: no proof was found within {seconds:g} s of CPU time"
        else:
            spent = time.thread_time() - began
            return replace(law, gamma=gamma, p=p, certificate=certificate, cpu_seconds=spent)
    raise NotWithinTolerances(
        reason, "preset='proved', which searches a law that can, or longer `proof_seconds`"
    )


def margins_of(law: BoxProof) -> tuple[float, ...]:
    """γ over that of `sampled_box` that are tried, in turn."""
    return MARGINS if law.p is None else QUADRATIC_MARGINS


def reason_of(error: FlexhinfError) -> str:
    """The reason of an error on one line: its `found`, or `what` where that is an expected and a received value."""
    found = "" if (error.found or "").startswith("expected ") else error.found
    return " ".join((found or error.what).split()).rstrip(".")


def goal_text(robot: Robot, goal: np.ndarray) -> str:
    """A goal pose (n,) with units."""
    pairs = zip(goal, robot.links.slides, strict=True)
    return ", ".join(f"{value:.6g} {'m' if slides else 'rad'}" for value, slides in pairs)
