"""Loop of a law with its estimator at rest at any pose of a workspace."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from flexhinf.analysis import LinearLoop
from flexhinf.analysis.linear_loop import exponential
from flexhinf.baselines.posed_laws import PosedLaw
from flexhinf.designs.estimators import ESTIMATORS, MODAL, EstimatorTask, estimator_name_at_any_pose
from flexhinf.designs.loop_setup import SMOOTH_EXTRAS, LoopPlants
from flexhinf.designs.motions import Motion
from flexhinf.designs.noise_levels import EstimatorNoise
from flexhinf.designs.plans import (
    true_robot,
)
from flexhinf.designs.resting import CornerLoop, PoseLoop
from flexhinf.designs.specification import AUTO, RINGS, Specification
from flexhinf.estimation import ModalFilter, stationary_gain
from flexhinf.estimation.stationary import stationary_covariance
from flexhinf.modal import ModalLaw, PairGains
from flexhinf.robot import Robot
from flexhinf.robot.workspace import Workspace

#: Poses by which a law is chosen, and their seed.
CHOSEN_POSES, CHOSEN_SEED = 16, 17

#: Random torques that the estimator expects each sample unless others are found or stated, on links and on motors, in
#: parts of the motors' limits.
EXPECTED = (0.0025, 0.03)

#: Least damping of slow oscillations; factor of all inputs at once that a loop tolerates, up and down.
DAMPING, GAIN = 0.2, 2.0

#: Offsets of the encoders are taken in with this time constant, s, and those of which is said what they do, rad or m. A
#: difference of 0.5 mrad between link and motor looks like a twisted spring; acting at once it would move a stiff arm
#: by 14 mrad. A response lasts until this share of it is left, at most so long, s.
OFFSET_TIME, OFFSET, LEFT, LASTS = 0.5, 5e-4, 1e-3, 20.0

#: Acceleration that a motor without a stated limit is assumed to have, rad/s² or m/s². Stated limits allow up to twice.
ACCELERATION = 50.0

#: Linear controllers that are kept, by poses.
STEPS = 1000


def pose_limits(s: Specification) -> tuple[float, float]:
    """Least damping of slow oscillations, and largest ripple, per cent."""
    return DAMPING if s.damping is None else s.damping, s.limit("ripple")


def corner_damping(s: Specification) -> float:
    """Least damping of slow oscillations of robots at corners of their tolerances; a smaller one rings."""
    return min(RINGS, pose_limits(s)[0])


def gain_limit(s: Specification) -> float:
    """Factor by which all inputs may grow or shrink at once."""
    return s.limit("gain_margin", GAIN)


@dataclass(frozen=True, eq=False)
class RestingLoops(LoopPlants):
    """Loops of a law with its estimator at rest at any pose of a workspace, linearised and sampled.

    Poses are link positions (n,), rad or m. The loop runs with the period, latency, sensors, noise and limits of the
    specification.
    """

    workspace: Workspace
    law: PosedLaw
    random: tuple[float, float] = EXPECTED
    other: Robot | None = None  # the true robot, where it is another one than the model's
    motion: Motion | None = None  # the only one; None: moves between random goals of the workspace
    # of which the gains of a law are made, by name: one, or one for each joint; none of the modal law
    numbers: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])

    def __getstate__(self) -> dict[str, Any]:
        """State to pickle for other processes: what is computed from it is left out."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def pairs(self) -> PairGains | None:
        """The gains of pairs of a link and a motor; None of a law that is not made of them."""
        return self.law.gains if isinstance(self.law, ModalLaw) else None

    @property
    def gains(self) -> PairGains:
        """Those of the pairs, of a law that is made of them."""
        assert self.pairs is not None
        return self.pairs

    @property
    def bandwidth(self) -> float | None:
        """The bandwidth of which the law is made, the largest of all joints, rad/s; None without one."""
        if self.pairs is not None:
            return self.pairs.weights.bandwidth
        return max(self.numbers["bandwidth"]) if "bandwidth" in self.numbers else None

    @cached_property
    def true(self) -> LoopPlants:
        """As of every loop, of the robot that is the true one."""
        return LoopPlants(*true_robot(self.other or self.robot, self.specification))

    @cached_property
    def noise_levels(self) -> EstimatorNoise:
        """R^v: as stated, or random torques on links and motors in parts of the motors' limits."""
        s, joints = self.specification, self.law.joints
        if s.process_noise is not None or s.torque_noise is not None:
            return EstimatorNoise.stated(s)
        limit = self.authority * joints.torque_per_input
        links, motors = self.random
        on_links = links * limit / np.diag(joints.link_inertia)
        on_motors = motors * limit / joints.motor_inertia
        return EstimatorNoise(0.0, tuple((s.period * on_links) ** 2), tuple((s.period * on_motors) ** 2))

    @cached_property
    def authority(self) -> np.ndarray:
        """Limits of the motors (n,); of one without a limit the input that holds the weight and accelerates link and
        motor by `ACCELERATION`, at some random poses. Of a drive that takes positions it is that, beside the pose: its
        limit is a range of positions."""
        joints, p = self.law.joints, self.law.plant.parameters.vector()
        place = float(self.robot.drive_kind.takes_positions)
        needed = [
            np.abs(self.robot.operating_point(pose)[1] - place * pose)
            + ACCELERATION
            / joints.torque_per_input
            * (np.diag(np.linalg.inv(self.law.compliance.matrix(pose, p))) + joints.motor_inertia)
            for pose in self.workspace.sample(CHOSEN_POSES, CHOSEN_SEED)
        ]
        stated = np.isfinite(self.limits.effort) & (not place)
        return np.where(stated, self.limits.effort, np.max(needed, axis=0))

    def estimator(self, at: np.ndarray) -> Any:
        """The estimator, started at rest at a pose (n,), of which its gains do not depend; None where the true state is
        fed back.

        Of the modal filter gains of the pairs are those of every pose. Another one, whose covariance follows the pose,
        begins with the covariance of rest at home."""
        s = self.specification
        if s.estimator == "none":
            return None
        name = estimator_name_at_any_pose(self.robot, s) if s.estimator == AUTO else s.estimator
        model, mean = self.model, self.robot.operating_point(at)[0]
        process, measurement = self.noise_levels.covariance(model.states), self.noise_variances
        covariance = process + 1e-12 * np.eye(len(mean)) if name == MODAL else self._covariance_at_home
        home = self.law.equilibrium[0]
        task = EstimatorTask(model, s.period, process, measurement, mean, covariance, home)
        return ESTIMATORS[name].make(task)

    @cached_property
    def _covariance_at_home(self) -> np.ndarray:
        """P of a prediction at rest at home, by the noises of the estimator."""
        noises = self.noise_levels.covariance(self.model.states), np.diag(self.noise_variances)
        return stationary_covariance(self._sampled_model(*self.robot.operating_point()), *noises)

    def _sampled_model(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """F and H of the model about an equilibrium."""
        inner, driven, _, seen = self.model.linearise(x, u)
        return exponential(inner, driven, self.specification.period)[0], seen

    @property
    def knows_friction(self) -> bool:
        """Never: the controller adds the friction of the file itself."""
        return False

    @cached_property
    def filter(self) -> Any:
        """The estimator at home, from which `linear` takes the gains."""
        return self.estimator(np.asarray(self.robot.home))

    def _filter_gain(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """That of the estimator (states, p) at rest at an equilibrium."""
        if isinstance(self.filter, ModalFilter):
            return self.filter.gain(x)
        return stationary_gain(
            self._sampled_model(x, u), self.filter.process_noise, self.filter.measurement_noise
        )

    def linear(
        self, at: np.ndarray, values: Mapping[str, Any] | None = None, damped: bool = True
    ) -> LinearLoop:
        """The sampled loop linearised at rest at a pose (n,), of a robot with the parameters `values`, whose springs
        may be without damping.

        It is built from the gains of law and filter. `EquilibriumLoop` gives the same from derivatives of the traced
        step, more slowly.
        """
        s, states, n = self.specification, self.model.states, len(self.joints)
        plant = self.smooth_plant_of(values, damped)
        smooth = tuple(name for name in self.extras if name in SMOOTH_EXTRAS)
        a, b, g, c = plant.linearise(*self.true.robot.operating_point(at, smooth, values))
        whole = np.eye(plant.n)[[plant.index(name) for name in states]]
        c = whole if self.filter is None else c
        # Robots at corners of the tolerances have the same controller.
        memory, law = self._kept_step(at.tobytes())
        return LinearLoop(
            s.period,
            a,
            b,
            c,
            np.zeros((len(c), n)),
            memory,
            law,
            np.zeros((len(memory), n)),
            np.zeros((n, n)),
            whole[:n],
            tuple(states[:n]),
            g,
            tuple(plant.disturbances),
            tuple(plant.inputs),
            delay=(s.known_latency + s.unknown_samples) * s.period,
        )

    @cached_property
    def _kept_step(self) -> Callable[[bytes], tuple[np.ndarray, np.ndarray]]:
        return lru_cache(STEPS)(self._step)

    def _step(self, pose: bytes) -> tuple[np.ndarray, np.ndarray]:
        """The controller's step at rest at a pose (n,): its next memory (s, s + p) and the input (n, s + p), by its
        memory and what is measured. The memory is the estimator's prediction, the inputs that have not acted yet, and,
        of a law that uses them, the integrals with the half of the last error that the next step adds."""
        s, model, n, at = self.specification, self.model, len(self.joints), np.frombuffer(pose)
        x, u = self.robot.operating_point(at)
        inner, driven, _, seen = model.linearise(x, u)
        moved, driven = exponential(inner, driven, s.period)
        if self.filter is None:
            seen, measured, gain = np.eye(model.n), model.states, np.eye(model.n)
        else:
            gain, measured = self._filter_gain(x, u), model.outputs
        size = model.n + (s.known_latency + 1) * n
        unit = np.eye(size + len(seen))
        prediction, integral, y = unit[: model.n], unit[size - n : size], unit[size:]
        waiting = [unit[k : k + n] for k in range(model.n, size - n, n)]  # which acts next first
        estimate = prediction + gain @ (y - seen @ prediction)
        links = tuple(model.states[:n])
        seen_links = [measured.index(name) for name in links if name in measured]
        half = 0.5 * s.period * (y[seen_links] if len(seen_links) == n else estimate[:n])
        ahead = estimate
        for late in waiting:
            ahead = moved @ ahead + driven @ late
        law = self.law.slope_at(at)
        waiting.append(law[:, : model.n] @ ahead + law[:, model.n :] @ (integral + half))
        memory = np.vstack([moved @ estimate + driven @ waiting[0], *waiting[1:], integral + 2.0 * half])
        if law[:, model.n :].any():
            return memory, waiting[-1]
        kept = np.delete(np.arange(size + len(seen)), np.s_[size - n : size])
        return memory[: size - n, kept], waiting[-1][:, kept]

    def at_corner(self, at: np.ndarray, values: Mapping[str, Any] | None, damped: bool = True) -> CornerLoop:
        """The loop at rest at a pose (n,), of a robot with the parameters `values`, as for `linear`."""
        loop = self.linear(at, values, damped).closed_loop
        growth, limit = float(np.abs(loop.multipliers).max()), self.specification.damped_below_limit
        return CornerLoop(growth, *loop.damping_about(limit))

    def at_pose(self, at: np.ndarray, tolerance: float = 0.0) -> PoseLoop:
        """The loop at rest at a pose (n,), with margins that are smaller than required by a relative tolerance."""
        s, loop = self.specification, self.linear(at)
        extra = (1.0 - tolerance) * (s.limit("delay_margin") * s.period)
        gain = (1.0 - tolerance) * gain_limit(s)

        def growth(loop: LinearLoop, extra: float = 0.0) -> float:
            return float(np.abs(loop.system(loop.delay + extra).multipliers).max())

        ripple = float((self.noise_spread(loop)[0] / self.authority).max())
        damping, fast = loop.closed_loop.damping_about(s.damped_below_limit)
        louder, softer = (growth(replace(loop, b=k * loop.b, d=k * loop.d)) for k in (gain, 1.0 / gain))
        return PoseLoop(
            growth=float(np.abs(loop.closed_loop.multipliers).max()),
            damping=damping,
            fast_damping=fast,
            late=growth(loop, extra),
            later=growth(loop, 2.0 * extra),
            louder=louder,
            softer=softer,
            ripple=100.0 * ripple,
        )

    def noise_spread(self, loop: LinearLoop) -> np.ndarray:
        """Standard deviations (2, n) of inputs, and of link positions, rad or m, by the sensors' noise and steps."""
        m, p, noise = len(self.joints), len(loop.c), np.zeros(loop.closed_loop.b.shape[1])
        if self.noise is not None:
            noise[m : m + p] = self.read_noise
        return loop.closed_loop.spread(noise)[m:].reshape(2, m)

    @property
    def read_noise(self) -> np.ndarray:
        """Standard deviations (p,) of what is measured, with the steps of the sensors."""
        steps = 0.0 if self.quantisation is None else self.quantisation
        return np.hypot(0.0 if self.noise is None else self.noise, steps / np.sqrt(12.0))

    def encoder_offsets(self, at: np.ndarray, time: float | None = OFFSET_TIME) -> np.ndarray:
        """How far offsets of `OFFSET` of all motors' encoders, or without these the links', move each link that rests
        at a pose (n,): at most on the way, and at the end, (2, n), rad or m, for the worst signs of the offsets.

        By the linear loop, without dry friction; infinite where that is unstable. The controller takes them in with the
        constant `time`, s, or at once (None).
        """
        chain = self.linear(at).part("v", "q")
        measured = self.model.states if self.filter is None else self.model.outputs
        if not chain.stable:
            return np.full((2, len(at)), np.inf)
        off = np.array([name.startswith("motor_position") for name in measured])
        off = off if off.any() else np.array([name.startswith("link_position") for name in measured])
        full, decay = OFFSET * chain.b[:, off], 0.0 if time is None else np.exp(-chain.period / time)
        slowest = max(decay, float(np.abs(chain.multipliers).max()))
        remaining = np.abs(chain.c @ np.linalg.solve(np.eye(len(chain.a)) - chain.a, full)).sum(axis=1)
        state, largest, left = np.zeros_like(full), remaining, 1.0
        for _ in range(round(min(np.log(LEFT) / np.log(slowest), LASTS / chain.period))):
            left *= decay
            state = chain.a @ state + (1.0 - left) * full
            largest = np.maximum(largest, np.abs(chain.c @ state).sum(axis=1))
        return np.array([largest, remaining])
