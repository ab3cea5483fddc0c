"""Kinds of estimators: name, description, and how each is made for a design of one pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flexhinf.arrays import Matrix, Vector
from flexhinf.designs.specification import AUTO, ESTIMATED_BY, Specification, declare_estimator
from flexhinf.errors import refuse_if
from flexhinf.extensions import Registry
from flexhinf.loop import savable_estimator
from flexhinf.plant import Estimator, Plant


@dataclass(frozen=True, eq=False)
class EstimatorTask:
    """Of what an estimator is made: model, period, noise, and its first belief."""

    model: Plant
    period: float  # s
    process_noise: Matrix  # R^v (N, N), per sample
    measurement_noise: Vector  # R^n (p,), variances
    mean: Vector  # (N,)
    covariance: Matrix  # (N, N), stationary at the goal
    goal: Vector  # (N,), state at rest at the goal


@dataclass(frozen=True)
class EstimatorKind:
    """An estimator that a design can have."""

    name: str  # of ``--estimator``
    description: str  # in a sentence: "the unscented Kalman filter"
    make: Callable[[EstimatorTask], Estimator]
    kalman: bool = False  # whether R^v is searched for, and the model may have dry friction
    about_pose: bool = False  # whether its gain is that of one pose
    classes: tuple[
        type[Estimator], ...
    ] = ()  # what files of controllers hold, beside those of flexhinf.estimation


#: All kinds, by name; ``none`` feeds back the true state.
ESTIMATORS: Registry[EstimatorKind] = Registry("estimator", __package__ or "")


def is_kalman(s: Specification) -> bool:
    """Whether the estimator of a specification is a Kalman filter whose R^v is searched for, as `AUTO` is of a law
    about a pose."""
    return s.estimator == AUTO or (s.estimator != "none" and ESTIMATORS[s.estimator].kalman)


def register(kind: EstimatorKind) -> EstimatorKind:
    """Add an estimator, and return it.

    Raises `InvalidInput` for a name that is there already or cannot be used, and for a class that states no settings,
    by which a file makes it again.
    """
    ESTIMATORS.check(kind.name)
    refuse_if(
        kind.name in ("none", AUTO),
        "The name of an estimator cannot be used.",
        f"expected another name than none and {AUTO}, which are no estimators",
        "my_filter",
    )
    for own in kind.classes:
        savable_estimator(own)
    if kind.name not in ESTIMATED_BY:
        declare_estimator(kind.name, kind.description)
    return ESTIMATORS.register(kind)
