"""Laws that depend on where they act: torque feedback with PD, and feedback linearisation.

Passivity-based torque feedback [albuschaeffer2007], [ott2008]: a rotor that feels lighter, then PD.

    τ = J J_θ⁻¹ u' + (I − J J_θ⁻¹) τ_J,   τ_J = K (θ − q) + D (θ̇ − q̇),
    u' = −K_θ (θ − θ_d) − D_θ θ̇ + ḡ(θ).

Feeding back the torque τ_J of the spring scales the rotor's inertia from J to J_θ: put into J θ̈ + B θ̇ + τ_J = τ it
gives J_θ θ̈ + (J_θ J⁻¹ B) θ̇ + τ_J = u'. The friction is scaled with it; nothing else changes, so the loop stays
passive. The torque is K (θ − q) + D (θ̇ − q̇) of the estimate, with the spring's numbers at the equilibrium.

The weight is compensated from the motor position alone, which passivity needs: ḡ(θ) = G(q̄(θ)), where q̄ is the link
position that would rest at θ, K (θ − q̄) = G(q̄). It is the fixed point of q̄ ← θ − K⁻¹ G(q̄), begun at θ; a fixed
number of turns, chosen from how fast it contracts. Or it is G(q_d), as in `flexhinf.baselines.MotorPD`.

PD control on the motor side with the goal's gravity compensated [tomei1991]: what most elastic robots run.

    τ = K_p (θ_d − θ) − K_d θ̇ + G(q_d),   θ_d = q_d + K⁻¹ G(q_d).

With energy E of links, rotors, springs and gravity, V = E + ½ (θ_d − θ)ᵀ K_p (θ_d − θ) + (θ_d − θ)ᵀ G(q_d) falls by
θ̇ᵀ (K_d + B) θ̇, so the goal is stable where it is the minimum of V's potential: where

    [ K + ∂G/∂q   −K      ]
    [ −K           K + K_p ]   is positive definite.

A voltage-driven motor gets V = (R/k_t) τ. Its back-EMF is **not** compensated: it is passive damping, k_t k_b/R, which
a compensation would take away with a velocity that is only estimated. `MotorPD.tuned` counts it as part of the wanted
damping. A drive with an inner loop gets c = (τ + k_p θ + (σ − 1) τ_J)/k_u: its own gains are a part of the wanted ones,
and the motor feels its load (`ElasticJoints.torque_driven`).

Exact feedback linearisation with flatness feedforward [spong1987], [deluca2016].

In the coordinates of the link positions and their derivatives (`NormalForm`) the input

    u = A(x)⁻¹ (v − b(x)),   v = y_d^(r) + Σ_i k_i (y_d^(i) − y^(i)) − k_I ∫ (y − y_d),

makes each joint's error a linear chain, e^(r) + Σ k_i e^(i) + k_I ∫ e = 0, whatever the other joints do. The
derivatives y^(i) are functions of the state, the reference's are those of its state x_d and, for the highest, its
input u_d. So a reference (x_d, u_d) that the elastic inverse dynamics gives is followed without error, and at an
equilibrium u = u*.

A plant in the coordinates of its own outputs: y, ẏ, ÿ … up to the derivative that the input reaches.

Each output is differentiated along ẋ = f(x, u) until u appears, after r_j turns (Lie derivatives, [isidori1995b]):

    y_j^(r_j) = b_j(x) + A_j(x) u.

Where A(x), the decoupling matrix, is invertible, u = A⁻¹ (v − b) makes it y_j^(r_j) = v_j: chains of integrators. For
elastic joints and their link positions r = 4 and A = M⁻¹ K J⁻¹ k_u [spong1987]; with damped springs r = 3.
The derivatives are exact, formed by CasADi from the plant's own flow.
"""

# Not checked strictly: parts of SciPy, CasADi and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownVariableType=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, Self, cast

import casadi as ca
import numpy as np

from flexhinf.arrays import Elements
from flexhinf.baselines.equilibrium_law import INTEGRAL_RATE, PlacedLaw, equilibrium_of
from flexhinf.codegen.dependence import linear
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant import GeneralisedPlant, Plant
from flexhinf.plant.joints import GravityTorque, elastic_joints
from flexhinf.scalars import apply, digest
from flexhinf.validation import checked_positive, real_array

