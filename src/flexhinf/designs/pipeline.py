"""Pipeline from a robot and a specification to a judged design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flexhinf.designs import certification, responses
from flexhinf.designs.about_pose import loop_at_pose
from flexhinf.designs.compare import Progress, rivals, silent
from flexhinf.designs.evidence import DesignedLoop, evidence_of
from flexhinf.designs.fields import law_of
from flexhinf.designs.problem import presets
from flexhinf.designs.request import checked_specification
from flexhinf.designs.result import Design, judged_by
from flexhinf.designs.specification import Specification
from flexhinf.designs.synthesis import by_step
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.design import TOLERATED, Meanwhile, workspace_stages
from flexhinf.designs.workspace.evidence import LoopOverWorkspace
from flexhinf.designs.workspace.preset import selected_law
from flexhinf.processors import single_blas
from flexhinf.robot import Robot


def design(
    robot: Robot, specification: Specification | None = None, progress: Progress | None = None
) -> Design:
    """Design a controller for a robot, and judge the loop in which it runs; nothing is written.

    The controller is for a workspace, by default all poses within the joint ranges: one law for all of them, judged at
    random poses and in moves between random goals. With a ``pose`` it is for that pose, judged in the motion to it. The
    law is `Specification.law`: by default modal for a workspace, nl-hinf at one pose. A field that the law, its
    estimator and the task do not read is refused by its name.

    Parameters
    ----------
    robot : Robot
        From `load_robot`.
    specification : Specification, optional
        What the loop must do; a field that is not stated is chosen by the rule that its help states.
    progress : callable, optional
        Called with what comes next, about `stages` times in all.

    Returns
    -------
    Design
        Law, estimator, runs and requirements: ``met`` says whether the requirements are met, ``save(folder)`` writes
        the report, ``controller(at)`` is what runs, and ``evidence`` holds every number of the report.

    Raises
    ------
    SpecificationError
        For a law that does not serve the task, and for a field that this design does not read.
    InvalidInput, InfeasibleGamma, NotStabilisable, NotDetectable, NumericalFailure
        With what to change.

    Examples
    --------
    >>> import flexhinf as fh
    >>> quick = dict(degrees="2", draws=0, rays=0, proof_seconds=0)
    >>> arm = fh.design(fh.load_robot("paper"), fh.Specification(pose="10deg", start="0", estimator="none", **quick))
    >>> arm.evidence.gamma > arm.evidence.gamma_star
    True
    >>> arm.controller().period
    0.001
    """
    return design_with(robot, specification, progress)


@single_blas()
def design_with(
    robot: Robot,
    specification: Specification | None,
    progress: Progress | None,
    meanwhile: Meanwhile = lambda: lambda evidence: None,
) -> Design:
    """As `design`; of a law with gains at any pose `meanwhile` begins what is done while is computed what it
    tolerates."""
    s, progress = checked_specification(robot, specification), progress or silent
    return judged_by(evidence_of(robot, s, progress, meanwhile))


def loop_of(robot: Robot, s: Specification, progress: Progress = silent) -> DesignedLoop:
    """The loop of a design that is not judged."""
    if law_of(s).any_pose:
        return LoopOverWorkspace(selected_law(robot, s, Task.of(robot, s), progress).setup)
    return loop_at_pose(robot, s, progress)


def stages(
    robot: Robot, specification: Specification, laws: Sequence[str] | None = None
) -> list[tuple[str, float]]:
    """The work steps of a design, or of a comparison of `laws` (empty: the usual ones), about as they come: how their
    names begin or end, and what part of the work each is, relative to the others."""
    s = specification
    if laws is None:
        return [*_stages(robot, s), *[(TOLERATED, 2.5)] * law_of(s).any_pose]
    own = [_stages(robot, s)]
    for kind in rivals(s, laws, drive=robot.drive):
        rival = replace(s, law=kind.name)
        own.append([(f"{kind.name}: {what}", part) for what, part in _stages(robot, rival)])
    return [stage for each in own for stage in each]


def _stages(robot: Robot, s: Specification) -> list[tuple[str, float]]:
    """Of a design of one law."""
    if law_of(s).any_pose:
        return workspace_stages(robot, s)
    states = by_step.STATES * len(robot.joint_names)
    preset, limits = presets.preset_of(robot, s), responses.joint_limits(robot, s)
    limited = preset in ("damped", "robust") and (limits.limits_peak or limits.limits_speed)
    solved = len(by_step.tried_degrees(states, s.degrees))
    rays = by_step.rays_of(states, s.rays)
    found = [("equilibrium, and weights", 3.0)]
    if preset == "robust":
        found += [("channels of the tolerances", 10.0), ("loops tried", 0.5), ("noise levels", 0.5)]
    if limited:
        found.append(("the peak input of the step", 1.0))
    found.append(("tried", 0.5))
    if preset == "proved":  # about six candidates and a proof instead of degrees and their regions
        found += [("prove", 2.0)] * 7
    else:
        regions = (rays > 0) * (1 if s.degrees is None else solved)
        found += [("solve", 0.5)] * solved + [("the step with each", 2.0)] * (solved > 1)
        found += [("sample the region", 1.0)] * regions
    found += [("the law at", 0.5)] * len(s.via)
    found += [("margins of the running loop", 1.0), ("compile the closed loop", 2.0), ("corners", 3.0)]
    found.append(("the worst disturbance", 1.0 if certification.searches_disturbance(states, rays) else 0.2))
    found += [("the step on MuJoCo's plant", 1.0)] * s.mujoco
    return [*found, ("load, move and sampled robots", 1.0), ("payloads", 0.3), ("proof of the region", 1.0)]
