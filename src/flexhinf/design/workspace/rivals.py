"""The laws that a controller for a workspace is compared with: their gains at a pose, as their proponents make them.

All are linear about the moving reference, which has the feedforward of the inverse dynamics: with e the deviation from
it, Ω = diag(ω_j), M̄ = M(q_d) + J_θ and integral I = ∫ e_q,

    u' = −(1 + 2ζσ) Ω M̄ Ω e_θ − ((2ζ + σ) √Ω M̄ √Ω − (J_θ/J) B) ė_θ − σ Ω^1.5 M̄ Ω^1.5 I + ∂ḡ/∂θ e_θ,
    τ = (J/J_θ) u' + (1 − J/J_θ) K (e_θ − e_q) − 2ζ_v ω_v J (ė_θ − ė_q),

for one joint with a rigid spring the poles of (s² + 2ζ ω s + ω²)(s + σ ω). PD has J_θ = J and ζ_v = 0, and of M̄ the
diagonal at home, as it is set by hand; the others have all of it at the commanded pose. ḡ(θ) is the weight that a motor
at θ carries at rest. Joints that vibrate fast, ω_v, have no feedback of the torque, which the latency would turn round.

Flatness makes each link's error a chain, e⁗ + Σ a_i e^(i) + a_I I = 0: with K (w − z) the spring's torque, G' = ∂G/∂q

    τ = J K⁻¹ (M v + (K + G') z̈) + K (w − z) + B ẇ,    z̈ = M⁻¹ (K (w − z) − G' z),    v = −Σ a_i z^(i) − a_I I.

Its poles are those of a Bessel filter of order five, or three with the joint's own vibration left where it is, damped.
LQG minimises Σ |W² N e|² + |v W N ė|² + |½ W³ N I|² + |u / u_max|² of the sampled model, W the bandwidth and
N = (M + J) / τ_max: a deviation costs as much as the input with which a rigid robot of that bandwidth would meet it.

A joint's bandwidth is ω_j = (ω⁻⁴ + (share ω_own)⁻⁴)^-¼ with ω_own = √(K_j/M_jj), its vibration with the motor held.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from flexhinf.analysis.linear_loop import exponential
from flexhinf.arrays import Matrix, Vector
from flexhinf.baselines.placed_laws import bessel_coefficients
from flexhinf.baselines.posed_laws import GainsOnTheWay
from flexhinf.design.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.plant.joints import ElasticJoints, elastic_joints, joint_places

#: Damping ratio ζ of a PD, and rate σ of an integral in parts of ω, where the user states none.
DAMPING, INTEGRAL_RATE = 0.8, 0.4

#: Vibrations with a free motor, rad/s, from which on a joint has no feedback of the torque, and none of its rate.
TORQUE_FAST, RATE_FAST = 180.0, 400.0

#: Damping of a vibration that flatness leaves where it is; weights of velocities and integrals of an LQG.
LEFT, VELOCITY, INTEGRATED = 0.5, 3.0, 0.5

#: Poses whose gains are kept.
KEPT = 2000

#: Numbers of a law by name: one (1,), or one for each joint (n,).
Numbers = Mapping[str, Vector]


@dataclass(frozen=True)
class Rival:
    """How the gains of a law are made."""

    make: Callable[[PoseModel, Numbers], Matrix]  # (n, 5n): torques per e_q, ė_q, e_θ, ė_θ and I
    names: tuple[str, ...]  # numbers that a user may state
    variants: tuple[dict[str, float], ...]  # what else the search chooses from, at each bandwidth


@dataclass(frozen=True, eq=False)
class PoseModel:
    """The model at rest at a pose, of which the gains are made."""

    setup: WorkspaceSetup
    pose: Vector
    joints: ElasticJoints
    home: ElasticJoints
    elastic: np.ndarray  # (n,), which joints have a spring

    def bandwidths(self, numbers: Numbers, fixed: bool = False) -> Vector:
        """ω_j (n,), rad/s; by the inertia at home where gains are `fixed`."""
        m = self.home.link_inertia if fixed else self.joints.link_inertia
        wanted = np.broadcast_to(numbers.get("bandwidth", 1.0), len(self.pose)).astype(float)
        if "share" not in numbers:
            return wanted
        own = numbers["share"] * np.sqrt(self.joints.stiffness / np.diag(m))
        return np.where(self.elastic, (wanted**-4 + own**-4) ** -0.25, wanted)

    @property
    def turns(self) -> Vector:
        """ω_v (n,): vibrations with free motors, at home, rad/s."""
        k, m, rotor = self.home.stiffness, np.diag(self.home.link_inertia), self.home.motor_inertia
        return np.sqrt(k * (1.0 / m + 1.0 / rotor))


def _by_torque(model: PoseModel, numbers: Numbers, fixed: bool, weight: bool, integral: bool) -> Matrix:
    j, n = model.joints, len(model.pose)
    turns, w = model.turns, model.bandwidths(numbers, fixed)
    ratio = np.where(model.elastic & (turns < TORQUE_FAST), numbers.get("rotor_inertia", 1.0), 1.0)
    rotor = ratio * j.motor_inertia
    inertia = np.diag(np.diag(model.home.link_inertia)) if fixed else j.link_inertia
    inertia = inertia + np.diag(rotor)
    zeta = numbers.get("damping", DAMPING)
    rate = numbers.get("integral_rate", INTEGRAL_RATE) if integral else np.zeros(1)

    def scaled(power: float) -> Matrix:
        return inertia * np.outer(w, w) ** power

    friction = ratio * j.motor_damping
    p, d, i = scaled(1.0), scaled(0.5), scaled(1.5)
    p = _both(p, 1.0 + 2.0 * zeta * rate)
    d = _both(d, 2.0 * zeta + rate) - np.diag(friction)
    i = _both(i, np.broadcast_to(rate, n))
    if fixed:  # a motor that damps itself by more keeps its damping
        d = np.maximum(d, 0.0)
    p, d, i = (
        np.diag(np.broadcast_to(numbers[name], n).astype(float)) if name in numbers else found
        for name, found in (("kp", p), ("kd", d), ("ki", i))
    )
    if weight:
        slope = j.gravity_slope
        p = p - slope @ np.linalg.inv(np.eye(n) + slope / j.stiffness[:, None])
    scale = 1.0 / ratio
    soft = np.diag((1.0 - scale) * j.stiffness)
    rates = np.where(model.elastic & (turns < RATE_FAST), numbers.get("vibration_damping", 0.0), 0.0)
    damper = np.diag(2.0 * rates * turns * j.motor_inertia)
    rows = np.diag(scale)
    return np.hstack([-soft, damper, soft - rows @ p, -damper - rows @ d, -rows @ i])


def _both(matrix: Matrix, factor: Vector | float) -> Matrix:
    """The matrix with √factor on both sides, of one number or one for each joint."""
    root = np.sqrt(np.broadcast_to(factor, len(matrix)))
    return root[:, None] * matrix * root


def _by_flatness(model: PoseModel, numbers: Numbers, integral: bool) -> Matrix:
    j, n = model.joints, len(model.pose)
    refuse_if(
        not model.elastic.all(),
        "Flatness of this form needs a spring at each joint.",
        f"expected elastic joints, got rigid ones: {list(model.setup.robot.rigid)}",
        "--laws without flatness and flatness-i",
    )
    turns = np.sqrt(j.stiffness * (1.0 / np.diag(j.link_inertia) + 1.0 / j.motor_inertia))
    chains = []
    for w, turn in zip(model.bandwidths(numbers), turns):
        order = 4 + integral
        if numbers.get("vibration", 0.0):  # left where it is
            low = np.append(bessel_coefficients(order - 2, w), 1.0)[::-1]
            chain = np.polymul(low, (1.0, 2.0 * LEFT * turn, turn**2))[:0:-1]
        else:
            chain = bessel_coefficients(order, w)
        chains.append(chain if integral else np.append(0.0, chain))
    summed, *rates = np.array(chains).T
    m, slope, k = j.link_inertia, j.gravity_slope, np.diag(j.stiffness)
    z, dz, w, dw = np.eye(4 * n).reshape(4, n, 4 * n)
    inverse = np.linalg.inv(m)
    ddz, dddz = (inverse @ (k @ (b - a) - slope @ a) for a, b in ((z, w), (dz, dw)))
    v = -sum(a[:, None] * row for a, row in zip(rates, (z, dz, ddz, dddz)))
    soft = (j.motor_inertia / j.stiffness)[:, None]
    feedback = soft * (m @ v + (k + slope) @ ddz) + k @ (w - z) + j.motor_damping[:, None] * dw
    return np.hstack([feedback, -soft * m * summed])


def _by_lqg(model: PoseModel, numbers: Numbers) -> Matrix:
    from scipy.linalg import solve_discrete_are

    setup, n = model.setup, len(model.pose)
    plant, period = setup.model, setup.specification.period
    a, b, _, _ = plant.linearise(*setup.robot.operating_point(model.pose))
    f, g = exponential(a, b, period)
    f = np.block([[f, np.zeros((plant.n, n))], [period * np.eye(n), np.zeros((n, plant.n - n)), np.eye(n)]])
    g = np.vstack([g, np.zeros((n, n))])
    limit = setup.authority
    whole = model.joints.link_inertia + np.diag(model.joints.motor_inertia)
    whole = whole / (limit * model.joints.torque_per_input)[:, None]
    w = np.broadcast_to(numbers["bandwidth"], n)
    (q, dq, _, _), weights = joint_places(plant), np.zeros((3 * n, plant.n + n))
    weights[:n, q] = whole * w**2
    weights[n : 2 * n, dq] = VELOCITY * whole * w
    weights[2 * n :, plant.n :] = INTEGRATED * whole * w**3
    cost, small = np.diag(limit**-2.0), 1e-12 * np.eye(plant.n + n)
    try:
        p = solve_discrete_are(f, g, weights.T @ weights + small, cost)
    except np.linalg.LinAlgError as error:
        raise NumericalFailure(
            "There is no LQG at a pose.", f"{error}, at {model.pose.tolist()}", "--laws without lqg"
        ) from error
    return -np.linalg.solve(cost + g.T @ p @ g, g.T @ p @ f)


_SHARES = ({"share": 1.0}, {"share": 2.0}, {"share": 0.5})
_SLOW_INTEGRAL = {"integral_rate": 0.1}
_TORQUES = (
    {"share": 1.0, "rotor_inertia": 0.5, "vibration_damping": 0.42}, {"share": 1.0, "vibration_damping": 0.42},
    {"share": 1.0, "vibration_damping": 0.2},
)  # fmt: skip
_GAINS = ("bandwidth", "damping", "kp", "kd")
_INTEGRAL = ("integral_rate", "ki")
_OF_TORQUE = ("rotor_inertia", "vibration_damping")

#: By name, as in `flexhinf.design.laws`.
RIVALS = {
    "pd": Rival(partial(_by_torque, fixed=True, weight=False, integral=False), _GAINS, _SHARES),
    "pd-gravity": Rival(partial(_by_torque, fixed=True, weight=True, integral=False), _GAINS, _SHARES),
    "pid": Rival(
        partial(_by_torque, fixed=False, weight=False, integral=True),
        (*_GAINS, *_INTEGRAL),
        (*_SHARES, *({**each, **_SLOW_INTEGRAL} for each in _SHARES)),
    ),
    "torque": Rival(
        partial(_by_torque, fixed=False, weight=True, integral=False), (*_GAINS, *_OF_TORQUE), _TORQUES
    ),
    "torque-i": Rival(
        partial(_by_torque, fixed=False, weight=True, integral=True),
        (*_GAINS, *_INTEGRAL, *_OF_TORQUE),
        (*_TORQUES, *({**each, **_SLOW_INTEGRAL} for each in _TORQUES)),
    ),
    "flatness": Rival(
        partial(_by_flatness, integral=False), ("bandwidth",), ({"vibration": 0.0}, {"vibration": 1.0})
    ),
    "flatness-i": Rival(
        partial(_by_flatness, integral=True), ("bandwidth",), ({"vibration": 0.0}, {"vibration": 1.0})
    ),
    "lqg": Rival(_by_lqg, ("bandwidth",), ({},)),
}


def _arrays(numbers: Mapping[str, object]) -> Numbers:
    return {name: np.atleast_1d(np.asarray(x, dtype=float)) for name, x in numbers.items()}


def rival_law(setup: WorkspaceSetup, name: str, numbers: Mapping[str, object]) -> GainsOnTheWay:
    """The law of a name with these numbers, one or one for each joint, in the place of a setup's own law.

    Raises `InvalidInput` for a law that does not fit the robot.
    """
    plant, own = setup.model, _arrays(numbers)
    places, home = joint_places(plant), np.asarray(setup.robot.home, dtype=float)

    @lru_cache(KEPT)
    def at(pose: bytes) -> ElasticJoints:
        return elastic_joints(plant, *setup.robot.operating_point(np.frombuffer(pose)), rigid=True)

    @lru_cache(KEPT)
    def gains(pose: bytes) -> Matrix:
        q = np.frombuffer(pose)
        model = PoseModel(setup, q, at(pose), at(home.tobytes()), places[0] != places[2])
        found = RIVALS[name].make(model, own)
        if name == "lqg":  # of the states as they are, in units of the input
            return found
        n, slope = len(q), np.zeros((len(q), plant.n + len(q)))
        np.add.at(slope.T, places.ravel(), found[:, : 4 * n].T)
        slope[:, plant.n :] = found[:, 4 * n :]
        return slope / model.joints.torque_per_input[:, None]

    def gain(pose: Vector) -> Matrix:
        return gains(np.ascontiguousarray(pose, dtype=float).tobytes())

    integrate = setup.law.integrate
    return GainsOnTheWay(
        plant=plant, equilibrium=setup.robot.operating_point(home), integrate=integrate, gain=gain
    )


def home_bandwidths(setup: WorkspaceSetup, numbers: Mapping[str, object]) -> Vector:
    """ω_j (n,) of a law with these numbers at home, rad/s: what the springs leave of the stated bandwidth."""
    home = np.asarray(setup.robot.home, dtype=float)
    joints = elastic_joints(setup.model, *setup.robot.operating_point(home), rigid=True)
    places = joint_places(setup.model)
    return PoseModel(setup, home, joints, joints, places[0] != places[2]).bandwidths(_arrays(numbers))


def check_numbers(name: str, numbers: Mapping[str, object], joints: int) -> dict[str, tuple[float, ...]]:
    """The numbers that a user states for a law, each (1,) or (n,).

    Raises `InvalidInput` for a law without such numbers, for another name, length or sign, for what is no finite
    number, and for gains that are neither made of a bandwidth nor stated.
    """
    known, found = RIVALS[name].names, dict[str, tuple[float, ...]]()
    for key, value in numbers.items():
        refuse_if(
            key not in known,
            f"The law {name!r} has no number {key!r}.",
            f"expected some of {', '.join(known)}, got {key!r}",
            f"bandwidth = 20.0 in the table of {name}",
        )
        try:
            row = np.atleast_1d(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            row = np.full(1, np.nan)
        if row.shape not in ((1,), (joints,)) or isinstance(value, bool) or not np.all(np.isfinite(row)):
            raise InvalidInput(
                f"{key} of the law {name!r} does not fit the robot.",
                f"expected a finite number, or a list of {joints}, got {str(value)[:80]}",
                f"{key} = {[1.0] * joints}, in the order of the joints",
            )
        positive = key in ("bandwidth", "rotor_inertia")
        refuse_if(
            bool(np.any(row <= 0.0 if positive else row < 0.0)),
            f"{key} of the law {name!r} has the wrong sign.",
            f"expected {'positive numbers' if positive else 'numbers >= 0'}, got {row.tolist()}",
            "errors are fed back with the opposite sign already",
        )
        found[key] = tuple(row.tolist())
    whole = "bandwidth" in found or ({"kp", "kd"} <= {*found} and ("ki" in found or "ki" not in known))
    refuse_if(
        not whole,
        f"The gains of the law {name!r} are not all stated.",
        f"expected bandwidth, or {', '.join(key for key in known if key[0] == 'k')}; got {', '.join(found)}",
        "bandwidth = 20.0, in rad/s",
    )
    return found
