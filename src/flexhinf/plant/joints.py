"""Elastic joints of a plant: their numbers at an equilibrium, gravity torque and M⁻¹, from its exact Jacobians.

At rest M(q1) q̈1 + C q̇1 + G = K(q2 − q1) + D(q̇2 − q̇1) + d_link and J q̈2 + B q̇2 + K(q2 − q1) + D(q̇2 − q̇1) =
k_u u + d_motor, Eq. (2), are read off ẋ = A x + B u + G d: what the motors feel of d_motor is J⁻¹, what the links
feel of d_link is M⁻¹. Whatever the model adds (a damped or hardening spring, a back-EMF) is in the numbers.

The gravity torque is taken from the flow too. At rest and with its springs relaxed (q2 = q1) a robot falls by
q̈1 = −M⁻¹ G, and a torque at the links moves it by M⁻¹, so G = −(∂q̈1/∂d_link)⁻¹ q̈1 is exact for any plant of elastic
joints.

A rigid joint has no motor of its own: q2 = q1, and its row is (M(q1) + J) q̈1 + …, J the parameter ``motor_inertia``. A
law of springs may take it for a joint with a spring of the motors' common frequency, K = κ J: `elastic_joints`.

Of coupled joints, θ = T q, all numbers are those at the outputs of the gears, φ = T q1: with T⁻ᵀ M T⁻¹ for M, T⁻ᵀ G for
G, and so on, they are the equations above with φ in the place of q1. A law or a filter that allows for a coupling takes
φ for the links' positions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant.plant import Plant
from flexhinf.scalars import apply, digest

STATES = ("link_position", "link_velocity", "motor_position", "motor_velocity")
TORQUES = ("link_torque", "motor_torque")

#: Coupling between the motors of different joints, relative to their own numbers, that counts as none.
COUPLING = 1e-9

#: Range of a joint that turns and states none, ±, rad.
TURN = np.pi


def joint_ranges(joints: Sequence[str], slides: Sequence[bool], limits: np.ndarray) -> np.ndarray:
    """Lower and upper ends (2, n) of where joints go, rad or m: their limits (2, n), infinite without; ±180° for one
    that turns and has none.

    Raises `InvalidInput` for a joint that slides and has none.
    """
    low, high = limits
    for joint, sliding, free in zip(joints, slides, ~np.isfinite(high - low)):
        refuse_if(
            sliding and free,
            f"Joint {joint!r} slides and has no range, so the workspace has no end.",
            "expected its limits in the robot's file, got none",
            "lower and upper limits of the joint, --workspace with a range for each joint, or --pose for one pose",
        )
    return np.array([np.where(np.isfinite(low), low, -TURN), np.where(np.isfinite(high), high, TURN)])


class ElasticJoints(NamedTuple):
    """Numbers of n elastic joints at an equilibrium, seen from the link side, in SI units; (n,) but for the first
    two."""

    link_inertia: np.ndarray  # M(q*), (n, n)
    gravity_slope: np.ndarray  # ∂G/∂q, (n, n)
    stiffness: np.ndarray  # K of the springs as they are there
    spring_damping: np.ndarray  # D
    motor_inertia: np.ndarray  # J
    motor_damping: (
        np.ndarray
    )  # B, the back-EMF's k_t k_b / R included, or an inner loop's torque per velocity
    torque_per_input: (
        np.ndarray
    )  # k_t / R, N·m/V, for a voltage; k_t, N·m/A, for a current; 1 for a torque; see elastic
    load_share: np.ndarray  # share of the spring's torque that moves the motor, 1 without an inner loop
    drive_stiffness: np.ndarray  # torque per motor position of an inner loop, N·m/rad; 0 without

    @property
    def inner(self) -> bool:
        """Whether drives have an inner loop."""
        return bool(np.any(self.drive_stiffness > 0.0) or np.any(self.load_share != 1.0))

    @property
    def torque_driven(self) -> np.ndarray:
        """Torques (n, 4n) per q, q̇, θ, θ̇ that make a drive with an inner loop one of torques τ.

        J θ̈ + B θ̇ + k_p θ + σ τ_J = k_u c is J θ̈ + B θ̇ + τ_J = τ by c = (τ + these)/k_u. Zero without an inner loop.
        """
        kept = self.load_share - 1.0
        columns = -kept * self.stiffness, -kept * self.spring_damping
        loop = self.drive_stiffness + kept * self.stiffness, kept * self.spring_damping
        return np.hstack([np.diag(column) for column in (*columns, *loop)])

    @property
    def pair_rates(self) -> tuple[float, float, float, float]:
        """κ and β of the motors as if they were alike, ν and b of their drives; 1/s², 1/s, 1/s², 1/s².

        κ and b are geometric means, β and ν are means. κ = b without an inner loop.
        """
        inertia = self.motor_inertia
        gain = float(np.exp(np.log(self.stiffness / inertia).mean()))
        share = 1.0
        if np.any(self.load_share != 1.0):
            share = float(np.exp(np.log(self.load_share).mean())) if np.all(self.load_share > 0.0) else 0.0
        damping = float((self.motor_damping / inertia).mean())
        return share * gain, damping, float((self.drive_stiffness / inertia).mean()), gain


def check_joints(plant: Plant) -> int:
    """Number of elastic joints n of a plant with their states, 4n in the order of Eq. (2), and one input each; one of
    other states, inputs or disturbances is refused."""
    names = tuple(single for name in STATES for single in plant.expanded(name))
    torques = [single for name in TORQUES for single in plant.expanded(name)]
    fits = tuple(plant.states) == names and len(names) == 4 * len(plant.inputs)
    if not fits or not set(torques) <= set(plant.disturbances):
        raise InvalidInput(
            "The plant is not a robot with elastic joints as this law needs it.",
            f"expected the states {list(names)}, one input per joint and the disturbances {torques}, "
            f"got {list(plant.states)}, {list(plant.inputs)}, {list(plant.disturbances)}",
            "robot.plant() of a robot without rigid joints, and without the coils' inductance",
        )
    return len(plant.inputs)


def coupling_of(plant: Plant) -> np.ndarray | None:
    """T (n, n) of a robot's plant whose motors move more than their own joints; None of any other."""
    return np.array(plant.coupling, dtype=float) if plant.coupling else None


