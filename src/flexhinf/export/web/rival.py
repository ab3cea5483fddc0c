"""The PD on the motors that moves beside the exported controller: its gains, and how they are chosen.

u = u_d − K_p (θ − θ_d) − K_d (θ̇_f − θ̇_d) of each motor, about the state and the input that the command has by the
nominal model, the weight included [tomei1991]. θ is the motor's encoder, θ̇_f its filtered difference. The gains are
those of `flexhinf.baselines.MotorPD` with a bandwidth ω_j and a damping ratio ζ_j for each joint; a drive with a loop
of its own keeps gains that are larger, and where both are it moves alone. ω and ζ are searched, first for all joints
together and then joint by joint, such that the links come to a new position as fast as they can: least


    Σ_j ∫ t |q − q_d|² dt    after a step of each joint j alone, in the sampled linear loop with its latency,

the mean over some poses. A bandwidth is at most r √(K_j / M_jj), r = 3, where √(K/M) is how the link vibrates against a
motor that stands still, and its phase over the delay of the loop at most `PHASE`.

Only gains with margins are taken: at all these poses and at corners of the joints' ranges, with the nominal robot and
with robots at corners of the tolerances, every oscillation below `BELOW` has a damping ratio of at least `DAMPING`,
and the loop stays stable with one period of latency more and with all gains halved or doubled. Where no gains damp as
much, `KEPT` times the largest damping ratio that was found is enough; where none stay stable, they are those with the
largest damping ratio, and `MotorGains.fair` is false.
"""

# Not checked strictly: SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.plant.joints import ElasticJoints, elastic_joints, joint_places
from flexhinf.robot import Robot

#: Bandwidths over √(K/M), or over a third of the largest one where that is less, and damping ratios, that are tried for
#: all joints together; then factors for each one alone.
RATIOS, DAMPINGS, FACTORS = np.geomspace(0.1, 3.0, 9), np.geomspace(0.15, 3.0, 7), (0.7, 0.85, 1.2, 1.45)

#: Smallest damping ratio of an oscillation, and share of the largest one where all are smaller. Those faster than
#: `BELOW`, rad/s, have to be stable, however little they are damped: latency leaves little of a PD there. Latency that
#: is to spare, samples, and factors of all gains.
DAMPING, KEPT, BELOW, SPARE, GAINS = 0.1, 0.7, 350.0, 1, (0.5, 2.0)

#: Largest phase of a bandwidth over latency and sampling, rad.
PHASE = 0.1

#: Bandwidth, rad/s, and damping ratio of the stiff PD, and largest phase of its bandwidth over the loop's delay, rad.
STIFF, DAMPED, STIFF_PHASE = 80.0, 0.7, 0.25

#: Samples of the sum, as a power of two: 8 s at 1 kHz.
DOUBLINGS = 13

#: Cut-off of the filter of a motor's speed, in bandwidths, and at most this share of the sampling rate, rad.
CUTOFF, FASTEST = 10.0, 0.5


@dataclass(frozen=True)
class MotorGains:
    """Gains (n,) of a PD on the motors, in units of the input, and what they were made of.

    `cutoff`: (n,), of the filters of the speeds, rad/s. `bandwidth` and `damping`: (n,), rad/s and ratios. `poses`: at
    which they were searched. Of all `checked` linear loops of poses and robots, `least` is the smallest damping ratio
    of an oscillation below `BELOW`, negative where any grows, and `spare` whether all stay stable as the module says.
    """

    proportional: np.ndarray
    derivative: np.ndarray
    cutoff: np.ndarray
    bandwidth: np.ndarray
    damping: np.ndarray
    poses: int = 1
    checked: int = 0
    least: float = np.nan
    spare: bool = False

    @property
    def fair(self) -> bool:
        """Whether every loop that was looked at is stable, with its margins."""
        return self.least > 0.0 and self.spare