#: What the fixed number of turns leaves of ḡ, relative to the weight.
LEFT = 1e-6
MOST_TURNS = 30
#: Poses at which the contraction is sampled, uniform in ±π, and the seed of them.
POSES, SEED = 200, 0


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TorqueFeedback(PlacedLaw):
    """Torque feedback and PD on the motor side; about a moving reference all in deviations from it.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`; one signal per joint is integrated: link_position or
        motor_position.
    rotor_inertia : float or (n,) array, optional
        J_θ, kg·m², as the motors shall feel; J as it is (the default) leaves the torque out.
    proportional, derivative, integral : float or (n,) array
        K_θ (N·m/rad), D_θ (N·m·s/rad) and K_i (N·m/(rad·s)) of u'.
    compensation : {"motor", "goal"}
        ḡ(θ) from the motor position, or the constant G(q_d).

    Raises `InvalidInput` if numbers do not fit, the goal would not be a minimum of the potential (K_θ too small for
    the gravity), or q̄ is no contraction.
    """

    rotor_inertia: Any = None
    proportional: Any
    derivative: Any
    integral: Any = 0.0
    compensation: str = "motor"

    def __post_init__(self) -> None:
        super().__post_init__()
        n, rotor = len(self.joints.stiffness), self.rotor_inertia
        gains = {name: getattr(self, name) for name in ("proportional", "derivative", "integral")}
        gains["rotor_inertia"] = self.joints.motor_inertia if rotor is None else rotor
        for name, value in gains.items():  # one finite number ≥ 0 per joint
            numbers = real_array(value)
            if numbers.shape not in ((), (1,), (n,)) or not np.all(np.isfinite(numbers) & (numbers >= 0.0)):
                raise InvalidInput(
                    f"The {name} gain does not fit the joints.",
                    f"expected a number >= 0, or {n} of them, got {value!r}",
                    "one gain per joint",
                )
            object.__setattr__(self, name, np.broadcast_to(numbers, (n,)).copy())
        if len(self.integrate) not in (0, n) or bool(len(self.integrate)) != bool(np.any(self.integral)):
            raise InvalidInput(
                "The integral gain and what is integrated do not fit each other.",
                f"expected {n} signals with gains, or neither, got {list(self.integrate)} and {self.integral.tolist()}",
                "integrate=('link_position',) and integral=..., or neither",
            )
        if not np.all(self.rotor_inertia > 0.0) or self.compensation not in ("motor", "goal"):
            raise InvalidInput(
                "Torque feedback cannot be made so.",
                "expected positive rotor inertias and compensation 'motor' or 'goal', "
                f"got {self.rotor_inertia.tolist()}, {self.compensation!r}",
                "rotor_inertia=0.25 * J, compensation='motor'",
            )
        if self.compensation == "motor":
            self.check_contraction()
            return
        stiffness, slope = np.diag(self.joints.stiffness), self.joints.gravity_slope
        potential = np.block([
            [stiffness + (slope + slope.T) / 2.0, -stiffness],
            [-stiffness, stiffness + np.diag(self.proportional)],
        ])  # fmt: skip
        smallest = float(np.linalg.eigvalsh(potential)[0])
        if smallest <= 0.0:  # with constant compensation it is no minimum [tomei1991]
            raise InvalidInput(
                "The goal is not a minimum of the potential: the robot would fall away from it.",
                f"expected [[K + dG/dq, -K], [-K, K + K_p]] positive definite, got an eigenvalue {smallest:.3g}",
                "a proportional gain larger than the slope of the gravity torque, or a stiffer joint",
            )

    @classmethod
    def tuned(
        cls,
        problem: GeneralisedPlant,
        bandwidth: float,
        damping: float = 0.7,
        inertia_ratio: float = 0.25,
        integral: str | None = None,
        integral_rate: float = INTEGRAL_RATE,
        **options: Any,
    ) -> Self:
        """Gains from a bandwidth and a damping ratio, as if the joints were rigid and moved one by one.

        I s² + (D_θ + B + k_t k_b/R) s + K_θ = I (s² + 2ζω s + ω²) with I = M_jj(q*) + J_θj; with an integral a further
        factor s + σ, σ = integral_rate · ω. D_θ is not made negative: a motor that damps itself by more than that keeps
        its damping. The spring is not seen: where ω nears √(K/I) the link's own bandwidth stays behind.

        Plant and equilibrium are the problem's; its penalty does not matter. `bandwidth`, `damping` and
        `inertia_ratio` are ω (rad/s), ζ and J_θ/J; `integral` is whose error is integrated, "link_position" or
        "motor_position"; `options` may have ``compensation``, see the class.
        """
        equilibrium = equilibrium_of(problem)
        joints = elastic_joints(problem.plant, *equilibrium)
        rotor = inertia_ratio * joints.motor_inertia
        inertia, friction = np.diag(joints.link_inertia) + rotor, inertia_ratio * joints.motor_damping
        checked_positive("The bandwidth", bandwidth, "rad/s", "bandwidth=6.0")
        checked_positive("The damping ratio", damping, "a number", "damping=0.7")
        rate = integral_rate if integral else 0.0
        if not (np.isfinite(rate) and rate >= 0.0):
            raise InvalidInput(
                "The rate of the integral is negative or not a number.",
                f"expected a share of the bandwidth, got {rate!r}",
                f"integral_rate={INTEGRAL_RATE}",
            )
        slow = rate * bandwidth
        return cls(
            plant=problem.plant,
            equilibrium=equilibrium,
            integrate=(integral,) if integral else (),
            rotor_inertia=rotor,
            proportional=inertia * (bandwidth**2 + 2.0 * damping * bandwidth * slow),
            derivative=np.maximum(0.0, inertia * (2.0 * damping * bandwidth + slow) - friction),
            integral=inertia * bandwidth**2 * slow,
            **options,
        )

    # The weight from the motor position -------------------------------------------------------------

    @cached_property
    def contraction(self) -> float:
        """Largest contraction ‖K^-½ ∂G/∂q K^-½‖ of the iteration for q̄, at the equilibrium and the sampled poses."""
        stiffness = self.joints.stiffness.tolist()
        return _contraction(
            self.plant, tuple(self.equilibrium[0][: len(stiffness)].tolist()), tuple(stiffness)
        )

    @cached_property
    def turns(self) -> int:
        """Number of iterations for q̄, such that ḡ is wrong by at most 1e-6 of the weight; at most `MOST_TURNS` + 1."""
        factor = max(self.contraction, LEFT)
        turns = np.ceil(np.log(LEFT) / np.log(factor)) - 1 if factor < 1.0 else np.inf
        return int(min(turns, MOST_TURNS + 1))

    def check_contraction(self) -> None:
        """Refuse springs that are so soft that the iteration for q̄ takes more than `MOST_TURNS` turns, or diverges."""
        refuse_if(
            self.turns > MOST_TURNS,
            "The link position cannot be found from the motor position by iteration.",
            f"expected springs stiffer than the gravity torque's slope, so that at most {MOST_TURNS} turns do; "
            f"got a contraction by {max(self.contraction, LEFT):.3g}",
            "compensation='goal', or stiffer joints",
        )

    def weight(self, theta: Elements, stiffness: Elements, p: Elements) -> Elements:
        """ḡ(θ), (n,), for motor positions (n,) and the parameter vector p, of any element."""
        q = theta
        for _ in range(self.turns):
            q = theta - self._weight.torque(q, p) / stiffness
        return self._weight.torque(q, p)

    # The law ----------------------------------------------------------------------------------------
    @cached_property
    def gain(self) -> np.ndarray:
        """The linear part, (n, states), in units of the input."""
        spring, scale = self.joints, self.joints.motor_inertia / self.rotor_inertia
        columns = [
            -(1.0 - scale) * spring.stiffness,
            -(1.0 - scale) * spring.spring_damping,
            (1.0 - scale) * spring.stiffness - scale * self.proportional,
            (1.0 - scale) * spring.spring_damping - scale * self.derivative,
            *([-scale * self.integral] if self.integrate else []),
        ]
        torques = np.hstack([np.diag(column) for column in columns])
        if spring.inner:
            torques[:, : 4 * len(scale)] += spring.torque_driven
        return torques / spring.torque_per_input[:, None]

    @property
    def numbers(self) -> np.ndarray:
        """Gain; with ḡ also its share in the input, the stiffness, and the plant's parameters."""
        if self.compensation == "goal":
            return self.gain.ravel()
        share = self.joints.motor_inertia / self.rotor_inertia / self.joints.torque_per_input
        return np.concatenate(
            [self.gain.ravel(), share, self.joints.stiffness, self.plant.parameters.vector()]
        )

    @property
    def law_key(self) -> str:
        """Key of the law's code: that of G, and the number of iterations."""
        goal = self.compensation == "goal"
        return (
            f"torque feedback, weight at the {'goal' if goal else f'motor {self.turns} {self._weight.key}'}"
        )

    def evaluate_about(self, x: Elements, state: Elements, input: Elements, data: Elements) -> Elements:
        """k (n,) for a deviation x from the reference, of any element."""
        n, end = len(self.input_names), self.gain.size
        k = data[:end].reshape(n, -1) @ x
        if self.compensation == "goal":
            return k
        share, stiffness, p = np.split(data[end : -self.plant.n - n], [n, 2 * n])
        motor, moved = state[2 * n : 3 * n], x[2 * n : 3 * n]
        return k + share * (self.weight(motor + moved, stiffness, p) - self.weight(motor, stiffness, p))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MotorPD(TorqueFeedback):
    """k(x) = −(K_p δθ + K_d δθ̇ + K_i e) in units of the input: torque feedback that leaves the torque out.

    `proportional`, `derivative` and `integral` are K_p, K_d and K_i; about a moving reference its θ̇_d counts too.
    """

    compensation: str = "goal"

    @classmethod
    def tuned(  # pyright: ignore[reportIncompatibleMethodOverride]  # the rotor stays as it is: no ratio
        cls,
        problem: GeneralisedPlant,
        bandwidth: float,
        damping: float = 0.7,
        integral: str | None = None,
        integral_rate: float = INTEGRAL_RATE,
    ) -> Self:
        """See `TorqueFeedback.tuned`, with the rotor as it is."""
        return super().tuned(problem, bandwidth, damping, 1.0, integral, integral_rate)


