"""The laws that can be compared, by name: description, sensors, tuned parameters, and construction of each.

The help of the command line has their names from here, so what needs a synthesis is imported late.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

from flexhinf.validation import late_package, unknown_name

if TYPE_CHECKING:
    import numpy as np

    from flexhinf.design.synthesis.steps import Synthesis
    from flexhinf.plant import GeneralisedPlant, Law
else:
    np = late_package("numpy")

#: The design's own law as `flexhinf design` makes it, the reference of the criterion. It is not tuned for the
#: criterion, so it is not ranked; the next one is.
DESIGN = "design"

#: The nonlinear H∞ law, tuned for the criterion as every other law is.
NL_HINF = "nl-hinf"

#: Names of the parameters of a law's estimator: a factor of R^v, and another factor of its level on the velocities of
#: the motors.
ESTIMATOR_NOISE, MOTOR_NOISE = "estimator_noise", "motor_noise"

#: Name of the parameter that is a whole number: the degree of V, up to the largest that the design tries.
DEGREE = "degree"

#: Name of the parameter that is the size of the channels of the tolerances, of the preset robust: a fraction.
CHANNELS = "tolerance_channels"

#: Ends of three ranges: the γ/γ* from which the disturbance is left out (γ = ∞; its weight is then below 1/400 of that
#: at γ*), the size below which there are no channels, and the weight below which velocities have no penalty. So
#: nonlinear H∞ includes the nonlinear LQR and the design's own problem.
INFINITE_GAMMA, NO_CHANNELS, NO_VELOCITY = 20.0, 0.01, 1e-4

#: Values at which a law equals one without these parameters: the real rotor, hardly an integral, γ = ∞, no channels.
CONTAINED = {
    "rotor_inertia": 1.0, "integral_rate": 0.02, "gamma_ratio": INFINITE_GAMMA, CHANNELS: NO_CHANNELS,
}  # fmt: skip

#: A value within this fraction of the end of its range counts as the end.
ROUNDING = 1e-9

#: Largest degree of V in a name such as ``nl-hinf-4``.
LARGEST_DEGREE = 12


@dataclass(frozen=True)
class TuningParameter:
    """One number that is tuned, on a logarithmic scale."""

    name: str
    label: str
    unit: str
    start: float | None  # of the search; None where `LawFactory.start` has it
    lower: float
    upper: float
    relative: bool = False  # whether the bounds are factors of the start


_PARAMETERS = {
    parameter.name: parameter
    for parameter in (
        TuningParameter("bandwidth", "bandwidth", "rad/s", None, 0.1, 20.0, True),
        TuningParameter("damping", "damping ratio", "", 1.0, 0.3, 5.0),
        TuningParameter("integral_rate", "integral's pole / bandwidth", "", None, 0.02, 2.0),
        TuningParameter("rotor_inertia", "rotor inertia felt / real", "", 0.25, 0.05, 1.0),
        TuningParameter("effort", "weight of the input, R2 ×", "", 1.0, 1e-4, 1e3),
        TuningParameter("integral_weight", "weight of the integrals ×", "", 1.0, 0.02, 20.0),
        TuningParameter(
            "velocity_weight", f"weight of velocities / positions ({NO_VELOCITY:g}: none)", "s", 0.01, NO_VELOCITY, 1.0
        ),
        TuningParameter("gamma_ratio", f"γ/γ* ({INFINITE_GAMMA:g}: ∞)", "", None, 1.02, INFINITE_GAMMA),
        TuningParameter(
            CHANNELS, f"channels of the tolerances × ({NO_CHANNELS:g}: none)", "", 1.0, NO_CHANNELS, 1.0
        ),
        TuningParameter(ESTIMATOR_NOISE, "Rᵛ of the estimator ×", "", 1.0, 1e-4, 1e4),
        TuningParameter(MOTOR_NOISE, "Rᵛ of the motors' velocities, also ×", "", 1.0, 1e-3, 1e3),
        TuningParameter(DEGREE, "degree of V", "", None, 2.0, 2.0),
    )
}  # fmt: skip

_ESTIMATOR = (ESTIMATOR_NOISE, MOTOR_NOISE)
_QUADRATIC = ("effort", "integral_weight", "velocity_weight", *_ESTIMATOR)
_H_INFINITY = ("gamma_ratio", CHANNELS, *_QUADRATIC)

#: Sets of sensors that proponents of a law use: encoders on the motors; on the links too; torque sensors in the joints.
_MOTOR, _BOTH = ("motor_position",), ("link_position", "motor_position")
_TORQUE, _TORQUE_BOTH = (*_MOTOR, "joint_torque"), (*_BOTH, "joint_torque")


def _hji(problem: GeneralisedPlant, degree: float, gamma_ratio: float = INFINITE_GAMMA) -> Law:
    from flexhinf.hinf import smallest_gamma, solve_hji

    infinite = gamma_ratio >= INFINITE_GAMMA * (1.0 - ROUNDING)
    return solve_hji(problem, np.inf if infinite else gamma_ratio * smallest_gamma(problem), round(degree))


def _lqr(problem: GeneralisedPlant) -> Law:
    from flexhinf.baselines import lqr

    return lqr(problem)


def _lqr_gravity(problem: GeneralisedPlant) -> Law:
    from flexhinf.baselines import GravityCompensatedLQR

    return GravityCompensatedLQR.design(problem)


def _pd(problem: GeneralisedPlant, **numbers: Any) -> Law:
    from flexhinf.baselines import MotorPD

    return MotorPD.tuned(problem, **numbers)


def _torque(problem: GeneralisedPlant, rotor_inertia: float, **numbers: Any) -> Law:
    from flexhinf.baselines import TorqueFeedback

    return TorqueFeedback.tuned(problem, inertia_ratio=rotor_inertia, **numbers)


def _flatness(problem: GeneralisedPlant, **numbers: Any) -> Law:
    from flexhinf.baselines import FeedbackLinearisation

    return FeedbackLinearisation.tuned(problem, **numbers)


@dataclass(frozen=True)
class LawKind:
    """A law that can be compared."""

    name: str
    description: str
    group: str  # panel of the figure
    source: str  # key into docs/references.bib, or who proposes it
    model: str  # the part of the model that the law itself uses; the estimator has the whole model
    make: Callable[..., Law]  # from the weighted problem and, by name, the other numbers that are tuned
    tuned: tuple[str, ...]  # names of all numbers that its gains are made from, and of R^v of its estimator
    # sets of sensors, of which the best is used; empty: the design's sensors
    sensors: tuple[tuple[str, ...], ...] = ()
    degree: int | None = None  # degree of V; 0 for the design's, or the tuned one; None if there is no V
    linear_estimator: bool = False  # a linear Kalman filter in place of the design's estimator

    @property
    def parameters(self) -> tuple[TuningParameter, ...]:
        """The numbers that are searched for."""
        return tuple(_PARAMETERS[name] for name in self.tuned)


_ROBUST, _LINEAR_QUADRATIC, _USUAL = "H∞ and γ = ∞", "linear-quadratic", "in use today"

_KINDS = (
    LawKind(DESIGN, "nonlinear H∞ as flexhinf design makes it, not tuned for the criterion", _ROBUST,
        "flexhinf design", "whole model", _hji, (), degree=0),
    LawKind(NL_HINF, "nonlinear H∞: the design's problem", _ROBUST,
        "van der Schaft 1992", "whole model", _hji, (*_H_INFINITY, DEGREE), degree=0),
    LawKind("hinf", "linear H∞: degree 2 of the same problem", _ROBUST,
        "van der Schaft 1992", "linear at the goal", _hji, _H_INFINITY, degree=2),
    LawKind("nlqr", "nonlinear LQR: γ = ∞", _ROBUST,
        "Al'brekht 1961", "whole model", _hji, (*_QUADRATIC, DEGREE), degree=0),
    LawKind("lqr", "LQR", _LINEAR_QUADRATIC,
        "Anderson & Moore 1990", "linear at the goal", _lqr, _QUADRATIC),
    LawKind("lqr-gravity", "LQR of the weightless robot, weight compensated at every pose", _LINEAR_QUADRATIC,
        "Anderson & Moore 1990", "linear, and gravity", _lqr_gravity, _QUADRATIC),
    LawKind("lqg", "LQR with a linear Kalman filter instead of the design's estimator", _LINEAR_QUADRATIC,
        "Anderson & Moore 1990", "linear at the goal", _lqr, _QUADRATIC, linear_estimator=True),
    LawKind("pd", "PD on the motor side, weight at the goal compensated", _USUAL,
        "Tomei 1991", "inertia, gravity at the goal",
        _pd, ("bandwidth", "damping", *_ESTIMATOR), (_MOTOR,)),
    LawKind("pd-gravity", "PD on the motor side, weight compensated from the motor at every pose", _USUAL,
        "De Luca, Siciliano & Zollo 2005", "inertia, stiffness, gravity",
        partial(_torque, rotor_inertia=1.0), ("bandwidth", "damping", *_ESTIMATOR), (_MOTOR,)),
    LawKind("pid", "PD on the motor side with the integral of the link's error", _USUAL,
        "Tomei 1991, with an integral", "inertia, gravity at the goal",
        partial(_pd, integral="link_position"),
        ("bandwidth", "damping", "integral_rate", *_ESTIMATOR), (_BOTH,)),
    LawKind("torque", "PD with feedback of the spring's torque, weight compensated from the motor", _USUAL,
        "Albu-Schäffer, Ott & Hirzinger 2007", "inertia, stiffness, gravity",
        _torque, ("bandwidth", "damping", "rotor_inertia", *_ESTIMATOR), (_TORQUE,)),
    LawKind("torque-i", "the same with the integral of the link's error", _USUAL,
        "Albu-Schäffer, Ott & Hirzinger 2007, with an integral", "inertia, stiffness, gravity",
        partial(_torque, integral="link_position"),
        ("bandwidth", "damping", "rotor_inertia", "integral_rate", *_ESTIMATOR), (_TORQUE_BOTH,)),
    LawKind("flatness", "feedback linearisation with flatness feedforward", _USUAL,
        "Spong 1987; De Luca & Book 2016", "whole model and its derivatives",
        _flatness, ("bandwidth", *_ESTIMATOR), (_BOTH,)),
    LawKind("flatness-i", "the same with the integral of the link's error", _USUAL,
        "Spong 1987; De Luca & Book 2016, with an integral", "whole model and its derivatives",
        partial(_flatness, integral=True), ("bandwidth", "integral_rate", *_ESTIMATOR), (_BOTH,)),
)  # fmt: skip

_BY_NAME = {kind.name: kind for kind in _KINDS}
_WITH_DEGREE = re.compile(rf"{NL_HINF}-(\d+)\Z")

#: Without a choice: every kind of law, with and without an integral.
DEFAULT_LAWS = tuple(_BY_NAME)

#: Those that are compared with the design's own law and the same tuned.
RIVALS = DEFAULT_LAWS[2:]

#: Those that can be compared over a workspace, and those that are where no laws are named.
RIVALS_OVER = ("pd", "pd-gravity", "pid", "torque", "torque-i", "flatness", "flatness-i", "lqg")
USUAL = ("pd-gravity", "pid", "torque-i", "flatness-i", "lqg")


def law_kind(name: str) -> LawKind:
    """The law of a name. Raises `InvalidInput` for a name that is not known, with the nearest that is."""
    match = _WITH_DEGREE.match(name)
    if match and 2 <= (degree := int(match[1])) <= LARGEST_DEGREE:
        return replace(
            _BY_NAME[NL_HINF], name=name, source="flexhinf design --degrees", tuned=_H_INFINITY, degree=degree,
            description=f"nonlinear H∞ of degree {degree}: the design's problem, V of that degree",
        )  # fmt: skip
    if name in _BY_NAME:
        return _BY_NAME[name]
    known = (*_BY_NAME, *(f"{NL_HINF}-{degree}" for degree in range(2, LARGEST_DEGREE + 1)))
    raise unknown_name(f"There is no law {name!r} to compare with.", name, known, f"--laws {NL_HINF},pd")


def law_names(names: Sequence[str] | None = None) -> tuple[str, ...]:
    """The names of a comparison, each once: the design's own law and the same tuned, then the others.

    Raises `InvalidInput` for a name that is not known.
    """
    wanted = tuple(names) if names else DEFAULT_LAWS
    for name in wanted:
        law_kind(name)
    return tuple(dict.fromkeys((DESIGN, NL_HINF, *wanted)))


def is_hinf(name: str) -> bool:
    """Whether a law is the design's own or tuned nonlinear H∞; linear H∞ (hinf) counts as a rival."""
    return name in (DESIGN, NL_HINF) or name.startswith(f"{NL_HINF}-")


