"""Errors of pairs of a link and a motor that a proof holds, and the numbers of its integral inequalities."""

from __future__ import annotations

from typing import NamedTuple


class Sector(NamedTuple):
    """Errors −δ₁ ≤ Δ ≤ δ₂ of the inverse inertia matrix, as shares: M/(1 + δ₂) ≤ M̂ ≤ M/(1 − δ₁)."""

    lower: float  # δ₁: 0.2 covers links that are 1/0.8 times as heavy
    upper: float  # δ₂: 0.25 covers links that are 1/1.25 times as heavy


#: No errors of one kind.
EXACT = Sector(0.0, 0.0)


class Errors(NamedTuple):
    """What is tolerated at once, as shares: errors of the inverse inertia matrix and of the stiffness; and what pairs
    leave out, gravity's slope and the damping of springs, over the stiffness."""

    masses: Sector
    springs: Sector = EXACT  # −ε₁ ≤ E ≤ ε₂: (1 − ε₁) K ≤ K̂ ≤ (1 + ε₂) K
    slope: Sector = EXACT  # −γ₁ ≤ Γ ≤ γ₂: −γ₁ K ≤ ∂G/∂q ≤ γ₂ K
    damping: float = 0.0  # β, s: 0 ≤ D ≤ β K
    any_motion: bool = (
        False  # of one joint: gravity is any function with such slopes, and motions may be large
    )

    def and_share(self, share: float, others: Errors) -> Errors:
        """These, and a share of others beside them."""
        sums = [own + share * other for own, other in zip(self.numbers, others.numbers)]
        damping = self.damping + share * others.damping
        sectors = Sector(*sums[:2]), Sector(*sums[2:4]), Sector(*sums[4:])
        return Errors(*sectors, damping, self.any_motion or others.any_motion)

    @property
    def numbers(self) -> tuple[float, ...]:
        """δ₁, δ₂, ε₁, ε₂, γ₁ and γ₂."""
        return *self.masses, *self.springs, *self.slope

    @property
    def largest(self) -> float:
        """The largest of all, a share."""
        return max(self.numbers)

    @property
    def channels(self) -> tuple[bool, bool, bool]:
        """Whether springs have errors, gravity a slope, and springs damping: beside masses each adds a state to a
        pair."""
        return max(self.springs) > 0.0, max(self.slope) > 0.0, self.damping > 0.0

    @property
    def of_springs_alone(self) -> bool:
        """Whether nothing else than springs has errors."""
        return self.channels == (True, False, False) and self.masses == EXACT

    def states(self, multipliers: Multipliers) -> tuple[bool, bool, bool]:
        """Which of the channels are states; errors of springs alone, whose rate has no weight, are an input like those
        of masses."""
        springs, *others = self.channels
        return springs and multipliers.springs.rate > 0.0, others[0], others[1]

    @property
    def names(self) -> str:
        """What has errors."""
        kinds = ("masses", self.masses), ("springs", self.springs), ("gravity", self.slope)
        *others, last = [name for name, own in kinds if max(own) > 0.0] or [""]
        return f"{', '.join(others)} and {last}" if others else last

    def within(self, others: Errors) -> bool:
        """Whether all are at most as large as others."""
        within = all(own <= other for own, other in zip(self.numbers, others.numbers))
        return within and self.damping <= others.damping


#: No errors; errors of masses of either sign, of the same size.
NONE, SYMMETRIC = Errors(EXACT), Errors(Sector(1.0, 1.0))


class ChannelWeights(NamedTuple):
    """The numbers of an integral inequality for springs, or for the slope of gravity, in periods."""

    multiplier: float = 0.0  # ρ
    signal: float = 0.0  # μ₁
    rate: float = 0.0  # μ₂
    lift: float = 0.0  # c
    prediction: float = 0.0  # μ̂, of a slope in the model that predicts a state


class FilterWeights(NamedTuple):
    """The numbers of a filter 1/(s + p) through which errors of masses, or of springs alone, are seen too, in
    periods."""

    pole: float  # p
    multiplier: float  # σ: at the frequency ω τ is τ + 2σ/(ω² + p²)
    lift: float = 0.0  # c, of d_f² in the unit of d, or of e_f²


class MotorWeights(NamedTuple):
    """The numbers of the integral inequalities of unlike motors, in periods.

    N and Φ act on three signals: on the estimate's twist beside the one that the law used, on the true twist beside the
    estimate's, and on the twist that the law used; Φ on the motors' speeds alike.
    """

    weights: tuple[float, ...] = (
        1.0,
        0.0,
        1.0,
        0.0,
        0.0,
        1.0,
    )  # Π₁₁, Π₂₁, Π₂₂, Π₃₁, Π₃₂, Π₃₃ of the sectors of N; Π ≥ 0
    skew: tuple[float, float, float] = (0.0, 0.0, 0.0)  # k₂₁, k₃₁, k₃₂: N is symmetric
    friction: tuple[float, float, float] = (1.0, 1.0, 1.0)  # of the sectors of Φ
    multiplier: float = 0.0  # π, of N as seen by the twist's rate
    filters: tuple[FilterWeights, ...] = ()  # of N as seen by the twist
    error_filters: tuple[FilterWeights, ...] = ()  # and by the twist's error of the estimate

    @property
    def matrix(self) -> tuple[tuple[float, float, float], ...]:
        """Π (3, 3)."""
        one, other, two, third, mixed, three = self.weights
        return (one, other, third), (other, two, mixed), (third, mixed, three)

    @property
    def without_gain(self) -> MotorWeights:
        """The same without π, σ and skew products."""
        filters, error_filters = _without_gain(self.filters), _without_gain(self.error_filters)
        return MotorWeights(
            self.weights, friction=self.friction, filters=filters, error_filters=error_filters
        )


class Multipliers(NamedTuple):
    """The numbers of an integral inequality, in periods."""

    masses: float  # τ; of e and r where springs alone have errors
    springs: ChannelWeights = ChannelWeights()
    slope: ChannelWeights = ChannelWeights()
    damping: ChannelWeights = ChannelWeights()
    filters: tuple[FilterWeights, ...] = ()
    motors: MotorWeights | None = None  # of unlike motors
    prediction_filters: tuple[
        FilterWeights, ...
    ] = ()  # of a slope in the model; σ is the weight of the sector of signals behind s/(s + p)

    @property
    def every_filter(self) -> tuple[FilterWeights, ...]:
        """All filters in the order of their states: of masses, of N, of the estimate's errors and of its slope."""
        motors = () if self.motors is None else (*self.motors.filters, *self.motors.error_filters)
        return *self.filters, *motors, *self.prediction_filters

    @property
    def without_gain(self) -> Multipliers:
        """The same without τ, σ and what motors add to them."""
        motors = self.motors and self.motors.without_gain
        return self._replace(masses=0.0, filters=_without_gain(self.filters), motors=motors)


def _without_gain(filters: tuple[FilterWeights, ...]) -> tuple[FilterWeights, ...]:
    return tuple(one._replace(multiplier=0.0) for one in filters)