@lru_cache(maxsize=8)
def _contraction(plant: Plant, goal: tuple[float, ...], stiffness: tuple[float, ...]) -> float:
    # Gains have no part in it, so a search over them computes it once.
    n, p, weight = len(stiffness), plant.parameters.vector(), GravityTorque(plant)
    poses = np.random.default_rng(SEED).uniform(-np.pi, np.pi, (POSES, n))
    root = np.sqrt(stiffness)
    slopes = (
        np.column_stack([weight.torque_and_rate(q, unit, p)[1] for unit in np.eye(n)])
        for q in (np.array(goal), *poses)
    )
    return max(float(np.linalg.norm(slope / np.outer(root, root), 2)) for slope in slopes)


# Feedback linearisation --------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class NormalForm:
    """Outputs of a plant, states of it, with their derivatives; undisturbed, with the parameters as data.

    Refused are other numbers of outputs than inputs, an output that no input reaches, and inputs that do not enter
    linearly.
    """

    plant: Plant
    outputs: Sequence[str]
    degrees: tuple[int, ...] = field(init=False)  # relative degree r_j of each output

    def __post_init__(self) -> None:
        names = tuple(self.outputs)
        self.plant.check_continuous("normal form")
        if len(set(names)) != len(names) or len(names) != len(self.plant.inputs):
            raise InvalidInput(
                "A normal form needs as many outputs as inputs.",
                f"expected {len(self.plant.inputs)} distinct states, got {list(names)}",
                "one state per input, the link positions of a robot",
            )
        vars(self).update(outputs=names)
        vars(self).update(degrees=tuple(len(each) for each in self._derivatives[3]))

    @cached_property
    def _derivatives(self) -> tuple[ca.SX, ca.SX, ca.SX, list[list[ca.SX]], list[ca.SX]]:
        """x, u, p, and for each output its derivatives below r_j, and the r_j-th."""
        plant, places = self.plant, [self.plant.index(name) for name in self.outputs]
        x, u = ca.SX.sym("x", plant.n), ca.SX.sym("u", len(plant.inputs))
        p = ca.SX.sym("p", plant.parameters.size)
        rate = plant.traced_flow(x, u, ca.SX.zeros(len(plant.disturbances)), p)
        lower: list[list[Any]] = [[] for _ in places]
        top: list[Any] = [None for _ in places]
        current: ca.SX = x[places]
        open_: list[int] = list(range(len(places)))
        for _ in range(plant.n):
            following = ca.cse(ca.jtimes(current, x, rate))
            reached: Sequence[bool] = ca.which_depends(following, u, 1, True)
            for row, j in enumerate(open_):
                lower[j].append(current[row])
                if reached[row]:
                    top[j] = following[row]
            kept = [row for row in range(len(open_)) if not reached[row]]
            current = following[kept]
            open_ = [open_[row] for row in kept]
            if not open_:
                break
        if open_:
            raise InvalidInput(
                f"No input reaches {self.outputs[open_[0]]!r}, however often it is differentiated.",
                f"expected a relative degree of at most {plant.n} for each of {list(self.outputs)}",
                "states that the inputs move",
            )
        if not linear(ca.Function("top", [u, x, p], [ca.densify(ca.vertcat(*top))])):
            raise InvalidInput(
                "The inputs do not enter linearly.",
                f"in the derivatives of {list(self.outputs)}",
                "a model that is affine in its inputs",
            )
        return x, u, p, lower, top

    @cached_property
    def chains(self) -> ca.Function:
        """(x, u, p) → y, ẏ … below r_j of the first output, of the second …, (Σ r_j,), and y^(r) (m,)."""
        x, u, p, lower, top = self._derivatives
        below = ca.vertcat(*(derivative for each in lower for derivative in each))
        highest = ca.densify(ca.vertcat(*top))
        return ca.Function("chains", [x, u, p], [ca.densify(below), highest], {"cse": True})

    @cached_property
    def linearising(self) -> ca.Function:
        """(x, v, p) → u with y^(r) = v."""
        x, u, p, _, top = self._derivatives
        highest, v = ca.vertcat(*top), ca.SX.sym("v", u.numel())
        decoupling = ca.jacobian(highest, u)
        solved = ca.densify(ca.solve(decoupling, v - ca.substitute(highest, u, ca.SX.zeros(u.numel()))))
        return ca.Function("linearising", [x, v, p], [solved], {"cse": True})

    def coordinates(self, x: Elements, u: Elements, p: Elements) -> tuple[Elements, ...]:
        """(ξ, y^(r)): see `chains`; of any element, p the parameter vector."""
        return apply(self.chains, x, u, p)

    def input(self, x: Elements, v: Elements, p: Elements) -> Elements:
        """u (m,) with y^(r) = v (m,), of any element."""
        return apply(self.linearising, x, v, p)[0]

    def decoupling_matrix(self, x: np.ndarray) -> np.ndarray:
        """A(x), (m, m), at the nominal parameters."""
        states, u, p, _, top = self._derivatives
        matrix = ca.densify(ca.jacobian(ca.vertcat(*top), u))
        function = ca.Function("decoupling", [states, p], [matrix], {"cse": True})
        return np.asarray(function(x, self.plant.parameters.vector()), dtype=float)