def joint_places(plant: Plant) -> np.ndarray:
    """Places (4, n) of q1, q̇1, q2, q̇2 in the state of a plant of elastic and rigid joints, q2 = q1 of a rigid one; a
    plant of other states is refused."""
    rows: list[Sequence[str]] = []
    for link, motor in zip(STATES[:2], STATES[2:]):
        links = plant.expanded(link)
        own = [name.replace(link, motor, 1) for name in links]
        rows += [links, [name if name in plant.states else at for name, at in zip(own, links)]]
    if {name for row in rows for name in row} != set(plant.states) or len(rows[0]) != len(plant.inputs):
        check_joints(plant)
    return np.array([[plant.index(name) for name in rows[i]] for i in (0, 2, 1, 3)])


def elastic_joints(
    plant: Plant, x: np.ndarray, u: np.ndarray, rigid: bool = False, coupled: bool = False
) -> ElasticJoints:
    """The joints' numbers at the equilibrium (x, u), (states,) and (n,).

    `rigid`: whether rigid joints are taken for springs of K = κ J, κ the geometric mean of K/J of the others; refused
    otherwise, as is a plant without joints. `coupled`: whether numbers at the outputs of gears are meant where joints
    are coupled; refused otherwise.
    """
    if not rigid:
        check_joints(plant)
    (q, dq, theta, dtheta), (a, b, g, _) = joint_places(plant), plant.linearise(x, u)
    own, alone = theta != q, theta == q
    links, motors = _places(plant, "link_torque"), _places(plant, "motor_torque")
    if (turned := coupling_of(plant)) is not None:
        refuse_if(
            not coupled,
            "This law is one of joints that a motor of their own moves, and the joints are coupled.",
            f"expected a robot without coupling, got θ = T q with {turned.tolist()}",
            "the law of a workspace, or the H∞ law of a pose",
        )
        change = np.eye(plant.n)
        for rows in (q, dq):
            change[np.ix_(rows, rows)] = turned
        a, b, g = change @ a @ np.linalg.inv(change), change @ b, change @ g
        g[:, links] = g[:, links] @ turned.T

    def diagonal(what: str, matrix: np.ndarray) -> np.ndarray:
        single = np.diag(matrix).copy()
        if np.abs(matrix - np.diag(single)).max(initial=0.0) > COUPLING * np.abs(single).max(initial=0.0):
            raise InvalidInput(
                "The motors of different joints are coupled, and no coupling is stated.",
                f"expected a {what} of each joint alone, got {matrix.tolist()}",
                "coupling = { … } in [[joint]] of a robot file",
            )
        return single

    values = plant.parameters.values
    share, held = (
        np.broadcast_to(values.get(name, other), len(q)).astype(float)
        for name, other in (("load_share", 1.0), ("drive_stiffness", 0.0))
    )
    total = np.linalg.inv(g[np.ix_(dq, links)])  # M, with the rotors of rigid joints
    inertia, stiffness, damping, friction, per_input = np.zeros((5, len(q)))
    inertia[own] = 1.0 / diagonal("motor inertia", g[np.ix_(dtheta, motors)][np.ix_(own, own)])
    stiffness[own] = inertia[own] * diagonal("stiffness", a[np.ix_(dtheta, q)][np.ix_(own, own)])
    damping[own] = inertia[own] * diagonal("spring damping", a[np.ix_(dtheta, dq)][np.ix_(own, own)])
    if np.any(share != 1.0):  # the motors do not feel the whole spring: the links do
        stiffness[own] = diagonal("stiffness", (total @ a[np.ix_(dq, theta)])[np.ix_(own, own)])
        damping[own] = diagonal("spring damping", (total @ a[np.ix_(dq, dtheta)])[np.ix_(own, own)])
    slopes = diagonal("motor damping", a[np.ix_(dtheta, dtheta)][np.ix_(own, own)])
    friction[own] = -inertia[own] * slopes - share[own] * damping[own]
    per_input[own] = inertia[own] * diagonal("input", b[dtheta][np.ix_(own, own)])
    slope = -total @ a[np.ix_(dq, q)] - np.diag(stiffness)
    if alone.any():
        inertia[alone] = values["motor_inertia"][alone]
        stiffness[alone] = np.exp(np.log(stiffness[own] / inertia[own]).mean()) * inertia[alone]
        friction[alone] = -np.diag(total @ a[np.ix_(dq, dq)])[alone]
        per_input[alone] = np.diag(total @ b[dq])[alone]
    mass = (total + total.T) / 2.0 - np.diag(np.where(alone, inertia, 0.0))
    return ElasticJoints(mass, slope, stiffness, damping, inertia, friction, per_input, share, held)


