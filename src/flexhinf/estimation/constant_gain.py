"""An estimator with its stationary gain: the gain no longer changes.

The gain is usually that of the Kalman filter for the estimator's own model F at one operating point
(`flexhinf.estimation.stationary`). The extended filter's gain tends to it, and the unscented filter's does as far
as F and H are straight over the spread of its points.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.plant import Estimator
from flexhinf.untrusted import real_array

__all__ = ["ConstantGainBelief", "ConstantGainFilter"]


class ConstantGainBelief(NamedTuple):
    """A mean (n,) and the gain (n, p) that corrects it."""

    mean: Any
    gain: Any


class ConstantGainFilter(Estimator):
    """x̂ = x̂⁻ + L (y − h(x̂⁻)), x̂⁻ = F(x̂, u), with the gain L carried along in the belief.

    Parameters
    ----------
    filter : RecursiveFilter
        Whose model, discretisation and noises are meant.
    gain : (n, p) array

    Raises
    ------
    InvalidInput
        If the gain is not (n, p) finite numbers.
    """

    def __init__(self, filter: RecursiveFilter, gain: np.ndarray) -> None:
        self.filter, self.plant, self.period = filter, filter.plant, filter.period
        self.process_noise, self.measurement_noise = filter.process_noise, filter.measurement_noise
        gain, shape = real_array(gain), (filter.plant.n, len(filter.plant.outputs))
        if gain.shape != shape or not np.all(np.isfinite(gain)):
            raise InvalidInput(
                "The gain does not fit the plant.",
                f"expected {shape} finite numbers, got shape {gain.shape}",
                "stationary_gain(linear_model(filter, x, u), process_noise, measurement_noise)",
            )
        self.initial: Any = ConstantGainBelief(np.array(filter.initial.mean), gain)

    def settings(self) -> dict[str, Any]:
        """Arguments of the constructor by name."""
        return {"filter": self.filter, "gain": self.initial.gain}

    @property
    def estimator_key(self) -> str:
        """What distinguishes its code from another's."""
        return f"constant gain {self.period!r} {self.filter.sub_steps}"

    def initial_at(self, mean: np.ndarray) -> Any:
        """The initial belief with another mean (n,)."""
        return ConstantGainBelief(self.filter.initial_at(mean).mean, self.initial.gain)

    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """x̂(k|k) → x̂(k+1|k), pure, on any element."""
        return ConstantGainBelief(self.filter.transition(belief.mean, u, p), belief.gain)

    def measurement_update(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> Any:
        """x̂(k|k−1) → x̂(k|k), pure, on any element."""
        innovation = y - self.filter.output(belief.mean, u, self.plant.parameters.flat(p))
        return ConstantGainBelief(belief.mean + belief.gain @ innovation, belief.gain)
