"""The numbers of pairs in the certificate of a workspace, with the law and the loop that they are of."""

# Not checked strictly: parts of NumPy have no types.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false, reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import numpy as np
from flint import arb, fmpq, fmpq_mat

from flexhinf.errors import InvalidInput, refuse_if

#: Keys of single numbers in a file.
LOOP = ["period", "motor", "damping", "holding", "input", "rate", "delay"]
ERRORS = ["lower", "upper", "softer", "stiffer", "falling", "holding_up"]
SPRING_WEIGHTS = ["spring_multiplier", "twist_weight", "rate_weight", "lift"]
SLOPE_WEIGHTS = ["slope_multiplier", "place_weight", "slope_rate_weight", "slope_lift", "prediction_weight"]
DAMPING_WEIGHTS = ["damping_weight", "damping_rate_weight", "damping_lift"]
MULTIPLIERS = ["multiplier", *SPRING_WEIGHTS, *SLOPE_WEIGHTS, *DAMPING_WEIGHTS]
BESIDE_SPRINGS = ["lower", "upper", "falling", "holding_up", "spring_damping"]
SCALARS = [*LOOP, *ERRORS, "spring_damping", *MULTIPLIERS]

#: Keys of single numbers of unlike motors, and their lists with how many numbers each has.
MOTORS = ["slower", "faster", "less_friction", "more_friction", "multiplier"]
MOTOR_WEIGHTS = {"weights": 6, "skew": 3, "friction_weights": 3}

#: Most intervals, states of a pair, terms of a filter's series, and filters of the multiplier in a file.
MOST = 100_000, 40, 2_000, 4

#: Most λ, and most θ, of a storage in an interval.
NODES = 8


class MotorsClaim(NamedTuple):
    """The numbers of a file about motors that differ from joint to joint, in periods but for the friction."""

    slower: float  # ν₁: K/J of a joint down to (1 − ν₁) κ
    faster: float  # ν₂: and up to (1 + ν₂) κ
    less_friction: float  # φ₁, 1/s: B/J of a joint down to β − φ₁
    more_friction: float  # φ₂, 1/s: and up to β + φ₂
    multiplier: float  # π, of n and the rate of the twist
    weights: np.ndarray  # (3, 3), Π, of twists: since the sample, unknown to the model, and at the sample
    skew: np.ndarray  # (3, 3), k below the diagonal
    friction_weights: np.ndarray  # (3,), of speeds in the same order
    filters: np.ndarray  # (k, 3), ϖ, σ and c of each filter of n
    error_filters: np.ndarray  # (k, 3), the same of what the model does not know of n

    @property
    def sizes(self) -> tuple[float, float, float, float]:
        """ν₁, ν₂, φ₁ and φ₂."""
        return self.slower, self.faster, self.less_friction, self.more_friction

    @property
    def with_friction(self) -> bool:
        """Whether motors have unlike friction."""
        return max(self.less_friction, self.more_friction) > 0.0

    @property
    def is_inside(self) -> bool:
        """Whether all numbers are in their ranges: Π ≥ 0 by all its principal minors, which are rational."""
        exact = [[fmpq(*entry.as_integer_ratio()) for entry in row] for row in self.weights.tolist()]
        minors = (
            fmpq_mat([[exact[i][j] for j in chosen] for i in chosen]).det()
            for count in (1, 2, 3)
            for chosen in combinations(range(3), count)
        )
        poles = np.concatenate([self.filters[:, 0], self.error_filters[:, 0]])
        return (
            min(self.sizes) >= 0.0
            and self.slower < 1.0
            and bool((self.friction_weights >= 0.0).all() and (poles > 0.0).all())
            and all(minor >= 0 for minor in minors)
        )


