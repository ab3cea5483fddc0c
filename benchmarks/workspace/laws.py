"""What is compared: rivals as their proponents would build them, tuned by one stated rule, and the product's laws.

A law is anything with the three methods of `Law`; `LAWS` says how each is made. All get the same reference with exact
feedforward (`goals.Reference`), encoders of links and motors or of motors alone, and know that their input acts one
sample later. Inputs are in the robot's own unit.

The rule of tuning: a rival with a share s gives joint j the bandwidth ω_j = s √(K_j / M_jj), a part of its own
vibration with the motor held, at home, and at most the first of `FASTEST`; `LAWS` lists what else may be chosen. Every
candidate is judged by six lines of the criterion, with its thresholds: damping, two extra delays and gain of the linear
loops at other poses, and ripple and all moves arriving in `TUNING` moves that are not those of the benchmark. The rival
gets the candidate that keeps most of these lines, then arrives most often, then has the smallest worst remaining error.
While none keeps all six, lower largest bandwidths are tried as well. A candidate that is unstable at one of the poses
keeps no line and is not driven; where all are, the one that is stable at most poses is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.linalg import solve_discrete_are

from benchmarks.workspace.arm import PERIOD, Arm
from benchmarks.workspace.goals import Reference
from benchmarks.workspace.linear import Linear, held, outputs

__all__ = [
    "FASTEST",
    "LAWS",
    "SHARES",
    "TUNING",
    "Choice",
    "DifferenceLaw",
    "FlatnessLaw",
    "Law",
    "Overcoming",
    "QuadraticLaw",
    "bandwidths",
]

#: Shares that are tried; moves that each is tried in, and the seed of their goals; largest bandwidths, rad/s.
SHARES, TUNING, TUNING_SEED = (0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.0, 2.5, 4.0), 8, 77
FASTEST = (120.0, 60.0, 30.0, 15.0)
#: Damping ratio of a PD, rate of an integral in parts of ω, what a new difference counts in the filtered velocity.
DAMPING, INTEGRAL, BLEND = 0.8, 0.4, 0.6
#: By torque feedback a rotor feels so much lighter; the torque is extrapolated by so many samples; its rate damps the
#: joint's own vibration by so much. Joints whose own vibration is faster than this, rad/s, have no feedback of the
#: torque, or of its rate: within the latency it would excite them.
LIGHTER, LEAD, TURNING = 0.5, 2.0, 0.42
TORQUE_FAST, RATE_FAST = 180.0, 400.0
#: Gains of a law with a filter are made anew every so many samples, while the command moves.
EVERY = 50
#: Kalman filter: noise of the encoders (rad, m); random torques each sample in parts of the limits, links and motors.
NOISE, TORQUES = 1e-5, ((0.005, 0.03), (0.0006, 0.01), (0.0025, 0.03))
#: Damping of a vibration that flatness leaves where it is.
LEFT = 0.5
#: Planned speed of a motor, rad/s (m/s), about which dry friction changes its sign.
SLOW = 2.5e-3
#: LQG: bandwidths, rad/s, weights of velocities, random torques of its filter, and the weight of the integral.
RATES, VELOCITIES, SPREADS, INTEGRATED = (
    (56.0, 40.0, 28.0, 20.0, 14.0), (3.0, 5.0), ((0.0025, 0.03), (0.0006, 0.01), (0.005, 0.005)), 0.5,
)  # fmt: skip


class Law(Protocol):
    """A controller, for the benchmark."""

    def start(self, q: np.ndarray) -> None:
        """Begin at rest at a pose, with the input that holds the model there."""
        ...

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """Input (n,) for the measured positions of links and motors (2n,), or of motors alone (n,)."""
        ...

    def linear(self, q: np.ndarray) -> Linear:
        """(A, B, C, D) of the sampled controller near rest at a pose, limits left out: y to u, deviations."""
        ...


def bandwidths(arm: Arm, share: float, fastest: float) -> np.ndarray:
    """ω_j (n,), rad/s, of the rule of tuning."""
    own = np.sqrt(arm.stiffness / np.diag(arm.inertia_matrix(arm.home)))
    return np.minimum(share * own, fastest)


class DifferenceLaw:
    """PD on the motors about the command, velocities by filtered differences; torque feedback; integral of the links.

        u' = −Ω M̄ Ω e_θ − (2ζ √Ω M̄ √Ω − B J_θ/J) ė_θ − 0.4 Ω^1.5 M̄ Ω^1.5 ∫ e,
        τ = (J / J_θ) u' + (1 − J / J_θ) K (e_θ − e_q)⁺ − 2ζ_v ω_v J (ė_θ − ė_q)

    e are deviations from the reference; Ω = diag(ω_j); M̄ is M(q) + J_θ at the commanded pose, or at home its diagonal.
    With J_θ = J there is no torque feedback; ⁺ is an extrapolation over the latency. ζ_v = `turning` feeds back the
    torque's rate, by which the joint's own vibration ω_v with a free motor, at home, is damped. The integral is in N·m,
    of the links' error, or of the motors' where links are not measured, and stands still for a joint whose motor is at
    its limit.
    """

    def __init__(
        self, arm: Arm, links: bool, share: float, fastest: float = FASTEST[0], *,
        matrix: bool = False, integral: bool = False, lighter: float = 1.0, turning: float = 0.0, blend: float = BLEND,
    ) -> None:  # fmt: skip
        self.arm, self.links, self.matrix, self.blend = arm, links, matrix, blend
        self.torque = links and (lighter != 1.0 or turning != 0.0)
        self.w, self.integral = bandwidths(arm, share, fastest), integral
        own = np.diag(arm.inertia_matrix(arm.home))
        turns = np.sqrt(arm.stiffness * (1.0 / own + 1.0 / arm.rotor))  # ω_v
        self.rotor = np.where(turns < TORQUE_FAST, lighter, 1.0) * arm.rotor  # J_θ
        self.scale = arm.rotor / self.rotor
        self.damper = np.where(turns < RATE_FAST, 2.0 * turning * turns, 0.0) * arm.rotor / arm.per_input
        unit, w = (self.scale / arm.per_input)[:, None], self.w
        #: M̄ times these, entry by entry, are the gains on e_θ, ė_θ and the sum of e T.
        self.weights = np.array(
            [
                unit * factor * np.outer(w, w) ** power
                for factor, power in ((1.0, 1.0), (2.0 * DAMPING, 0.5), (INTEGRAL * integral, 1.5))
            ]
        )
        self.friction, self.turn = np.diag(arm.viscous / arm.per_input), (1.0 - self.scale) / arm.per_input
        self.light, self.pose = np.diag(self.rotor), b""
        self.known = self.gains_of(np.diag(own + self.rotor))
        self.start(arm.home)

    def gains_of(self, inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gains (n, n) on e_θ, ė_θ and the sum of e T for M̄, in units of the input."""
        p, d, i = self.weights * inertia
        d = d - self.friction
        # A motor that damps itself by more keeps its damping.
        return p, d if self.matrix else np.maximum(d, 0.0), i

    def gains(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same at a commanded pose."""
        if self.matrix and self.pose != (pose := q.tobytes()):  # at rest they stay
            self.pose, self.known = pose, self.gains_of(self.arm.inertia_matrix(q) + self.light)
        return self.known

    def start(self, q: np.ndarray) -> None:
        """Begin at rest."""
        n = self.arm.n
        self.before: tuple[np.ndarray, np.ndarray] | None = None
        self.twist: np.ndarray | None = None
        self.velocity, self.sum = np.zeros((1 + self.torque) * n), np.zeros(n)

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """Input for a measurement."""
        arm, n, x = self.arm, self.arm.n, reference.state
        link, motor = y[:n] - x[:n], y[-n:] - x[2 * n : 3 * n]
        now = (y, np.concatenate((x[n : 2 * n], x[3 * n :]))) if self.torque else (y[-n:], x[3 * n :])
        before = self.before or now
        rate = (now[0] - before[0]) / PERIOD - 0.5 * (now[1] + before[1])  # no blow where the command jumps
        self.velocity = self.velocity + self.blend * (rate - self.velocity)
        self.before = now
        p, d, i = self.gains(x[:n])
        wish = reference.input - p @ motor - d @ self.velocity[-n:] - self.sum
        if self.torque:
            twist = motor - link
            late = twist if self.twist is None else self.twist
            self.twist = twist
            wish = wish + self.turn * arm.stiffness * (twist + LEAD * (twist - late))
            wish = wish - self.damper * (self.velocity[n:] - self.velocity[:n])
        u = arm.limited(wish)
        error = link if self.links else motor
        if self.integral:
            self.sum = self.sum + np.where(u == wish, PERIOD * (i @ error), 0.0)
        return u

    def linear(self, q: np.ndarray) -> Linear:
        """States: e before of what is differentiated, its filtered rate, and the integral, if there is, as an input."""
        n, unit, zero = self.arm.n, np.eye(self.arm.n), np.zeros((self.arm.n, self.arm.n))
        p, d, i = self.gains(q)
        motor = np.hstack([zero, unit]) if self.torque else unit
        twist = np.hstack([-unit, unit]) if self.torque else zero
        spring = np.diag(self.turn * self.arm.stiffness) @ twist
        rate, m = d @ motor + np.diag(self.damper) @ twist, motor.shape[1]
        a, b, c = np.zeros((2 * m + n, 2 * m + n)), np.zeros((2 * m + n, m)), np.zeros((n, 2 * m + n))
        a[m : 2 * m, : 2 * m] = np.hstack([-self.blend / PERIOD * np.eye(m), (1.0 - self.blend) * np.eye(m)])
        a[2 * m :, 2 * m :] = unit
        b[:m], b[m : 2 * m] = np.eye(m), self.blend / PERIOD * np.eye(m)
        c[:] = np.hstack([self.blend / PERIOD * rate - LEAD * spring, -(1.0 - self.blend) * rate, -unit])
        through = (1.0 + LEAD) * spring - p @ motor - self.blend / PERIOD * rate
        seen = np.eye(2 * n if self.links else n)  # what is differentiated, of what is measured
        b, through = b @ seen[-m:], through @ seen[-m:]
        b[2 * m :] = PERIOD * i @ seen[:n]
        size = 2 * m + self.integral * n
        return a[:size, :size], b[:size], c[:, :size], through


class FlatnessLaw:
    """Flatness: each link's error is made a chain of five poles with its integral, whatever the other joints do.

    With the robot frozen at the commanded pose, z = q − q_d, w = θ − θ_d: z̈ = M⁻¹ (K (w − z) − G' z), so

        z⁗ = v = −Σ a_i z^(i) − a_I ∫ z    for    τ = J K⁻¹ (M v + (K + G') z̈) + K (w − z) + B ẇ.

    The poles are five at −ω_j, or three and the joint's own vibration with a free motor, left where it is and damped.
    The state comes from a Kalman filter about the command at the commanded pose, with both encoders or motors alone,
    and is predicted to the sample at which the input acts.
    """

    def __init__(
        self, arm: Arm, links: bool, share: float, fastest: float = FASTEST[0], *,
        left: bool = False, torques: Sequence[float] = TORQUES[0],
    ) -> None:  # fmt: skip
        self.arm, self.links, self.left, self.torques = arm, links, left, torques
        self.w = bandwidths(arm, share, fastest)
        self.start(arm.home)

    def chain(self, m: np.ndarray) -> np.ndarray:
        """a_I, a_0 … a_3 of each joint, (5, n), for M(q)."""
        turns = np.sqrt(self.arm.stiffness * (1.0 / np.diag(m) + 1.0 / self.arm.rotor))
        found = []
        for w, turn in zip(self.w, turns):
            last = (1.0, 2.0 * LEFT * turn, turn**2) if self.left else np.poly([-w, -w])
            found.append(np.polymul(np.poly([-w] * 3), last)[:0:-1])
        return np.array(found).T

    def gains(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State feedback (n, 4n) and the integral's gain (n, n), in units of the input."""
        arm, n = self.arm, self.arm.n
        m, slope, k = arm.inertia_matrix(q), arm.gravity_slope(q), np.diag(arm.stiffness)
        rows = np.eye(4 * n)
        z, dz, w, dw = (rows[i * n : (i + 1) * n] for i in range(4))
        inverse = np.linalg.inv(m)
        ddz = inverse @ (k @ (w - z) - slope @ z)
        dddz = inverse @ (k @ (dw - dz) - slope @ dz)
        integral, *chain = self.chain(m)
        v = -sum(a[:, None] * row for a, row in zip(chain, (z, dz, ddz, dddz)))
        soft = (arm.rotor / arm.stiffness / arm.per_input)[:, None]
        unit = 1.0 / arm.per_input[:, None]
        feedback = soft * (m @ v + (k + slope) @ ddz) + unit * (k @ (w - z) + arm.viscous[:, None] * dw)
        return -feedback, soft * m * integral

    def model(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """F, G of one sample and the filter's gain at a pose."""
        arm, n = self.arm, self.arm.n
        a, b = arm.linear(q)
        f, g = held(a, b, PERIOD)
        push = np.zeros((4 * n, n))
        push[n : 2 * n] = np.linalg.inv(arm.inertia_matrix(q))
        limit = arm.per_input * arm.limit
        links, motors = self.torques
        spread = np.hstack([held(a, push, PERIOD)[1] * limit * links, g * arm.limit * motors])
        scale = np.tile(np.repeat([NOISE, NOISE / PERIOD], n), 2)
        c = outputs(n, self.links) * scale / NOISE
        fs, ws = f * scale / scale[:, None], spread / scale[:, None]
        p = solve_discrete_are(fs.T, c.T, ws @ ws.T + 1e-10 * np.eye(4 * n), np.eye(len(c)))
        gain = p @ c.T @ np.linalg.inv(c @ p @ c.T + np.eye(len(c)))
        return f, g, scale[:, None] * gain / NOISE

    def start(self, q: np.ndarray) -> None:
        """Begin at rest."""
        n = self.arm.n
        self.error, self.sent, self.sum = np.zeros(4 * n), np.zeros(n), np.zeros(n)
        self.count, self._made_at = 0, None
        self._begun_at: np.ndarray | None = q

    def _schedule(self, q: np.ndarray) -> None:
        if self._made_at is None or (self.count % EVERY == 0 and np.any(q != self._made_at)):
            self._made_at = q.copy()
            self._k, self._i = self.gains(q)
            self._f, self._g, self._l = self.model(q)
        self.count += 1

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """Correct, predict with the input that is on its way, feed back the prediction."""
        arm, n, x = self.arm, self.arm.n, reference.state
        self._schedule(x[:n])
        if self._begun_at is not None:  # a command may begin with a jump
            theta, held_there = arm.rest(self._begun_at)
            self.error = np.concatenate([self._begun_at, np.zeros(n), theta, np.zeros(n)]) - x
            self.sent, self._begun_at = held_there - reference.input, None
        seen = np.concatenate([x[:n], x[2 * n : 3 * n]]) if self.links else x[2 * n : 3 * n]
        mine = np.concatenate([self.error[:n], self.error[2 * n : 3 * n]])[-len(y) :]
        corrected = self.error + self._l @ (y - seen - mine)
        self.error = self._f @ corrected + self._g @ self.sent
        wish = reference.input - self._k @ self.error - self.sum
        u = arm.limited(wish)
        integrated = (y - seen)[:n] if self.links else corrected[:n]
        self.sum = self.sum + np.where(u == wish, PERIOD * (self._i @ integrated), 0.0)
        self.sent = u - reference.input
        return u

    def linear(self, q: np.ndarray) -> Linear:
        """States (predicted deviation, last input, the integral in units of the input)."""
        n = self.arm.n
        (k, i), (f, g, gain) = self.gains(q), self.model(q)
        c, zero, unit = outputs(n, self.links), np.zeros((n, n)), np.eye(n)
        stay = np.eye(4 * n) - gain @ c
        ahead, ahead_y = np.hstack([f @ stay, g, np.zeros((4 * n, n))]), f @ gain
        u = -k @ ahead - np.hstack([np.zeros((n, 5 * n)), unit])
        u_y = -k @ ahead_y
        pick = np.hstack([unit, np.zeros((n, 3 * n))])
        if self.links:
            error, error_y = np.zeros((n, 6 * n)), np.hstack([unit, zero])
        else:
            error, error_y = np.hstack([pick @ stay, np.zeros((n, 2 * n))]), pick @ gain
        kept = np.hstack([np.zeros((n, 5 * n)), unit])
        a = np.vstack([ahead, u, kept + PERIOD * i @ error])
        b = np.vstack([ahead_y, u_y, PERIOD * i @ error_y])
        return a, b, u, u_y


class QuadraticLaw(FlatnessLaw):
    """LQG with integral: the state feedback that minimises a quadratic cost of the sampled robot at the commanded pose.

        Σ |W² (M + J) e / τ_max|² + |v W (M + J) ė / τ_max|² + |½ W³ (M + J) ∫ e / τ_max|² + |u / u_max|²,    W = w

    with e of the links. So a deviation costs as much as the input with which a rigid robot of bandwidth w would meet
    it. Filter, prediction and integral are those of `FlatnessLaw`. Gains solve a Riccati equation of 5n states.
    """

    def __init__(
        self, arm: Arm, links: bool, w: float, velocity: float = VELOCITIES[0], torques: Sequence[float] = SPREADS[0],
    ) -> None:  # fmt: skip
        self.arm, self.links, self.bandwidth, self.velocity, self.torques = arm, links, w, velocity, torques
        self.start(arm.home)

    def gains(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """State feedback (n, 4n) and the integral's gain (n, n), in units of the input."""
        arm, n, w, unit = self.arm, self.arm.n, self.bandwidth, np.eye(self.arm.n)
        f, g = held(*arm.linear(q), PERIOD)
        f = np.block([[f, np.zeros((4 * n, n))], [PERIOD * unit, np.zeros((n, 3 * n)), unit]])
        g = np.vstack([g, np.zeros((n, n))])
        inertia = (arm.inertia_matrix(q) + np.diag(arm.rotor)) / (arm.limit * arm.per_input)[:, None]
        weights = np.zeros((3 * n, 5 * n))
        for k, (at, weight) in enumerate(((0, w**2), (1, self.velocity * w), (4, INTEGRATED * w**3))):
            weights[k * n : (k + 1) * n, at * n : (at + 1) * n] = weight * inertia
        cost = np.diag(arm.limit**-2.0)
        p = solve_discrete_are(f, g, weights.T @ weights + 1e-12 * np.eye(5 * n), cost)
        feedback = np.linalg.solve(cost + g.T @ p @ g, g.T @ p @ f)
        return feedback[:, : 4 * n], feedback[:, 4 * n :]


class Overcoming:
    """A law with feedforward of dry friction: F tanh((v / v₀)³) of each motor, by its planned speed v when the input
    acts. All of it from 4/3 v₀ on, so that a motor that comes in slowly does not stick before its goal."""

    def __init__(self, law: Law, arm: Arm) -> None:
        self.law, self.level, self.n = law, arm.dry / arm.per_input, arm.n

    def start(self, q: np.ndarray) -> None:
        """Begin at rest."""
        self.law.start(q)

    def step(self, y: np.ndarray, reference: Reference) -> np.ndarray:
        """Input for a measurement."""
        ratio = reference.ahead[3 * self.n :] / SLOW
        return self.law.step(
            y, reference._replace(input=reference.input + self.level * np.tanh(ratio * ratio * ratio))
        )

    def linear(self, q: np.ndarray) -> Linear:
        """That of the law: at rest it adds nothing."""
        return self.law.linear(q)


#: What a law is made with beside its robot and its sensors.
Numbers = dict[str, Any]


def _of_shares(*more: Numbers) -> tuple[list[Numbers], ...]:
    """Candidates with each largest bandwidth: all shares, each with every one of these."""
    return tuple(
        [{"share": share, "fastest": fastest} | one for one in more or ({},) for share in SHARES]
        for fastest in FASTEST
    )


@dataclass(frozen=True)
class Choice:
    """A law of the benchmark: how it is called, how it is made from the nominal robot, and what it needs."""

    title: str
    make: Callable[..., Law]  # (arm, links, **numbers), or (arm, links, folder) for what is designed
    #: What the rule of tuning chooses from; the next ones while none of those before keeps all lines.
    candidates: tuple[list[Numbers], ...] = ()
    needs_links: bool = False

    @property
    def tuned(self) -> bool:
        """Whether it is a rival."""
        return bool(self.candidates)


def _difference(**options: Any) -> Callable[..., Law]:
    return lambda arm, links, **numbers: DifferenceLaw(arm, links, **numbers, **options)


def _one_pose(arm: Arm, links: bool, folder: Any) -> Law:
    from benchmarks.workspace.product import OnePose

    return OnePose(arm, links, folder)


def _workspace(arm: Arm, links: bool, folder: Any) -> Law:
    from benchmarks.workspace.product import OverWorkspace

    return OverWorkspace(arm, links, folder)


#: By name, rivals first.
LAWS = {
    "pd": Choice("PD + gravity on motor encoders", _difference(), _of_shares()),
    "pd-integral": Choice(
        "PD + integral of the link, full M(q)", _difference(matrix=True, integral=True), _of_shares()
    ),
    "torque": Choice(
        "joint-torque feedback, gains by inertia, integral of the link",
        _difference(matrix=True, integral=True),
        _of_shares(
            {"lighter": LIGHTER, "turning": 0.0},
            {"lighter": LIGHTER, "turning": TURNING},
            {"lighter": 1.0, "turning": TURNING},
        ),
        needs_links=True,
    ),
    "flatness": Choice(
        "flatness, Kalman filter",
        FlatnessLaw,
        _of_shares(*({"left": left, "torques": pair} for left in (False, True) for pair in TORQUES)),
    ),
    "lqg": Choice(
        "LQG with integral, solved at each pose",
        QuadraticLaw,
        (
            [
                {"w": w, "velocity": velocity, "torques": pair}
                for w in RATES
                for velocity in VELOCITIES
                for pair in SPREADS
            ],
        ),
    ),
    "one-pose": Choice("flexhinf, law of one pose (home)", _one_pose),
    "workspace": Choice("flexhinf, law for the workspace", _workspace),
}  # fmt: skip
