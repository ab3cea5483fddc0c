"""Laws of a name by its one knob, all made for the goal of the design and from its model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexhinf.baselines import FeedbackLinearisation, GravityCompensatedLQR, MotorPD, TorqueFeedback, lqr
from flexhinf.design.bench import Bench
from flexhinf.design.compare.names import BANDWIDTH, REFERENCE, Kind, degree_of, kind_of
from flexhinf.design.compare.reference import Reference
from flexhinf.design.estimator import initial_covariance, noise_variances, process_covariance
from flexhinf.estimation import ExtendedKalmanFilter
from flexhinf.hinf import smallest_gamma, solve_hji
from flexhinf.plant import GeneralisedPlant, Law, linear_plant

__all__ = ["PD_DAMPING", "LinearBench", "Maker", "maker_of", "start_of_bandwidth"]

#: Damping ratio that `pd` and `pid` are made with: their step does not pass the goal for want of it.
PD_DAMPING = 1.0

#: Beyond so many states a law of higher degree is tuned by its linear part: each try would take seconds.
MANY_STATES = 20


class LinearBench(Bench):
    """The same bench with a linear Kalman filter: its model is the linearisation at the goal.

    On a linear model the extended Kalman filter is the linear one. Noise covariances and the belief at the start are
    those of the estimator that it stands in for.
    """

    def estimator(self, at: np.ndarray) -> Any:
        """The linear Kalman filter, believing at first that the robot rests at a pose (n,)."""
        s, rest = self.specification, self.robot.operating_point(self.goal)
        process = process_covariance(self.model, s.noises)
        measurement = noise_variances(self.model, s.measurement_noise)
        return ExtendedKalmanFilter(
            linear_plant(self.model, *rest),
            s.period,
            process,
            measurement,
            mean=self.robot.operating_point(at)[0],
            covariance=initial_covariance(self.model, rest, s.period, process, measurement),
        )


@dataclass(frozen=True, eq=False)
class Maker:
    """How a law of a name is made.

    Attributes
    ----------
    kind : Kind
    law : callable
        knob → law.
    tuned_by : callable
        knob → the law that a search looks at: the same, or its linear part.
    start : float
        Of the knob: the design's own price (1), or its bandwidth.
    bench : Bench
        With the law's estimator; its law is to be replaced.
    """

    kind: Kind
    law: Callable[[float], Law]
    tuned_by: Callable[[float], Law]
    start: float
    bench: Bench

    @property
    def by_linear_part(self) -> bool:
        """Whether the search looks at the linear part only."""
        return self.tuned_by is not self.law


def maker_of(name: str, reference: Reference) -> Maker:
    """The maker of a name.

    Raises
    ------
    InvalidInput
        For a name that is not known.
    """
    kind = kind_of(name)
    bench = reference.bench
    if name == "lqg":
        bench = LinearBench(**{field: getattr(bench, field) for field in bench.__dataclass_fields__})
    if kind.knob == BANDWIDTH:
        make = _of_bandwidth(name, reference.problem)
        return Maker(kind, make, make, start_of_bandwidth(reference), bench)
    make = _of_price(name, reference)
    simple = make
    degree = _degree(name, reference)
    if degree > 2 and len(reference.problem.state_names) > MANY_STATES:
        simple = _linear_part(name, reference)
    return Maker(kind, make, simple, 1.0, bench)


def start_of_bandwidth(reference: Reference) -> float:
    """Where a search over bandwidths begins, and what they are without one: the geometric mean of the joints'."""
    return float(np.exp(np.mean(np.log(np.maximum(reference.bandwidth, 1e-3)))))


def _degree(name: str, reference: Reference) -> int:
    """Degree of V of a name; 2 for laws that have none."""
    if name in (REFERENCE, "nlqr"):
        return reference.synthesis.chosen.degree
    return degree_of(name) or 2


def _of_bandwidth(name: str, problem: GeneralisedPlant) -> Callable[[float], Law]:
    tracked = "link_position"
    if name in ("pd", "pid"):
        return lambda w: MotorPD.tuned(problem, w, PD_DAMPING, tracked if name == "pid" else None)
    if name in ("torque", "torque-i"):
        return lambda w: TorqueFeedback.tuned(problem, w, integral=tracked if name == "torque-i" else None)

    def linearising(w: float) -> Law:
        law: Any = FeedbackLinearisation.tuned(problem, w, integral=name == "flatness-i")
        return law

    return linearising


def _of_price(name: str, reference: Reference) -> Callable[[float], Law]:
    nominal = reference.problem
    if name in ("lqr", "lqg"):
        return lambda k: lqr(nominal, effort=k)
    if name == "lqr-gravity":
        return lambda k: GravityCompensatedLQR.design(nominal, effort=k)
    degree = _degree(name, reference)
    if name == "nlqr":
        return lambda k: solve_hji(_priced(nominal, k), np.inf, degree)
    return lambda k: _of_game(reference, k, degree)


def _linear_part(name: str, reference: Reference) -> Callable[[float], Law]:
    if name == "nlqr":
        return lambda k: solve_hji(_priced(reference.problem, k), np.inf, 2)
    return lambda k: _of_game(reference, k, 2)


def _of_game(reference: Reference, price: float, degree: int) -> Law:
    """The design's own game with another price of the input, its level moved with the smallest feasible one."""
    game = reference.synthesis.game
    if price == 1.0:
        return solve_hji(game.problem, game.gamma, degree)
    problem = _priced(game.problem, price)
    moved = smallest_gamma(problem) / reference.own_gamma_star
    return solve_hji(problem, game.gamma * moved, degree)


def _priced(problem: GeneralisedPlant, price: float) -> GeneralisedPlant:
    """R2 times a factor."""
    effort = price * np.asarray(problem.penalty.effort, dtype=float)
    return replace(problem, penalty=replace(problem.penalty, effort=effort))
