"""One law in one loop: its runs, margins, corners and sampled robots, each computed once, when it is needed."""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from flexhinf import analysis
from flexhinf.analysis import modes
from flexhinf.arrays import Matrix
from flexhinf.designs import checks, monte_carlo, responses
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.errors import FlexhinfError
from flexhinf.estimation import stationary_gain
from flexhinf.robot.modes import Energy
from flexhinf.robot.springs import DAMPED

#: Ratios of R^v to R^n for which corners are computed, by the number of states of the linear loop: large loops afford
#: one. Between two ratios `tolerance_corners` searches for the worst one.
RATIOS: tuple[tuple[float, tuple[float, ...]], ...] = ((40, (1e-4, 1.0, 1e4, 1e8)), (np.inf, (1e2,)))


@dataclass(frozen=True, eq=False)
class LawEvaluation:
    """Evaluation of one law in one loop: runs, margins and modes."""

    setup: LoopSetup  # law, estimator, controller and true plant
    scenario: responses.Scenario | None = None  # the runs; without a scenario there are only linear metrics
    known_step: responses.Response | None = None  # the step, where it was run for the scenario

    # What is computed before it is read, for the steps of a pipeline -----------------------------------------
    def compute_margins(self) -> analysis.Margins:
        """The margins, now."""
        return self.margins

    def compute_corners(self) -> tuple[analysis.ToleranceCorners | None, analysis.FrequencyResponse]:
        """Corners and frequency response, now."""
        return self.corners, self.frequency_response

    def compute_modes(self) -> tuple[tuple[modes.Mode, ...], tuple[modes.Mode, ...]]:
        """Modes of the running loop and of the robot, now."""
        return self.closed_loop_modes, self.open_modes

    def make_runs(self) -> tuple[responses.LoadResponse, checks.ImpulseRuns, responses.Move]:
        """Load, impulses and move, now."""
        return self.load_response, self.ring_down, self.move

    def sample_robots(self) -> monte_carlo.MonteCarlo | None:
        """The steps of the sampled robots, now."""
        return self.step_samples

    @property
    def runs(self) -> responses.Scenario:
        """The scenario of an evaluation that has one."""
        assert self.scenario is not None, "an evaluation without a scenario has no runs"
        return self.scenario

    # Runs of the nominal robot ----------------------------------------------------------------------------
    @cached_property
    def step(self) -> responses.Response:
        """The step with the deployed controller: the input starts without a jump."""
        return self.known_step or self.setup.step(self.runs.step_duration, sub_steps=self.runs.sub_steps)

    @cached_property
    def step_motion(self) -> list[dict[str, Any]]:
        """`responses.motion_metrics` of the step."""
        return responses.motion_metrics(self.setup.limits, self.step, self.setup.command)

    @cached_property
    def unlimited_step(self) -> responses.Response:
        """The step without input limits, which shows the input that the law demands; `step` itself if it reaches no
        limit."""
        limits, step = self.setup.limits.saturated, self.step
        if limits is None or (step.diverged_at is None and np.all(step.peak_inputs < limits)):
            return step
        return replace(self.setup, unlimited=True).step(
            self.runs.step_duration, sub_steps=self.runs.sub_steps
        )

    @cached_property
    def move(self) -> responses.Move:
        """The planned move with feedforward: the same reference for every law."""
        return self.setup.move(self.runs.plan, sub_steps=self.runs.sub_steps, dwell=self.runs.dwell)

    @cached_property
    def load_response(self) -> responses.LoadResponse:
        """Response at the goal to constant torques on all links."""
        return self.setup.load_response(self.runs.load, self.runs.load_duration, self.runs.sub_steps)

    @cached_property
    def ring_down(self) -> checks.ImpulseRuns:
        """Impulse responses at the goal, one for each joint."""
        runs = self.runs
        return checks.impulse_runs(self.setup, self.step.peak_inputs, runs.step_duration, runs.sub_steps)

    # Sampled robots -----------------------------------------------------------------------------------------
    @cached_property
    def step_samples(self) -> monte_carlo.MonteCarlo | None:
        """The steps of the sampled robots with the deployed controller; None without sampled robots."""
        runs, setup = self.runs, self.setup
        return (
            monte_carlo.judged_runs(setup, runs.robots, runs.step_duration, runs.sub_steps)
            if runs.robots
            else None
        )

    # The linear loop ----------------------------------------------------------------------------------------
    @cached_property
    def loop(self) -> analysis.EquilibriumLoop:
        """The running loop about the goal: sampled, with estimator and delay."""
        return self.setup.equilibrium_loop()

    @cached_property
    def margins(self) -> analysis.Margins:
        """Margins of the running loop. Raises `FlexhinfError` if it has no equilibrium."""
        return analysis.margins(self.loop)

    @cached_property
    def undamped_margins(self) -> analysis.Margins | None:
        """Margins of the running loop with springs that nothing damps, which decide nothing; None where the true robot
        has no others."""
        return (
            analysis.margins(self.setup.equilibrium_loop(damped=False))
            if DAMPED in self.setup.extras
            else None
        )

    @cached_property
    def linear_failure(self) -> str:
        """The reason why the loop has no equilibrium, and so no linear metrics; empty if it has one."""
        try:
            self.compute_margins()
        except FlexhinfError as error:
            return " ".join(str(error).split())
        return ""

    @cached_property
    def state_margins(self) -> analysis.Margins:
        """Margins with the true state fed back: those of the law without its estimator."""
        estimated = self.loop.filter is not None
        return analysis.margins(self.setup.equilibrium_loop(estimated=False)) if estimated else self.margins

    @cached_property
    def frequency_response(self) -> analysis.FrequencyResponse:
        """Frequency response of the running loop."""
        return analysis.frequency_response(self.loop)

    @cached_property
    def corners(self) -> analysis.ToleranceCorners | None:
        """Corners of the tolerances in the running loop; None for a robot that states none."""
        robot = self.setup.true.robot
        if not robot.uncertain:
            return None
        noises = []
        if self.loop.tunable:  # the ratios between which R^v may be retuned
            variance = float(np.diag(self.loop.filter.measurement_noise).min())
            forms = dict.fromkeys(noise.form for noise in analysis.standard_noises(self.loop))
            ratios = next(ratios for most, ratios in RATIOS if self.loop.states <= most)
            noises = [analysis.ProcessNoise(form, ratio * variance) for form in forms for ratio in ratios]
        return analysis.tolerance_corners(self.loop, robot.corner, robot.uncertain, tuple(noises))

    @cached_property
    def state_corners(self) -> analysis.GrowthRates | None:
        """Stability of the same corners under state feedback."""
        if self.corners is None or self.loop.filter is None:
            return None
        return analysis.growth_rates(self.setup.equilibrium_loop(estimated=False), self.corners.population)[0]

    # Modes --------------------------------------------------------------------------------------------------
    @cached_property
    def energy(self) -> Energy:
        """Energies at the goal, by which modes are named."""
        return modes.stiffness_and_inertia(self.setup.model, self.setup.goal_equilibrium)

    @cached_property
    def open_modes(self) -> tuple[modes.Mode, ...]:
        """Modes of the uncontrolled robot at the goal."""
        return self.setup.robot.modes(self.setup.goal)

    @cached_property
    def estimator_modes(self) -> tuple[modes.Mode, ...]:
        """Modes of the estimation error, with the filter's stationary gain; none without estimator, or without noise.

        e(k + 1) = A (1 − L C) e(k) for the sampled A, with L from the stationary Riccati equation of R^v and R^n. With
        the nominal plant the linearised loop has these modes and those of the law.
        """
        filter = self.loop.filter
        if filter is None or not self.setup.process_noise.largest:
            return ()
        from scipy.linalg import expm

        a, _, _, c = filter.plant.linearise(*self.setup.goal_equilibrium)
        sampled = cast("Matrix", expm(a * filter.period))
        gain = stationary_gain((sampled, c), filter.process_noise, filter.measurement_noise)
        error = sampled @ (np.eye(len(a)) - gain @ c)
        return modes.sampled_modes(*np.linalg.eig(error), filter.period, self.setup.joints, *self.energy)

    @cached_property
    def closed_loop_modes(self) -> tuple[modes.Mode, ...]:
        """Modes of the running loop: sampled, with estimator and delay."""
        linear = self.loop.linear()
        return modes.sampled_modes(
            *linear.closed_loop.modes(), linear.period, self.setup.joints, *self.energy
        )

    @cached_property
    def least_damped(self) -> tuple[modes.Mode | None, modes.Mode | None]:
        """The oscillations with the damping ratios of `Margins.damping_about`, slow and fast; None where there is
        none."""
        below = self.setup.specification.damped_below_limit
        ringing = [mode for mode in self.closed_loop_modes if mode.eigenvalue.imag > 0.0]
        slow, fast = (
            min(
                (mode for mode in ringing if (abs(mode.eigenvalue) >= below) is is_fast),
                key=lambda mode: abs(mode.damping - ratio),
                default=None,
            )
            for is_fast, ratio in zip((False, True), self.margins.damping_about(below))
        )
        return slow, fast

    @property
    def least_damped_joint(self) -> str:
        """The joint that moves most in the least damped oscillation; empty where nothing oscillates."""
        ringing = [mode for mode in self.least_damped if mode is not None]
        return min(ringing, key=lambda mode: mode.damping).joint if ringing else ""

    @property
    def input_noises(self) -> np.ndarray | None:
        """RMS of each input (m,) that the measurement noise causes, V or N·m; None with the true state fed back."""
        return None if self.setup.noise is None else self.margins.input_noise(self.setup.noise)

    @property
    def input_noise(self) -> float:
        """The largest of `input_noises`; zero without an estimator."""
        return 0.0 if self.input_noises is None else float(self.input_noises.max())