class PairClaim(NamedTuple):
    """The numbers of a file, all finite; units in `flexhinf.modal.pair`."""

    period: float  # s
    motor: float  # κ, 1/s²
    damping: float  # β, 1/s
    holding: float  # ν, 1/s²
    input: float  # b, 1/s²
    latency: int  # samples
    poles: np.ndarray  # (k,), 1/s²
    coefficients: (
        np.ndarray
    )  # (5, k + 1), of the gains of z, z′, w, w′ and the integral; a sixth row of unlike motors
    seen: np.ndarray | None  # (m, 4), what the filter measures of z, z′, w, w′; None for the true state
    table: np.ndarray | None  # (d, 4m), Chebyshev coefficients of its gains
    filter_range: tuple[float, float] | None  # ends of log λ in it
    lower: float  # δ₁
    upper: float  # δ₂
    softer: float  # ε₁
    stiffer: float  # ε₂
    falling: float  # γ₁
    holding_up: float  # γ₂
    multiplier: float  # τ, periods; of springs where they alone have errors
    spring_multiplier: float  # ρ, periods
    twist_weight: float  # μ₁, periods²
    rate_weight: float  # μ₂; 0 where springs alone have errors
    lift: float  # c, periods
    slope_multiplier: float  # these four of the slope of gravity
    place_weight: float
    slope_rate_weight: float
    slope_lift: float
    prediction_weight: float  # and of the slope in the model that predicts; 0 where none does
    spring_damping: float  # β, s
    damping_weight: float  # these three of damped springs
    damping_rate_weight: float
    damping_lift: float
    any_motion: bool  # whether gravity is any function with such slopes, of one joint
    filters: np.ndarray  # (k, 3), p, σ and c of each filter of the multiplier
    prediction_filters: np.ndarray  # (k, 3), ϖ, μ and c of sectors of the model's slope behind s/(s + ϖ)
    motors: MotorsClaim | None  # None where motors are alike
    rate: float  # α, 1/s
    delay: float  # θ₁, samples: the unknown delay is between 0 and this
    links: np.ndarray  # (N + 1,), ends λ of the intervals, ascending, 1/s²
    delays: list[list[float]]  # (N, k), 0 to θ₁ in each of these, in samples
    storages: list[np.ndarray]  # (N, (k − 1) d, m, n, n), P at d equidistant θ of each two, at m such λ

    @property
    def exact(self) -> PairClaim:
        """The law and the loop without errors, rate and unknown delay, with motors alike."""
        errors = dict.fromkeys((*ERRORS, "spring_damping", "multiplier", "rate", "delay"), 0.0)
        none = np.zeros((0, 3))
        return self._replace(**errors, filters=none, prediction_filters=none, motors=None)

    @property
    def states(self) -> int:
        """n, of the loop of a pair, and what errors add."""
        waiting = 0 if self.model_moves else self.latency
        return 6 + (self.delay > 0.0) + waiting + 4 * self.with_prediction + self.added

    @property
    def predicts_slope(self) -> bool:
        """Whether a model with gravity's slope predicts: that of a filter, or one over a latency."""
        return self.with_slope and (self.seen is not None or self.latency > 0)

    @property
    def model_moves(self) -> bool:
        """Whether the model moves beside the pair within a period, as errors enter it."""
        return self.motors is not None or self.predicts_slope

    @property
    def with_prediction(self) -> bool:
        """Whether the model's prediction is a state of the loop: that of a filter, or over a latency where the model
        moves beside the pair."""
        return self.seen is not None or (self.model_moves and self.latency > 0)

    @property
    def added(self) -> int:
        """States that errors add: two of each filter, e where springs and others have errors, p where gravity has a
        slope, b where springs are damped."""
        of_motors = len(self.motors.filters) + len(self.motors.error_filters) if self.motors else 0
        filters = len(self.filters) + of_motors + len(self.prediction_filters)
        return 2 * filters + self.with_springs + self.with_slope + self.with_damping

    @property
    def with_springs(self) -> bool:
        """Whether errors of springs are a state beside those of others."""
        return max(self.softer, self.stiffer) > 0.0 and self.rate_weight > 0.0

    @property
    def springs_alone(self) -> bool:
        """Whether springs have errors that are an input, as those of masses would be, which are exact."""
        return max(self.softer, self.stiffer) > 0.0 and not self.rate_weight

    @property
    def with_slope(self) -> bool:
        """Whether gravity has a slope."""
        return max(self.falling, self.holding_up) > 0.0

    @property
    def with_damping(self) -> bool:
        """Whether springs are damped."""
        return self.spring_damping > 0.0


@contextmanager
def refused_as_damaged(what: str) -> Generator[None]:
    """Refuse a file as damaged where it has other keys, kinds or shapes of values than are read."""
    try:
        yield
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InvalidInput(
            f"The {what} cannot be read.",
            f"{type(error).__name__}: {str(error)[:200]}",
            "the file that flexhinf certify has written",
        ) from error