#: Relative size of the smallest singular value of A(x*) that counts as zero.
SINGULAR = 1e-12


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FeedbackLinearisation(PlacedLaw):
    """Exact feedback linearisation, for any plant whose outputs have a vector relative degree.

    Parameters
    ----------
    plant, equilibrium, integrate
        See `flexhinf.baselines.equilibrium_law.EquilibriumLaw`; either no output is integrated or all are, in
        their order.
    coefficients : sequence of (r_j + 1,) or (r_j,) arrays
        Of each output: k_I (with integrals only), then k_0 … k_{r−1}, of s^r + k_{r−1} s^{r−1} + … .
    outputs : sequence of str
        States, single names or groups; the link positions by default.

    Raises `InvalidInput` if the numbers do not fit, A is singular at the equilibrium, or the loop is unstable there
    (poles that are not in the left half plane, or zero dynamics that are not).
    """

    coefficients: Sequence[Any]
    outputs: Sequence[str] = ("link_position",)

    def __post_init__(self) -> None:
        super().__post_init__()
        chains = tuple(np.array(chain, dtype=float) for chain in self.coefficients)
        extra = bool(self.integrate)
        vars(self).update(outputs=self.plant.expanded(self.outputs), coefficients=chains)
        if extra and self.integrate != self.outputs:
            raise InvalidInput(
                "Feedback linearisation integrates the errors of its outputs, all or none.",
                f"expected {list(self.outputs)} or nothing, got {list(self.integrate)}",
                "integrate=outputs, or integrate=()",
            )
        wanted = [(degree + extra,) for degree in self.form.degrees]
        shapes = [chain.shape for chain in chains]
        if shapes != wanted or not all(np.all(np.isfinite(chain)) for chain in chains):
            raise InvalidInput(
                "The coefficients do not fit the relative degrees.",
                f"expected finite numbers of shapes {wanted}, got {shapes}",
                "FeedbackLinearisation.tuned(problem, bandwidth)",
            )
        values = np.linalg.svd(self.form.decoupling_matrix(self.equilibrium[0]), compute_uv=False)
        if not np.all(np.isfinite(values)) or values[-1] <= SINGULAR * values[0]:
            raise InvalidInput(
                "The outputs cannot be decoupled: A(x) of y^(r) = b(x) + A(x) u is singular at the equilibrium.",
                f"expected singular values > 0, got {values.tolist()}",
                "other outputs, or another pose",
            )
        modes = np.linalg.eigvals(self.closed_loop())
        if modes.real.max() >= 0.0:
            hidden = len(self.state_names) - sum(len(chain) for chain in self.coefficients)
            raise InvalidInput(
                "The linearised loop is unstable at the equilibrium.",
                f"expected modes in the left half plane, got one at {modes[modes.real.argmax()]:.4g} 1/s; "
                f"{hidden} of the {len(modes)} modes are zero dynamics, which the law does not reach",
                "positive coefficients of a stable polynomial, and outputs with stable zero dynamics",
            )

    @staticmethod
    def tuned(
        problem: GeneralisedPlant,
        bandwidth: float,
        integral: bool = False,
        outputs: str | Sequence[str] = ("link_position",),
        integral_rate: float | None = None,
    ) -> FeedbackLinearisation:
        """Poles of a Bessel filter of this bandwidth, rad/s, for every output, see `bessel_coefficients`.

        The problem gives plant and equilibrium; its penalty does not matter. With an `integral` of the outputs' errors
        there is one more pole each: that of a filter of one order more, or of `integral_rate` σ/ω an own one at −σ
        beside the filter's poles. A bandwidth or a rate that is not positive is refused.
        """
        plant, names = problem.plant, problem.plant.expanded(outputs)
        degrees = NormalForm(plant, names).degrees
        apart = integral and integral_rate is not None
        chains = [bessel_coefficients(degree + (integral and not apart), bandwidth) for degree in degrees]
        if apart:  # (s^r + … + k_0)(s + pole)
            share = "a share of the bandwidth"
            pole = bandwidth * checked_positive(
                "The rate of the integral", integral_rate, share, "integral_rate=0.2"
            )
            chains = [np.concatenate([pole * k, [pole]]) + np.concatenate([[0.0], k]) for k in chains]
        return FeedbackLinearisation(
            plant=plant,
            equilibrium=equilibrium_of(problem),
            integrate=names if integral else (),
            coefficients=chains,
            outputs=names,
        )

    @cached_property
    def form(self) -> NormalForm:
        """The plant in the coordinates of its outputs."""
        return NormalForm(self.plant, self.outputs)

    @property
    def numbers(self) -> np.ndarray:
        """Coefficients, then the plant's parameters."""
        return np.concatenate([*self.coefficients, self.plant.parameters.vector()])

    @property
    def law_key(self) -> str:
        """Key of the law's code: the two maps, and whether there are integrals."""
        return self._key

    @cached_property
    def _key(self) -> str:
        codes = (digest(code) for code in (self.form.chains, self.form.linearising))
        return " ".join(["feedback linearisation", str(bool(self.integrate)), *codes])

    def evaluate_about(self, x: Elements, state: Elements, input: Elements, data: Elements) -> Elements:
        """k (m,) for a deviation x from the reference, of any element."""
        states, numbers = self.plant.n, data[: -self.plant.n - len(input)]
        p = numbers[sum(len(chain) for chain in self.coefficients) :]
        now = state + x[:states]
        xi, _ = self.form.coordinates(now, input, p)
        xi_d, v = self.form.coordinates(state, input, p)
        error, wanted, row, place = xi_d - xi, list[Elements](), 0, 0
        for j, degree in enumerate(self.form.degrees):
            total = v[j]
            if self.integrate:
                total, place = total - numbers[place] * x[states + j], place + 1
            total = total + numbers[place : place + degree] @ error[row : row + degree]
            wanted.append(total)
            row, place = row + degree, place + degree
        return self.form.input(now, np.array(wanted), p) - input


def bessel_coefficients(order: int, bandwidth: float) -> np.ndarray:
    """k_0 … k_{r−1} of s^r + … + k_0, the Bessel filter of order r with −3 dB at the bandwidth [thomson1949].

    Its step has less than 1 % of overshoot at any order. Shape (r,), rad/s to the power r − i. A bandwidth that is not
    positive is refused.
    """
    from scipy.signal import bessel

    width = checked_positive("The bandwidth of feedback linearisation", bandwidth, "rad/s", "bandwidth=6.0")
    _, poles, _ = cast(Any, bessel)(order, width, analog=True, output="zpk", norm="mag")
    return np.real(np.poly(poles))[:0:-1].copy()
