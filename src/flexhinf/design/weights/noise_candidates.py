"""Noise levels that were tried: what each costs, which limits it misses, and the trade-off between all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexhinf.design.estimators import EstimatorNoise

#: What may limit the choice, beside unstable corners.
LIMITS = ("peak sensitivity", "gain margin", "damping", "compliance", "noise")

#: What a limit that is missed by the factor e counts, in decades of noise.
MISSED_WEIGHT = 20.0

#: How much of that the limit of the noise counts: a loop that rings or has no margin is worse than a loud one. Where
#: the motors' effort is limited it counts more than all others: noise takes the effort that the step needs.
NOISE_COUNTS, LIMITED_COUNTS = 0.25, 4.0


@dataclass(frozen=True, eq=False)
class NoiseCandidate:
    """Levels that were tried, and the running loop with them.

    Attributes
    ----------
    compliance : float
        Peak of |load torque → link position| over that of the law fed the true state.
    noises : (m,)
        RMS of each input, V or N·m.
    missed : mapping of str to float
        ln(figure/limit) of each of `LIMITS` that is missed by more than a requirement allows.
    avoidable : mapping of str to float
        The same beyond what the law fed the true state misses, and every candidate of the families.
    unstable : int or None
        Corners of the tolerances; None without tolerances, and where they were not looked at.
    noise_counts : float
        What the limit of the noise counts beside the others.
    """

    levels: EstimatorNoise
    peak_sensitivity: float
    gain_margin: float
    damping: float
    compliance: float
    noises: np.ndarray
    missed: Mapping[str, float]
    avoidable: Mapping[str, float]
    unstable: int | None = None
    noise_counts: float = NOISE_COUNTS

    @property
    def input_noise(self) -> float:
        """RMS of the noisiest input, V or N·m."""
        return float(self.noises.max())

    @property
    def score(self) -> float:
        """What is minimised: decades of noise, and mainly what is missed of what can be kept."""
        return self._cost(self.avoidable)

    @property
    def whole_score(self) -> float:
        """The same with all that is missed: of different laws, for which different limits are out of reach."""
        return self._cost(self.missed)

    def _cost(self, missed: Mapping[str, float]) -> float:
        counted = sum(
            excess * (self.noise_counts if limit == "noise" else 1.0) for limit, excess in missed.items()
        )
        return MISSED_WEIGHT * counted + float(np.log10(np.maximum(self.noises, 1e-300)).mean())

    @property
    def feasible(self) -> bool:
        """Whether every limit that can be kept is kept, with no unstable corner."""
        return not self.avoidable and not self.unstable


@dataclass(frozen=True, eq=False)
class NoiseSearch:
    """The outcome, and the trade-off round it.

    Attributes
    ----------
    default : NoiseCandidate or None
        The default levels; None where the loop is unstable with them.
    trade_off : tuple of NoiseCandidate
        Those that no other one betters in noise, damping and compliance at once, the quietest first.
    count : int
        Candidates with a stable loop.
    unreachable : tuple of str
        Those of `LIMITS` that the law misses with the true state fed back too, or every choice of levels.
    """

    chosen: NoiseCandidate
    default: NoiseCandidate | None
    trade_off: tuple[NoiseCandidate, ...]
    count: int
    unreachable: tuple[str, ...]


def trade_off_of(tried: list[NoiseCandidate]) -> tuple[NoiseCandidate, ...]:
    """The candidates that no other one betters in noise, damping and compliance at once, the quietest first."""
    figures = np.array([[one.input_noise, -one.damping, one.compliance] for one in tried])
    kept = []
    for k, own in enumerate(figures):
        better = np.all(figures <= own, axis=1) & np.any(figures < own, axis=1)
        if not better.any() and not any(np.array_equal(own, figures[j]) for j in kept):
            kept.append(k)
    return tuple(sorted((tried[k] for k in kept), key=lambda one: one.input_noise))