def tuned_gains(
    robot: Robot, poses: Sequence[np.ndarray], period: float, latency: int, corners: Sequence[np.ndarray] = ()
) -> MotorGains:
    """The gains that bring the links to rest fastest, as above; the joints' numbers are means over the poses (n,).

    `period` in s; `latency` in samples; `corners`: more poses (n,) at which the margins are looked at. The robot has no
    extras.
    """
    plant = robot.plant()
    points = [robot.operating_point(pose) for pose in poses]
    places = joint_places(plant)
    loops = [_Sampled.of(plant.linearise(*point)[:2], places, period, latency) for point in points]
    checks = _Checks.of(robot, [*poses, *corners], period, latency)
    numbers = [elastic_joints(plant, *point, rigid=True, coupled=True) for point in points]
    joints = ElasticJoints(*(np.mean(values, axis=0) for values in zip(*numbers, strict=True)))
    natural = np.sqrt(joints.stiffness / np.diag(joints.link_inertia))
    largest = np.minimum(RATIOS[-1] * natural, PHASE / (period * (latency + 1)))

    def cost(tuning: np.ndarray) -> float:
        gains = _gains(joints, tuning[0], tuning[1], period)
        return float(np.mean([loop.cost(gains) for loop in loops]))

    def margins(tuning: np.ndarray) -> tuple[float, bool]:
        return checks.margins(_gains(joints, tuning[0], tuning[1], period))

    tried = [
        np.array([ratio / RATIOS[-1] * largest, np.full(len(natural), damping)])
        for ratio in RATIOS
        for damping in DAMPINGS
    ]
    found = [margins(tuning) for tuning in tried]
    floor = min(DAMPING, KEPT * max((ratio for ratio, stays in found if stays), default=np.inf))
    kept = [k for k, (ratio, stays) in enumerate(found) if stays and ratio >= floor]
    first = min(kept, key=lambda k: cost(tried[k])) if kept else int(np.argmax([ratio for ratio, _ in found]))
    best, least, held = tried[first], cost(tried[first]), found[first]
    for joint in range(len(natural)) if kept else ():
        for row in range(2):
            for factor in FACTORS:
                other = best.copy()
                other[row, joint] *= factor
                other[0] = np.minimum(other[0], largest)
                if (new := cost(other)) < least:
                    ratio, stays = now = margins(other)
                    if stays and ratio >= floor:
                        best, least, held = other, new, now
    gains = _gains(joints, best[0], best[1], period)
    return MotorGains(*gains, best[0], best[1], len(points), len(checks.loops), *held)


def stiff_gains(robot: Robot, pose: np.ndarray, period: float, latency: int) -> MotorGains:
    """Gains that hold the motors at `STIFF` rad/s with `DAMPED`, as if no spring carried a link.

    K_p = J ω² and K_d = 2 ζ J ω, less what an inner loop of the drive has of them. ω is less where its phase over the
    delay of the loop would be above `STIFF_PHASE`.
    A joint without a spring has its link's inertia too. `period` in s; `latency` in samples; no margins are computed.
    """
    joints = elastic_joints(robot.plant(), *robot.operating_point(pose), rigid=True, coupled=True)
    count = len(joints.motor_inertia)
    rigid = np.isin(np.arange(count), list(robot.layout.rigid))
    inertia = joints.motor_inertia + np.where(rigid, np.diag(joints.link_inertia), 0.0)
    wanted = min(STIFF, STIFF_PHASE / (period * (latency + 1)))
    bandwidth = np.maximum(wanted, np.sqrt(joints.drive_stiffness / inertia))
    damping = np.full(count, DAMPED)
    per_input, unit = inertia * bandwidth / joints.torque_per_input, joints.torque_per_input
    stiffness = np.maximum(per_input * bandwidth - joints.drive_stiffness / unit, 0.0)
    own = joints.motor_damping / unit if joints.inner else 0.0
    derivative = np.maximum(2.0 * damping * per_input - own, 0.0)
    cutoff = np.minimum(CUTOFF * bandwidth, FASTEST / period)
    return MotorGains(stiffness, derivative, cutoff, bandwidth, damping)


def vibration_period(robot: Robot, pose: np.ndarray) -> float:
    """Period of the slowest vibration of the links against motors that stand still, s."""
    joints = elastic_joints(robot.plant(), *robot.operating_point(pose), rigid=True, coupled=True)
    squares = np.linalg.eigvals(np.linalg.solve(joints.link_inertia, np.diag(joints.stiffness))).real
    return float(2.0 * np.pi / np.sqrt(squares.min()))