def pair_claim(numbers: Mapping[str, Any]) -> PairClaim:
    """The claim of a parsed file; InvalidInput where it is damaged."""
    with refused_as_damaged("certificate of a workspace"):
        one = {name: float(finite_numbers(numbers[name], 0)) for name in SCALARS}
        filters, of_slope = _filters(numbers["filters"]), _filters(numbers["prediction_filters"])
        latency, observer, parts = numbers["latency"], numbers["observer"], numbers["intervals"]
        if isinstance(latency, bool) or not isinstance(latency, int) or not 0 <= latency <= MOST[1]:
            raise ValueError(f"latency {latency!r}")
        if not isinstance(parts, list) or not 1 <= len(parts) <= MOST[0]:
            raise ValueError("no interval, or too many")
        seen = table = ends = None
        if observer is not None:
            seen, table = finite_numbers(observer["seen"], 2), finite_numbers(observer["table"], 2)
            ends = tuple(finite_numbers(observer["range"], 1).tolist())
            fits = seen.shape[1:] == (4,) and table.shape[1:] == (4 * len(seen),)
            if not (fits and len(ends) == 2 and ends[0] < ends[1] and len(table) <= MOST[2]):
                raise ValueError("the observer has other shapes")
        poles, coefficients = finite_numbers(numbers["poles"], 1), finite_numbers(numbers["coefficients"], 2)
        any_motion, delayed = numbers["any_motion"], bool(one["delay"] > 0.0)
        if not isinstance(any_motion, bool):
            raise ValueError(f"any_motion {any_motion!r}")
        motors = None if numbers["motors"] is None else _motors(numbers["motors"])
        links = finite_numbers([parts[0]["low"], *(part["high"] for part in parts)], 1)
        delays = [finite_numbers(part["delays"], 1).tolist() if delayed else [0.0] for part in parts]
        claim = PairClaim(
            **one,
            latency=latency,
            poles=poles,
            coefficients=coefficients,
            seen=seen,
            table=table,
            filter_range=ends,
            any_motion=any_motion,
            filters=filters,
            prediction_filters=of_slope,
            motors=motors,
            links=links,
            delays=delays,
            storages=[],
        )
        if any(part["low"] != low for part, low in zip(parts, links.tolist())):
            raise ValueError("an interval does not begin where the one before it ends")
        if coefficients.shape != (5 if motors is None else 6, len(poles) + 1):
            raise ValueError("the law has another shape")
    _check_ranges(claim)
    if motors is not None:
        _check_beside_motors(claim)
    with refused_as_damaged("certificate of a workspace"):
        storages = [
            _symmetric(
                finite_numbers(part["storages"] if delayed else [part["storages"]], 3),
                max(1, len(own) - 1),
                claim.states,
            )
            for part, own in zip(parts, delays)
        ]
    return claim._replace(storages=storages)


def _check_ranges(claim: PairClaim) -> None:
    """Refuse numbers that a theorem does not hold for."""
    one, filters, poles, links, delays = (
        claim._asdict(),
        claim.filters,
        claim.poles,
        claim.links,
        claim.delays,
    )
    springs = max(claim.softer, claim.stiffer) > 0.0
    alone = not any(one[name] for name in (*BESIDE_SPRINGS, "rate_weight", "motors"))
    slope, damped, any_motion = claim.with_slope, claim.with_damping, claim.any_motion
    wrong = [
        name
        for name, right in (
            ("period", one["period"] > 0.0),
            ("motor", one["motor"] >= 0.0),  # 0: a drive rejects its load
            ("damping", one["damping"] >= 0.0),
            ("holding", one["holding"] >= 0.0),
            ("input", one["input"] > 0.0),
            ("rate", one["rate"] >= 0.0),
            ("lower", 0.0 <= one["lower"] < 1.0),
            ("upper", one["upper"] >= 0.0),
            ("softer", 0.0 <= one["softer"] < 1.0),
            ("stiffer", one["stiffer"] >= 0.0),
            ("falling", one["falling"] >= 0.0),
            ("holding_up", one["holding_up"] >= 0.0),
            ("twist_weight", one["twist_weight"] >= 0.0),
            (
                "rate_weight",
                one["rate_weight"] > 0.0 or (one["rate_weight"] == 0.0 and (alone or not springs)),
            ),
            ("place_weight", one["place_weight"] >= 0.0),
            (
                "slope_rate_weight",
                one["slope_rate_weight"] > 0.0 or (one["slope_rate_weight"] == 0.0 and not slope),
            ),
            ("prediction_weight", (one["prediction_weight"] > 0.0) == claim.predicts_slope),
            ("prediction_weight", one["prediction_weight"] >= 0.0),
            ("prediction_filters", (claim.prediction_filters[:, 0] > 0.0).all()),
            ("prediction_filters", (claim.prediction_filters[:, 1] >= 0.0).all()),
            (
                "prediction_filters",
                not len(claim.prediction_filters) or (claim.predicts_slope and not any_motion),
            ),
            ("latency", claim.latency <= 1 or not claim.predicts_slope),
            ("spring_damping", one["spring_damping"] >= 0.0),
            ("damping_weight", one["damping_weight"] >= 0.0),
            # b ḃ ≥ 0 stands with 2τ less this weight
            (
                "damping_rate_weight",
                one["damping_rate_weight"] > 0.0
                and arb(one["damping_rate_weight"]) * arb(one["spring_damping"])
                <= 2 * arb(one["multiplier"]) * arb(one["period"])
                if damped
                else one["damping_rate_weight"] == 0.0,
            ),
            ("any_motion", not any_motion or one["rate"] == 0.0),
            ("filters", (filters[:, 0] > 0.0).all()),
            ("motors", claim.motors is None or claim.motors.is_inside),
            ("poles", (poles > 0.0).all()),
            ("delay", 0.0 <= one["delay"] <= 1.0),
            ("delays", all(own[0] == 0.0 and own[-1] == one["delay"] for own in delays)),
            ("delays", all(first < last for own in delays for first, last in pairwise(own))),
            ("intervals", links[0] > 0.0 and (np.diff(links) > 0.0).all()),
        )
        if not right
    ]
    refuse_if(
        bool(wrong),
        "The certificate of a workspace has numbers outside their ranges.",
        f"expected positive rates, sectors below 1, weights and ascending intervals, got other {', '.join(wrong)}",
        "the file that flexhinf certify has written",
    )


