"""An impulse on each joint of the resting loop, one run a joint: the damping of the running loop's ring-down.

An impulse of torque on a link makes its velocity jump, by M⁻¹ at the goal. So a run begins at the goal with that
velocity; neither law nor estimator knows of it. Without measurement noise, which would hide what is left of the decay.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.problem.modes import JointScales
from flexhinf.design.requirements import REQUIREMENTS, Requirement, of_several
from flexhinf.design.responses import Response, default_load
from flexhinf.design.specification import Specification
from flexhinf.loop.simulation.metrics import FITS, Oscillation, RingDown, ring_down as fit_ring_down

#: An impulse is this fraction of the default load, times the time in which the joint's vibration goes through one
#: radian: it twists the spring by about 3 % of the motor's largest torque in the step, where the loop is nearly linear.
FRACTION = 0.3

#: A motor may use this fraction of what its limit leaves it at rest; a larger impulse is made smaller, to the second.
ROOM, KEPT = 0.9, 0.7

#: Runs last so many periods of the lowest vibration with held motors, and at most as long as the step.
PERIODS = 10.0

#: Most samples of a delay that the fit remembers.
MOST_LAGS = 20

#: The remaining velocity is measured after so many periods of the least damped oscillation.
AFTER = 3.0


@dataclass(frozen=True, eq=False)
class ImpulseRuns:
    """One run a joint, at rest at the goal until the impulse at time 0."""

    responses: tuple[Response, ...]  # Of each joint that with the impulse on its link
    impulses: np.ndarray  # (n,), N·m·s or N·s
    # state, input: (N,), (m,). Where the loop rests
    state: np.ndarray
    input: np.ndarray
    delay: int = 0  # Of the inputs, samples

    @property
    def diverged(self) -> bool:
        """Whether any run did."""
        return any(response.diverged_at is not None for response in self.responses)

    @cached_property
    def ring_down(self) -> RingDown | None:
        """Oscillations of each run, in velocities and input of its own joint; None where one diverged."""
        if self.diverged:
            return None
        n, runs = len(self.responses), [self._deviations(response) for response in self.responses]
        names, count = self.responses[0].run.names, runs[0].shape[1]
        watched = []
        for joint in range(n):
            columns = [n + joint, count - n + joint]
            name = names["state"][n + joint].replace("link_", "motor_")
            watched.append([*columns, *([names["state"].index(name)] if name in names["state"] else [])])
        return fit_ring_down(runs, watched, self.responses[0].run.settings["period"])

    def _deviations(self, response: Response) -> np.ndarray:
        """State, estimate, and inputs of the last samples, the newest last: what the loop remembers."""
        signals = response.run.signals
        inputs = signals["input"] - self.input
        lags, none = range(min(self.delay, MOST_LAGS), 0, -1), np.zeros((MOST_LAGS, inputs.shape[1]))
        before = [np.vstack([none[:lag], inputs[:-lag]]) for lag in lags]
        believed = signals.get("estimate", signals["state"][:, :0])
        estimate = believed - self.state[: believed.shape[1]]
        return np.hstack([signals["state"] - self.state, estimate, *before, inputs])

    @property
    def damping(self) -> float:
        """Smallest damping ratio of all runs; −∞ where one diverged."""
        return -np.inf if self.ring_down is None else self.ring_down.damping

    @property
    def worst(self) -> int:
        """The joint of the impulse that shows it."""
        if self.ring_down is None:
            return next(k for k, response in enumerate(self.responses) if response.diverged_at is not None)
        return self.ring_down.worst

    def requirement(self, s: Specification, damping: float) -> Requirement:
        """That the running loop comes to rest after an impulse as damped as every oscillation must be."""
        where = (
            "nonlinear loop at rest at the goal, struck on one joint after the other, nominal robot, no noise"
        )
        joint = of_several(self.responses[0].joints, self.worst)
        return REQUIREMENTS["ring_down"].judge(s, damping, self.damping, where, joint=joint)

    @property
    def exponential(self) -> bool:
        """Whether the runs are decaying oscillations, as those of a linear loop."""
        return self.ring_down is not None and self.ring_down.error <= FITS

    def least_damped(self, joint: int) -> Oscillation | None:
        """Of the run with the impulse on a joint; None where nothing oscillates."""
        oscillations = () if self.ring_down is None else self.ring_down.oscillations[joint]
        return oscillations[0] if oscillations else None

    def velocity(self, joint: int) -> np.ndarray:
        """Velocity (N,) of the link with the impulse, over its peak."""
        own = self.responses[joint].velocities[:, joint]
        return own / np.abs(own).max()

    def left(self, joint: int) -> float | None:
        """Largest velocity of that link, over its peak, after `AFTER` periods of its least damped oscillation;
        None where nothing oscillates, or the run is shorter."""
        oscillation, response = self.least_damped(joint), self.responses[joint]
        if oscillation is None or response.run.time[-1] * oscillation.frequency < AFTER:
            return None
        return float(np.abs(self.velocity(joint)[response.run.time >= AFTER / oscillation.frequency]).max())


def impulse_sizes(setup: LoopSetup, peak: np.ndarray) -> np.ndarray:
    """Impulses (n,), N·m·s or N·s, for the peak inputs (n,) of the step."""
    scales = JointScales.of(setup.model, setup.goal_equilibrium)
    return FRACTION * default_load(scales.per_input, peak) / scales.vibration


def impulse_runs(
    setup: LoopSetup, impulses: np.ndarray, most: float, sub_steps: int | None = None
) -> ImpulseRuns:
    """A run for each joint, its impulse (n,), N·m·s or N·s, smaller where a motor would come near its limit.

    `most`: longest run, s. `sub_steps`: Runge–Kutta steps per period of the true plant.
    """
    period = setup.specification.period
    lowest = JointScales.of(setup.model, setup.goal_equilibrium).held
    duration = round(min(most, PERIODS * 2.0 * np.pi / lowest) / period) * period
    quiet = setup.without_noise
    state, held = setup.equilibrium(setup.goal)
    delay = round(setup.specification.delay / period)
    runs = tuple(quiet.impulse_responses(impulses, duration, sub_steps))
    room = np.maximum(setup.limits.effort - np.abs(held), 1e-12)
    used = np.array([float((np.abs(run.inputs - held).max(axis=0) / room).max()) for run in runs])
    if np.isfinite(used).all() and (used > ROOM).any():
        impulses = impulses * np.where(used > ROOM, KEPT / used, 1.0)
        runs = tuple(quiet.impulse_responses(impulses, duration, sub_steps))
    return ImpulseRuns(runs, impulses, state, held, delay)
