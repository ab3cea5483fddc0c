"""What lies between a robot and its controller: the grain of its sensors, and the delay of its inputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.untrusted import real_array, real_number, value_text

#: Longest delay of a run, samples. The inputs that wait are rows of the run's own record: a delay compiles nothing and
#: costs little, but a longer one is most likely a wrong unit. In a linear loop every input that waits is a state.
LONGEST, LONGEST_LINEAR = 100_000, 200

#: A delay this close to a whole number of samples (in samples) is one.
WHOLE = 1e-6


def check_delay(samples: float, period: float, most: int = LONGEST) -> None:
    """Refuse a delay of more samples than a run (or a linear loop, `LONGEST_LINEAR`) can have.

    Parameters
    ----------
    samples : float
        Length of the delay.
    period : float
        s.

    Raises
    ------
    InvalidInput
        With the unit that was probably meant.
    """
    if samples <= most * (1.0 + WHOLE):
        return
    late = period * samples
    raise InvalidInput(
        "The input delay is out of proportion to the period.",
        f"expected at most {most} samples = {most * period:g} s, got {late:g} s = {samples:.0f} samples of "
        f"{period:g} s",
        f"delay={1e-3 * late:g} if {late:g} ms was meant; for a longer delay a longer period",
    )


@dataclass(frozen=True)
class Channel:
    """Quantised measurements and delayed inputs; neither is known to the estimator.

    Attributes
    ----------
    quanta : tuple of float
        Step of each measurement, in its unit; 0 for one that is not quantised.
    delay : int
        Samples between an input and its effect. Until the first one acts the input before the first sample does.
    """

    quanta: tuple[float, ...]
    delay: int

    @staticmethod
    def of(quantisation: Any, delay: Any, period: float, measured: tuple[str, ...]) -> Channel:
        """From user's numbers.

        Parameters
        ----------
        quantisation : None, float, or (p,) array
            Step of the measurements.
        delay : float
            s; a whole number of periods, at most `LONGEST`.
        period : float
            s.

        Raises
        ------
        InvalidInput
            If they do not fit.
        """
        steps = np.zeros(0) if quantisation is None else real_array(quantisation)
        late = real_number(delay)
        if (
            steps.shape not in ((0,), (), (len(measured),))
            or not np.all(np.isfinite(steps))
            or np.any(steps < 0)
        ):
            raise InvalidInput(
                "The quantisation does not fit the measurements.",
                f"expected one step >= 0 or one for each of {list(measured)}, got {value_text(quantisation)}",
                "quantisation=2 * np.pi / 4096 for an encoder of 12 bits",
            )
        samples = late / period
        if not (np.isfinite(samples) and samples >= 0.0 and abs(samples - round(samples)) <= WHOLE):
            raise InvalidInput(
                "The input delay is not a whole number of samples.",
                f"expected a multiple of {period:g} s, got {value_text(delay)} s",
                f"delay={period:g} for one sample",
            )
        check_delay(samples, period)
        quanta = () if quantisation is None else tuple(np.broadcast_to(steps, (len(measured),)).tolist())
        return Channel(quanta if any(quanta) else (), round(samples))

    def quantised(self, y: Any) -> Any:
        """Measurements (p,) rounded to their steps, on any element."""
        if not self.quanta:
            return y
        rounded = [q * np.floor(value / q + 0.5) if q > 0.0 else value for value, q in zip(y, self.quanta)]
        return np.array(rounded)

    def settings(self) -> dict[str, Any]:
        """For the record of a run."""
        return {"quantisation": list(self.quanta) or "none", "input_delay_samples": self.delay}


#: Nothing in between.
DIRECT = Channel((), 0)