def _check_beside_motors(claim: PairClaim) -> None:
    """Refuse what the proof of unlike motors does not treat."""
    treated = (
        ("an unknown delay", claim.delay == 0.0),
        ("motions of any size", not claim.any_motion),
        ("a latency of more than one sample", claim.latency <= 1),
        ("an inner loop", claim.holding == 0.0 and claim.motor == claim.input),
    )
    others = [name for name, is_so in treated if not is_so]
    refuse_if(
        bool(others),
        "The certificate of a workspace has unlike motors beside what their proof does not treat.",
        f"expected linear loops of torques with a known latency of 0 or 1, got {', '.join(others)}",
        "the file that flexhinf certify has written",
    )


def _symmetric(triangles: np.ndarray, boxes: int, n: int) -> np.ndarray:
    """Matrices (k, m, n, n) of their lower triangles, as many of the k in each of some boxes."""
    late, links, size = triangles.shape
    each = late // boxes
    if size != n * (n + 1) // 2 or late != boxes * each or not 2 <= links <= NODES or not 1 <= each <= NODES:
        raise ValueError("a storage has another shape")
    matrices = np.zeros((late, links, n, n))
    rows, columns = np.tril_indices(n)
    matrices[..., rows, columns] = matrices[..., columns, rows] = triangles
    return matrices


def _motors(numbers: Mapping[str, Any]) -> MotorsClaim:
    """Of the numbers under "motors"."""
    one = {name: float(finite_numbers(numbers[name], 0)) for name in MOTORS}
    lists = {name: finite_numbers(numbers[name], 1) for name in MOTOR_WEIGHTS}
    if any(len(lists[name]) != count for name, count in MOTOR_WEIGHTS.items()):
        raise ValueError("the weights of motors have other shapes")
    weights, skew = np.zeros((3, 3)), np.zeros((3, 3))
    skew[np.tril_indices(3, -1)] = lists["skew"]
    weights[np.tril_indices(3)] = lists["weights"]
    weights = weights + np.tril(weights, -1).T
    return MotorsClaim(
        **one,
        weights=weights,
        skew=skew,
        friction_weights=lists["friction_weights"],
        filters=_filters(numbers["filters"]),
        error_filters=_filters(numbers["error_filters"]),
    )


def _filters(value: object) -> np.ndarray:
    """p, σ and c of the filters of a multiplier, (k, 3)."""
    if value == []:
        return np.zeros((0, 3))
    filters = finite_numbers(value, 2)
    if filters.shape[1] != 3 or len(filters) > MOST[3]:
        raise ValueError("the filters have other shapes")
    return filters


def finite_numbers(value: object, dimensions: int) -> np.ndarray:
    """Numbers of a file, neither text nor truth values."""

    def plain(part: object) -> None:
        if isinstance(part, list):
            for one in part:
                plain(one)
        elif isinstance(part, bool) or not isinstance(part, (int, float)):
            raise ValueError(f"{part!r} is no number")

    plain(value)
    array = np.asarray(value, dtype=float)
    if array.ndim != dimensions or array.size == 0 or not np.isfinite(array).all():
        raise ValueError(f"expected finite numbers in {dimensions} dimensions")
    return array