@dataclass(frozen=True, eq=False)
class LawFactory:
    """Makes laws about the goal of a design, from its model."""

    synthesis: Synthesis  # of the design: problem, weights, γ and degree
    bandwidth: float  # where searches over bandwidths begin, rad/s

    @cached_property
    def gamma_ratio(self) -> float:
        """γ of the design over the smallest γ of the solved problem (with channels of the tolerances)."""
        from flexhinf.hinf import smallest_gamma

        solved = self.synthesis.design_problem
        return float(solved.gamma / smallest_gamma(solved.problem))

    def start(self, kind: LawKind) -> dict[str, float]:
        """Initial values of a law's parameters in a search: for H∞ those of the design."""
        from flexhinf.baselines.equilibrium_law import INTEGRAL_RATE

        limits, degree = _PARAMETERS["gamma_ratio"], float(self.synthesis.chosen.degree)
        ratio = float(np.clip(self.gamma_ratio, limits.lower, limits.upper))
        own = {
            "bandwidth": self.bandwidth, "integral_rate": INTEGRAL_RATE, "gamma_ratio": ratio, DEGREE: degree,
        }  # fmt: skip
        fixed = {DEGREE: self.largest_degree <= 2, CHANNELS: self.synthesis.design_problem.robustness is None}
        free = (p for p in kind.parameters if not fixed.get(p.name, False))
        return {p.name: own[p.name] if p.start is None else p.start for p in free}

    def own(self, kind: LawKind) -> dict[str, float] | None:
        """Values of a law's parameters that reproduce the design's own law; None for a law that cannot."""
        at_goal = self.synthesis.law is self.synthesis.solution  # not a schedule of several poses
        same = kind.degree == 0 or (kind.degree == self.synthesis.chosen.degree and at_goal)
        return (
            {**self.start(kind), "velocity_weight": NO_VELOCITY}
            if same and "gamma_ratio" in kind.tuned
            else None
        )

    def bounds(self, kind: LawKind) -> dict[str, tuple[float, float]]:
        """Lower and upper bounds of a law's parameters."""
        start, largest = self.start(kind), {DEGREE: (2.0, float(self.largest_degree))}
        free = [(p, start[p.name] if p.relative else 1.0) for p in kind.parameters if p.name in start]
        return {p.name: largest.get(p.name, (p.lower * scale, p.upper * scale)) for p, scale in free}

    @property
    def states(self) -> int:
        """Number of states of the problem, with the integrals."""
        return len(self.synthesis.problem.state_names)

    @property
    def largest_degree(self) -> int:
        """Largest degree of V that the design tried."""
        return max(choice.degree for choice in self.synthesis.choices)

    def degree(self, kind: LawKind) -> int:
        """Degree of V of a law; 2 for laws that have none."""
        return self.synthesis.chosen.degree if kind.degree == 0 else kind.degree or 2

    def make(self, kind: LawKind, values: Mapping[str, float], degree: int | None = None) -> Law:
        """The law with these values of its parameters, see `start`, and V of another `degree` than its own.

        Values of R^v are ignored here, and a degree among the values is rounded. Raises `FlexhinfError` if the law does
        not exist, because a Riccati equation has no solution, or it cannot hold the goal.
        """
        own = self.own(kind) if degree in (None, self.synthesis.chosen.degree) else None
        if kind.name == DESIGN or (
            own is not None and all(values.get(n, x) == x for n, x in own.items() if n not in _ESTIMATOR)
        ):
            return self.synthesis.law
        problem, fixed = self.synthesis.problem, (CHANNELS, *_QUADRATIC)
        numbers = {name: values[name] for name in kind.tuned if name in values and name not in fixed}
        if kind.degree is not None:
            numbers[DEGREE] = degree or numbers.get(DEGREE) or self.degree(kind)
        if CHANNELS in kind.tuned:
            from flexhinf.design.problem.presets import sized_channels

            size = values.get(CHANNELS, 1.0)
            size = 0.0 if size <= NO_CHANNELS * (1.0 + ROUNDING) else size
            problem = sized_channels(self.synthesis.design_problem.problem, problem, size)
        if "effort" in kind.tuned:
            problem = weighted(
                problem, values["effort"], values["integral_weight"], values["velocity_weight"]
            )
        return kind.make(problem, **numbers)


def weighted(problem: GeneralisedPlant, effort: float, integral: float, velocity: float) -> GeneralisedPlant:
    """A problem with the weights that a linear-quadratic designer tunes. Its penalty is the matrix ∂h/∂x.

    `effort` and `integral` are factors of R2 and of the columns of h(x) that belong to integrals. `velocity`, s, adds a
    row for each joint, this times the weight of its link position times its link velocity; none up to `NO_VELOCITY`.
    """
    from flexhinf.plant import Penalty

    names = problem.state_names
    factors = [integral if name.endswith("_integral") else 1.0 for name in names]
    rows = np.array(problem.expand(1).h_parts[1], dtype=float) * factors
    pairs = [
        (k, names.index(name.replace("velocity", "position")))
        for k, name in enumerate(names)
        if name.startswith("link_velocity") and velocity > NO_VELOCITY * (1.0 + ROUNDING)
    ]
    extra = [velocity * float(np.linalg.norm(rows[:, at])) * np.eye(len(names))[k] for k, at in pairs]
    r2 = effort * np.asarray(problem.penalty.effort, dtype=float)
    return replace(problem, penalty=Penalty(np.vstack([rows, *extra]), effort=r2))