def _places(plant: Plant, torque: str) -> list[int]:
    return [plant.disturbances.index(name) for name in plant.expanded(torque)]  # type: ignore[union-attr]


def _static(plant: Plant, name: str, quantity: Callable[[ca.SX, ca.SX], ca.SX]) -> ca.Function:
    """(q, parameter vector) → quantity(q̈1, M⁻¹) at rest with relaxed springs, as a CasADi function; without the rotors
    of rigid joints."""
    plant.check_continuous("elastic joints")
    places = joint_places(plant)
    q, p = ca.SX.sym("q", places.shape[1]), ca.SX.sym("p", plant.parameters.size)
    d, x, numbers = ca.SX.sym("d", len(plant.disturbances)), ca.SX.zeros(plant.n), ca.SX(p)
    turned = coupling_of(plant)
    x[places[2].tolist()] = q if turned is None else ca.mtimes(turned, q)
    x[places[0].tolist()] = q
    if (alone := places[2] == places[0]).any():
        rotors = plant.parameters.named(np.arange(plant.parameters.size)).motor_inertia[alone]
        numbers[rotors.tolist()] = 0.0
    still = ca.SX.zeros(len(plant.inputs))
    fall = plant.traced_flow(x, still, d, numbers)[places[1].tolist()]
    compliance = ca.jacobian(fall, d)[:, _places(plant, "link_torque")]
    if turned is not None:
        fall, compliance = ca.mtimes(turned, fall), ca.mtimes([turned, compliance, turned.T])
    free = ca.substitute(quantity(fall, compliance), d, ca.SX.zeros(d.numel()))
    return ca.Function(name, [q, p], [ca.densify(free)], {"cse": True})


class LinkCompliance:
    """M(q)⁻¹ of a plant of elastic and rigid joints (another is refused), on any element, with the plant's parameters
    as data; without rotors."""

    def __init__(self, plant: Plant) -> None:
        self.traced = _static(plant, "compliance", lambda fall, compliance: ca.vec(compliance))

    def matrix(self, q: Elements, p: Elements) -> Elements:
        """M(q)⁻¹ (n, n): the accelerations q̈1 per torque at the links, at the parameter vector p; T M⁻¹ Tᵀ of
        coupled joints."""
        return apply(self.traced, q, p)[0].reshape(len(q), -1)


@lru_cache(16)
def link_compliance(plant: Plant) -> LinkCompliance:
    """M(q)⁻¹ of a plant, traced once for its laws and filters."""
    return LinkCompliance(plant)


