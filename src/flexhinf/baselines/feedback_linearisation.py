"""Exact feedback linearisation with flatness feedforward [spong1987], [deluca2016].

In the coordinates of the link positions and their derivatives (`flexhinf.baselines.feedback_linearisation`) the input

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

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from flexhinf.baselines.equilibrium_law import PlacedLaw, equilibrium_of
from flexhinf.errors import InvalidInput
from flexhinf.plant import GeneralisedPlant, Plant
from flexhinf.scalars import apply, digest
from flexhinf.scalars.trace import linear
from flexhinf.validation import checked_positive


@dataclass(frozen=True, eq=False)
class NormalForm:
    """Outputs of a plant, states of it, with their derivatives; undisturbed, with the parameters as data.

    Refused are other numbers of outputs than inputs, an output that no input reaches, and inputs that do not enter
    linearly.
    """

    plant: Plant
    outputs: Sequence[str]

    def __post_init__(self) -> None:
        names = tuple(self.outputs)
        object.__setattr__(self, "outputs", names)
        if len(set(names)) != len(names) or len(names) != len(self.plant.inputs):
            raise InvalidInput(
                "A normal form needs as many outputs as inputs.",
                f"expected {len(self.plant.inputs)} distinct states, got {list(names)}",
                "one state per input, the link positions of a robot",
            )
        for name in names:
            self.plant.index(name)
        _ = self._derivatives

    @cached_property
    def _derivatives(self) -> tuple[Any, Any, Any, list[list[Any]], list[Any]]:
        """x, u, p, and for each output its derivatives below r_j, and the r_j-th."""
        import casadi as ca

        plant = self.plant
        x, u = ca.SX.sym("x", plant.n), ca.SX.sym("u", len(plant.inputs))
        p = ca.SX.sym("p", plant.parameters.size)
        rate = plant.traced_flow(x, u, ca.SX.zeros(len(plant.disturbances)), p)
        places = [plant.index(name) for name in self.outputs]
        lower: list[list[Any]] = [[] for _ in places]
        top: list[Any] = [None for _ in places]
        current, open_ = x[places], list(range(len(places)))
        for _ in range(plant.n):
            following = ca.cse(ca.jtimes(current, x, rate))
            reached = ca.which_depends(following, u, 1, True)
            for row, j in enumerate(open_):
                lower[j].append(current[row])
                if reached[row]:
                    top[j] = following[row]
            kept = [row for row in range(len(open_)) if not reached[row]]
            current, open_ = following[kept], [open_[row] for row in kept]
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
                "The inputs do not enter linearly.", f"in the derivatives of {list(self.outputs)}",
                "a model that is affine in its inputs",
            )  # fmt: skip
        return x, u, p, lower, top

    @cached_property
    def degrees(self) -> tuple[int, ...]:
        """Relative degree r_j of each output."""
        return tuple(len(each) for each in self._derivatives[3])

    @cached_property
    def chains(self) -> Any:
        """(x, u, p) → y, ẏ … below r_j of the first output, of the second …, (Σ r_j,), and y^(r) (m,)."""
        import casadi as ca

        x, u, p, lower, top = self._derivatives
        below = ca.vertcat(*(derivative for each in lower for derivative in each))
        highest = ca.densify(ca.vertcat(*top))
        return ca.Function("chains", [x, u, p], [ca.densify(below), highest], {"cse": True})

    @cached_property
    def linearising(self) -> Any:
        """(x, v, p) → u with y^(r) = v."""
        import casadi as ca

        x, u, p, _, top = self._derivatives
        highest, v = ca.vertcat(*top), ca.SX.sym("v", u.numel())
        decoupling = ca.jacobian(highest, u)
        solved = ca.densify(ca.solve(decoupling, v - ca.substitute(highest, u, ca.SX.zeros(u.numel()))))
        return ca.Function("linearising", [x, v, p], [solved], {"cse": True})

    def coordinates(self, x: Any, u: Any, p: Any) -> tuple[Any, Any]:
        """(ξ, y^(r)): see `chains`; of any element, p the parameter vector."""
        xi, top = apply(self.chains, x, u, p)
        return xi, top

    def input(self, x: Any, v: Any, p: Any) -> Any:
        """u (m,) with y^(r) = v (m,), of any element."""
        return apply(self.linearising, x, v, p)[0]

    def decoupling_matrix(self, x: np.ndarray) -> np.ndarray:
        """A(x), (m, m), at the nominal parameters."""
        import casadi as ca

        states, u, p, _, top = self._derivatives
        matrix = ca.densify(ca.jacobian(ca.vertcat(*top), u))
        function = ca.Function("decoupling", [states, p], [matrix], {"cse": True})
        return np.asarray(function(x, self.plant.parameters.vector()), dtype=float)


#: Relative size of the smallest singular value of A(x*) that counts as zero.
SINGULAR = 1e-12


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FeedbackLinearisation(PlacedLaw):
    """The law above, for any plant whose outputs have a vector relative degree.

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
        object.__setattr__(self, "outputs", self.plant.expanded(self.outputs))
        chains = tuple(np.array(chain, dtype=float) for chain in self.coefficients)
        object.__setattr__(self, "coefficients", chains)
        extra = bool(self.integrate)
        if extra and self.integrate != self.outputs:
            raise InvalidInput(
                "Feedback linearisation integrates the errors of its outputs, all or none.",
                f"expected {list(self.outputs)} or nothing, got {list(self.integrate)}",
                "integrate=outputs, or integrate=()",
            )
        wanted, shapes = (
            [(degree + extra,) for degree in self.form.degrees],
            [chain.shape for chain in chains],
        )
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
        plant = problem.plant
        names = plant.expanded(outputs)
        degrees = NormalForm(plant, names).degrees
        if integral and integral_rate is not None:
            advice = "integral_rate=0.2"
            rate = checked_positive(
                "The rate of the integral", integral_rate, "a share of the bandwidth", advice
            )
            pole, chains = rate * bandwidth, []
            for degree in degrees:  # (s^r + … + k_0)(s + pole)
                k = bessel_coefficients(degree, bandwidth)
                chains.append(np.concatenate([pole * k, [pole]]) + np.concatenate([[0.0], k]))
        else:
            chains = [bessel_coefficients(degree + integral, bandwidth) for degree in degrees]
        return FeedbackLinearisation(
            plant=plant, equilibrium=equilibrium_of(problem), integrate=names if integral else (),
            coefficients=chains, outputs=names,
        )  # fmt: skip

    @cached_property
    def form(self) -> NormalForm:
        """The plant in the coordinates of its outputs."""
        return NormalForm(self.plant, self.outputs)

    @property
    def numbers(self) -> np.ndarray:
        """Coefficients, then the plant's parameters."""
        return np.concatenate([*self.coefficients, self.plant.parameters.vector()])

    @cached_property
    def law_key(self) -> str:
        """The code of the two maps, and whether there are integrals."""
        codes = (digest(code) for code in (self.form.chains, self.form.linearising))
        return " ".join(["feedback linearisation", str(bool(self.integrate)), *codes])

    def feedback(self, x: Any, state: Any, input: Any, numbers: Any) -> Any:
        """k (m,) for a deviation x from the reference, of any element."""
        states = self.plant.n
        p = numbers[sum(len(chain) for chain in self.coefficients) :]
        now = state + x[:states]
        xi, _ = self.form.coordinates(now, input, p)
        xi_d, v = self.form.coordinates(state, input, p)
        error, wanted, row, place = xi_d - xi, [], 0, 0
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