def _gains(
    joints: ElasticJoints, bandwidth: np.ndarray, damping: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    inertia = np.diag(joints.link_inertia) + joints.motor_inertia
    derivative = np.maximum(0.0, 2.0 * damping * bandwidth * inertia - joints.motor_damping)
    cutoff = np.minimum(CUTOFF * bandwidth, FASTEST / period)
    stiffness = np.maximum(0.0, inertia * bandwidth**2 - joints.drive_stiffness)
    return stiffness / joints.torque_per_input, derivative / joints.torque_per_input, cutoff


@dataclass(frozen=True)
class _Sampled:
    """x(k+1) = Φ x(k) + Γ u(k); `links`, `motors`: places of their positions (n,); u comes `latency` samples late."""

    transition: np.ndarray
    effect: np.ndarray
    links: np.ndarray
    motors: np.ndarray
    period: float
    latency: int

    @classmethod
    def of(
        cls, linear: tuple[np.ndarray, np.ndarray], places: np.ndarray, period: float, latency: int
    ) -> _Sampled:
        from scipy.linalg import expm

        (a, b), n = linear, len(linear[0])
        whole: np.ndarray = expm(period * np.block([[a, b], [np.zeros((b.shape[1], n + b.shape[1]))]]))
        return cls(whole[:n, :n], whole[:n, n:], places[0], places[2], period, latency)

    def loop(self, gains: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        """Matrix of the loop with the state (x, filtered speeds, last positions, inputs that wait)."""
        proportional, derivative, cutoff = gains
        n, m, late = len(self.transition), len(proportional), self.latency
        share, size = (1.0 - np.exp(-cutoff * self.period))[:, None], n + 2 * m + m * late
        position, identity = np.zeros((m, size)), np.eye(m)
        position[np.arange(m), self.motors] = 1.0
        speed = share / self.period * position
        speed[:, n : n + m] += (1.0 - share) * identity
        speed[:, n + m : n + 2 * m] -= share / self.period * identity
        computed = -proportional[:, None] * position - derivative[:, None] * speed
        loop = np.zeros((size, size))
        loop[:n, :n] = self.transition
        loop[:n] += self.effect @ (np.eye(m, size, size - m) if late else computed)
        loop[n : n + m], loop[n + m : n + 2 * m] = speed, position
        if late:  # the newest input first, the one that acts last
            first = n + 2 * m
            loop[first : first + m] = computed
            loop[first + m :, first:-m] = np.eye(m * (late - 1))
        return loop

    def cost(self, gains: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
        """The sum of the module's text for steps of 1 rad or 1 m over some seconds, s² rad²; infinite where it is
        beyond all numbers. A vibration that grows slowly, as an undamped one may in any sampled loop, adds little."""
        loop, count = self.loop(gains), len(self.links)
        power = loop
        begin = np.zeros((len(loop), count))
        for j in range(count):
            begin[[self.links[j], self.motors[j], len(self.transition) + count + j], j] = 1.0
        # Σ_k (k + 1) ‖C A^k b‖² by doubling: of 2N samples it is that of the first N, and of the next N
        plain = np.zeros_like(loop)
        plain[self.links, self.links] = 1.0
        timed, steps = plain.copy(), 1
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(DOUBLINGS):
                later = power.T @ plain @ power
                timed = timed + power.T @ timed @ power + steps * later
                plain, power, steps = plain + later, power @ power, 2 * steps
            total = float(np.trace(begin.T @ timed @ begin)) * self.period**2
        return total if np.isfinite(total) else np.inf


#: Corners of the tolerances for each pose, and their seed.
ROBOTS, SEED = 2, 1


@dataclass(frozen=True)
class _Checks:
    """Loops of all poses with the nominal robot and with robots at corners of the tolerances: as they are, and with
    `SPARE` samples of latency more."""

    loops: list[_Sampled]
    later: list[_Sampled]

    @classmethod
    def of(cls, robot: Robot, poses: Sequence[np.ndarray], period: float, latency: int) -> _Checks:
        """At each pose (n,) the nominal robot and `ROBOTS` others."""
        plant, loops, later = robot.plant(), list[_Sampled](), list[_Sampled]()
        places, names = joint_places(plant), plant.parameters.names
        others = robot.random_corners(ROBOTS * len(poses), SEED)
        for k, pose in enumerate(poses):
            for values in (robot.plant_parameters(), *others[k * ROBOTS : (k + 1) * ROBOTS]):
                x, u = robot.operating_point(pose, parameters=values)
                row = np.concatenate([np.ravel(values[name]) for name in names])
                slopes = plant.traced_jacobians(x, u, np.zeros(len(plant.disturbances)), row)
                linear = np.asarray(slopes[0], dtype=float), np.asarray(slopes[1], dtype=float)
                loops.append(_Sampled.of(linear, places, period, latency))
                later.append(replace(loops[-1], latency=latency + SPARE))
        return cls(loops, later)

    def margins(self, gains: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[float, bool]:
        """Smallest damping ratio below `BELOW`, or of all where a mode grows; and whether all stay stable with more
        latency and with other gains."""
        poles = np.linalg.eigvals(np.array([loop.loop(gains) for loop in self.loops]))
        exponents = np.log(np.maximum(np.abs(poles), TINY)) + 1j * np.angle(poles)
        ratios, slow = -exponents.real / np.abs(exponents), np.abs(exponents) < BELOW * self.loops[0].period
        growing = bool((np.abs(poles) >= 1.0).any())
        least = float(ratios.min() if growing else np.min(ratios[slow], initial=1.0))
        if growing:
            return least, False
        proportional, derivative, cutoff = gains
        cases = [(self.later, 1.0), *((self.loops, gain) for gain in GAINS)]
        for loops, gain in cases:
            changed = gain * proportional, gain * derivative, cutoff
            if np.abs(np.linalg.eigvals(np.array([loop.loop(changed) for loop in loops]))).max() >= 1.0:
                return least, False
        return least, True


#: Modulus of poles below which they are taken for zero.
TINY = 1e-12