def _holding(rates: ca.SX, x: ca.SX, at: ca.SX, u: ca.SX) -> ca.SX:
    """Inputs with which the motors, with these rates, rest at a state."""
    per_input = ca.diag(ca.jacobian(rates, u))
    still = ca.substitute(rates, ca.vertcat(x, u), ca.vertcat(at, ca.SX.zeros(u.numel())))
    return -still / per_input


def standstill_function(plant: Plant) -> ca.Function | None:
    """(q, parameter vector) → (x, u), (states + n,), at rest at link positions q: q2 = T q1 + K⁻¹ T⁻ᵀ G and the input
    that holds G, as a CasADi function. None where G and K are not read off the flow at relaxed springs: it has other
    states than elastic and rigid joints, or springs that are not linear.

    As in `elastic_joints`, q̈1 = −C G with C of the links' torques, and the motors' rates have J⁻¹, K/J and k_u/J.
    """
    try:
        plant.check_continuous("elastic joints")
        links, falls, motors, rates = (row.tolist() for row in joint_places(plant))
    except InvalidInput:
        return None
    q, p, x, u = (
        ca.SX.sym(name, size)
        for name, size in zip("qpxu", (len(links), plant.parameters.size, plant.n, len(links)))
    )
    d, at = ca.SX.sym("d", len(plant.disturbances)), ca.SX.zeros(plant.n)
    flow = plant.traced_flow(x, u, d, p)
    inner = "load_share" in plant.parameters.values  # drives with a loop of their own
    springs = [(rate, motor) for rate, motor, link in zip(rates, motors, links) if motor != link]
    if any(any(ca.which_depends(flow[rate], x[motor], 2)) for rate, motor in springs):
        return None
    per_torque, per_twist, per_input = (
        ca.diag(ca.jacobian(flow[rates], z)) for z in (d[_places(plant, "motor_torque")], x[motors], u)
    )
    compliance = ca.jacobian(flow[falls], d[_places(plant, "link_torque")])
    held, moved = -ca.ldl_solve(flow[falls], *ca.ldl(compliance)), q
    turned = coupling_of(plant)
    if turned is not None:
        held, moved = ca.mtimes(np.linalg.inv(turned).T, held), ca.mtimes(turned, q)
    if inner:  # the motors may feel only a part of the spring, and are held where they are
        twisting = ca.jacobian(flow[falls], x[motors])
        pushed = ca.ldl_solve(twisting, *ca.ldl(compliance))
        stiffness = ca.diag(pushed if turned is None else ca.mtimes(np.linalg.inv(turned).T, pushed))
        at[motors] = moved + held / stiffness
    else:
        at[motors] = moved - held * per_torque / per_twist
    at[links] = q  # of a rigid joint too
    every = ca.vertcat(at, _holding(flow[rates], x, at, u) if inner else held * per_torque / per_input)
    relaxed = ca.SX.zeros(plant.n)
    relaxed[motors] = moved
    relaxed[links] = q
    still = ca.vertcat(relaxed, ca.SX.zeros(u.numel() + d.numel()))
    return ca.Function(
        "rest", [q, p], [ca.densify(ca.substitute(every, ca.vertcat(x, u, d), still))], {"cse": True}
    )


@dataclass(frozen=True, eq=False)
class GravityTorque:
    """G(q1) of a plant of elastic joints (another is refused), on any element, with the plant's parameters as data."""

    plant: Plant

    def __post_init__(self) -> None:
        check_joints(self.plant)

    @cached_property
    def traced(self) -> ca.Function:
        """(q, parameter vector) → G as a CasADi function."""
        return _static(self.plant, "gravity", lambda fall, compliance: -ca.solve(compliance, fall))

    @cached_property
    def _with_rate(self) -> ca.Function:
        n = len(self.plant.inputs)
        q, dq, p = ca.SX.sym("q", n), ca.SX.sym("dq", n), ca.SX.sym("p", self.plant.parameters.size)
        torque = self.traced(q, p)
        rate = ca.densify(ca.jtimes(torque, q, dq))
        return ca.Function("gravity_rate", [q, dq, p], [torque, rate], {"cse": True})

    def torque(self, q: Elements, p: Elements) -> Elements:
        """G(q), (n,), N·m, at the parameter vector p."""
        return apply(self.traced, q, p)[0]

    def torque_and_rate(self, q: Elements, dq: Elements, p: Elements) -> tuple[Elements, ...]:
        """G(q) and its rate ∂G/∂q q̇, (n,) each."""
        return apply(self._with_rate, q, dq, p)

    @cached_property
    def key(self) -> str:
        """Key of the code of a gravity torque."""
        return digest(self.traced)
