"""Setup of a law about one pose: its loop, and the runs of its task."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop, Margins, modes
from flexhinf.arrays import Matrix
from flexhinf.baselines.posed_laws import GainsOnTheWay, PosedLaw
from flexhinf.copies import shared_out
from flexhinf.designs import plans, responses
from flexhinf.designs.checks import LimitCycleCheck
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.judge_loops import corner_requirement
from flexhinf.designs.loop_setup import LoopSetup, with_derived
from flexhinf.designs.motions import Jump
from flexhinf.designs.noise_levels import EstimatorNoise
from flexhinf.designs.problem.presets import required_damping
from flexhinf.designs.problem.weights import TargetBehaviour
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.resting import CornerLoop
from flexhinf.designs.specification import Specification
from flexhinf.designs.synthesis import steps
from flexhinf.designs.task import Task
from flexhinf.designs.workspace.setup import MoveArguments, WorkspaceSetup
from flexhinf.loop import Controller, Supervision
from flexhinf.robot import Robot


@dataclass(frozen=True, eq=False, kw_only=True)
class AboutPose(WorkspaceSetup):
    """A law about the one pose of a task, in the one motion to it.

    `evaluation` has the loop that it runs in; `law` are its gains at the pose.
    """

    evaluation: LawEvaluation
    damping: float | None = None  # ratio that is required of the nominal robot; None: the least
    limit_cycle: LimitCycleCheck | None = None  # the long run at rest; None without dry friction and backlash

    @staticmethod
    def of(
        robot: Robot,
        s: Specification,
        evaluation: LawEvaluation,
        synthesis: steps.Synthesis,
        limit_cycle: LimitCycleCheck | None = None,
    ) -> AboutPose:
        """The setup of a law in its loop, with the task of the specification."""
        task, target = Task.of(robot, s), synthesis.design_problem.target
        law = gains_about(evaluation.setup, synthesis.solution.gain)
        damping = None if target is None else required_damping(s.damping, target)
        return AboutPose(
            robot,
            s,
            task.space,
            law,
            motion=task.motion,
            evaluation=evaluation,
            damping=damping,
            limit_cycle=limit_cycle,
        )

    @property
    def about(self) -> LoopSetup:
        """The loop of all runs."""
        return self.evaluation.setup

    @cached_property
    def noise_levels(self) -> EstimatorNoise:
        """R^v of the estimator."""
        return self.about.process_noise

    @property
    def supervision(self) -> Supervision:
        """What a deployed controller watches."""
        return self.about.supervision

    @cached_property
    def has_controller(self) -> bool:
        """Always: there is one pose."""
        return True

    @property
    def dead_zone(self) -> np.ndarray | None:
        """Errors (n,) that are not integrated, rad or m."""
        return self.about.dead_zone

    def controller(self, at: np.ndarray, law: PosedLaw | None = None, **options: Any) -> Controller:
        """As of `LoopSetup.controller`: in error coordinates where the task is followed so."""
        return self.about.controller(at, moving=self.about.moves, **options)

    def estimator(self, at: np.ndarray) -> Any:
        """The estimator, started at rest at a pose (n,)."""
        return self.about.estimator(at)

    def linear(
        self, at: np.ndarray, values: Mapping[str, Any] | None = None, damped: bool = True
    ) -> LinearLoop:
        """The sampled loop linearised at rest at the pose, whatever `at` is; as of `RestingLoops.linear`."""
        if values is None and damped:
            return self.margins.linear
        return self.about.equilibrium_loop(values=values, damped=damped).linear()

    def encoder_offsets(self, at: np.ndarray, time: float | None = None) -> np.ndarray:
        """As of `RestingLoops.encoder_offsets`; the controller takes them in at once, whatever `time` is."""
        return super().encoder_offsets(at, None)

    # Runs ---------------------------------------------------------------------------------------------
    @cached_property
    def step_length(self) -> float:
        """Length of the run of a step, s, which is prolonged where the links do not rest by then."""
        return self.evaluation.runs.step_duration

    def move(
        self,
        ends: np.ndarray,
        values: Mapping[str, Any] | None = None,
        seed: int = 0,
        dwell: float | None = None,
    ) -> responses.Move:
        """The motion of the task, whatever its `ends` are, and a dwell, s; the true robot has the parameters `values`,
        and noise by a `seed`, that of the nominal robot apart."""
        about, e, number = self.about, self.evaluation, 0 if values is None else 1 + seed
        known: dict[str, Any] = {"values": values, "seed": number, "sub_steps": e.runs.sub_steps}
        if about.stated_move is not None:
            if values is None and dwell is None:
                return e.move
            return about.move(e.runs.plan, e.runs.dwell if dwell is None else dwell, **known)

        def run(length: float) -> responses.Response:
            return about.step(length, **known)

        first = e.step if values is None and dwell is None else run(max(self.step_length, dwell or 0.0))
        response = responses.settled_run(first, run, about.command_time)
        return responses.Move.along(about.command or Jump(about.goal), response, self.limits)

    def moves(
        self, runs: Sequence[MoveArguments], begun: Callable[[], None] = lambda: None
    ) -> tuple[responses.Move, ...]:
        """A `move` with its metrics for each of these arguments, on all processors; `begun` as of `shared_out`."""

        def judged(run: MoveArguments) -> responses.Move:
            move = self.move(*run)
            _ = move.motion, move.metrics
            return move

        return tuple(shared_out(judged, runs, begun))

    # Judged -------------------------------------------------------------------------------------------
    @property
    def required_damping(self) -> float | None:
        """As the weights were searched for; None for the least."""
        return self.damping

    @cached_property
    def margins(self) -> Margins:
        """Margins of the running loop at the pose."""
        return self.evaluation.margins

    @property
    def ringing(self) -> tuple[modes.Mode | None, modes.Mode | None]:
        """The oscillations that are damped least."""
        return self.evaluation.least_damped

    @property
    def unlimited(self) -> responses.Response | None:
        """The nominal step without limits of the inputs, which would hide what the law demands."""
        limited = self.limits.limits_peak and self.about.stated_move is None
        return self.evaluation.unlimited_step if limited else None

    def corner_requirements(self, loops: Sequence[CornerLoop]) -> list[Requirement]:
        """Requirements on robots at corners of their tolerances, of which all are counted where they are not too
        many."""
        known = self.evaluation.corners
        return [] if known is None else [corner_requirement(known), *super().corner_requirements(loops)[1:]]

    def standstill(self, runs: Sequence[MoveArguments], moves: Sequence[responses.Move]) -> list[Requirement]:
        """The requirement that the integrals make no limit cycle in a long run at rest."""
        units = self.limits.position_units
        return [] if self.limit_cycle is None else [self.limit_cycle.requirement(units)]


def gains_about(about: LoopSetup, gain: Matrix) -> PosedLaw:
    """The gains (n, states) of a law at its goal, integrals last, as those of a law with the same ones at any pose."""
    law, plant, n = about.linear_law, about.model, len(about.goal)
    own = [plant.states.index(name) for name in law.plant_states]
    integrated = [plant.n + plant.states.index(name) for name in law.tracked]
    whole = np.zeros((n, plant.n + plant.n))
    whole[:, [*own, *integrated]] = gain
    known = whole[:, : plant.n + n]
    return GainsOnTheWay(
        plant=plant,
        equilibrium=about.robot.operating_point(about.goal),
        integrate=("link_position",),
        gain=lambda pose: known,
    )


def law_modes(evaluation: LawEvaluation, synthesis: steps.Synthesis) -> tuple[modes.Mode, ...]:
    """Modes of the law alone: continuous, with the true state fed back."""
    loop = modes.closed_loop(synthesis.problem, synthesis.solution.gain)
    return modes.modes_of(loop, evaluation.setup.joints, *evaluation.energy)


def step_duration(linear: LawEvaluation, synthesis: steps.Synthesis) -> float:
    """Duration of the step, s: as stated, or by the slowest mode of the law, after the command."""
    stated = linear.setup.specification.duration
    if stated is not None:
        return stated
    slowest = min(-mode.eigenvalue.real for mode in law_modes(linear, synthesis))
    return responses.run_length(slowest) + linear.setup.command_time


def in_scenario(linear: LawEvaluation, duration: float, target: TargetBehaviour | None) -> LawEvaluation:
    """The evaluation with its scenario, whose step has this duration, s, and with that step; its peak input
    without noise sets the load. Linear metrics computed before are kept.

    `target`: the behaviour that the weights were searched for.
    """
    setup, s, robot = linear.setup, linear.setup.specification, linear.setup.robot
    step, scales = setup.step(duration), modes.JointScales.of(setup.model, setup.goal_equilibrium)
    sub_steps, load, stated = step.run.settings["sub_steps"], s.load, setup.stated_move
    if load is None:
        quiet = setup.without_noise.step(duration, sub_steps=sub_steps)
        loads = responses.default_load(scales.per_input, quiet.peak_inputs)
    else:
        loads = np.full(len(setup.goal), load)
    holding_inputs = [setup.equilibrium(at)[1] for at in (setup.start, setup.goal)]
    plan = stated or plans.plan_move(
        robot,
        s,
        setup.start,
        setup.goal,
        followed_bandwidth(linear, target),
        float(scales.vibration.min()),
        holding_inputs,
    )
    dwell = duration if stated else None
    runs = responses.Scenario(duration, loads, 2.0 * duration, plan, sub_steps, dwell)
    return with_derived(linear, scenario=runs, known_step=step)


def followed_bandwidth(linear: LawEvaluation, target: TargetBehaviour | None) -> np.ndarray:
    """Finite bandwidth (n,), rad/s, for which the move is planned: that of the law with the true state fed back."""
    own = np.asarray(linear.state_margins.bandwidth, dtype=float)
    usable = np.isfinite(own) & (own > 0.0)
    return np.where(usable, own, 1.0) if target is None else target.where_not(usable, own)
