"""What lies between a robot and its controller: the grain of its sensors, and the delay of its inputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.untrusted import real_array, real_number

__all__ = ["DIRECT", "MOST_QUEUED", "WHOLE", "Channel", "check_delay"]

#: Most inputs that may wait in a delay, those of all motors together: the queue is part of the compiled code, and each
#: input in it is a state of the linear loop. A longer delay is most likely a wrong unit.
MOST_QUEUED = 200

#: A delay this close to a whole number of samples (in samples) is one.
WHOLE = 1e-6


def check_delay(samples: float, inputs: int, period: float) -> None:
    """Refuse a delay with more than `MOST_QUEUED` waiting inputs.

    Parameters
    ----------
    samples : float
        Length of the delay.
    inputs : int
        How many inputs are delayed.
    period : float
        s.

    Raises
    ------
    InvalidInput
        With the unit that was probably meant.
    """
    most = MOST_QUEUED // inputs
    if samples <= most * (1.0 + WHOLE):
        return
    late, of = period * samples, f" with {inputs} inputs" if inputs > 1 else ""
    raise InvalidInput(
        "The input delay is out of proportion to the period.",
        f"expected at most {most} samples = {most * period:g} s{of}, got {late:g} s = {round(samples)} samples of "
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
    def of(
        quantisation: Any, delay: Any, period: float, measured: tuple[str, ...], inputs: int = 1
    ) -> Channel:
        """From user's numbers.

        Parameters
        ----------
        quantisation : None, float, or (p,) array
            Step of the measurements.
        delay : float
            s; a whole number of periods, with at most `MOST_QUEUED` inputs in all.
        period : float
            s.
        measured : tuple of str
        inputs : int
            How many inputs are delayed.

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
                f"expected one step >= 0 or one for each of {list(measured)}, got {quantisation!r}",
                "quantisation=2 * np.pi / 4096 for an encoder of 12 bits",
            )
        samples = late / period
        if not (np.isfinite(samples) and samples >= 0.0 and abs(samples - round(samples)) <= WHOLE):
            raise InvalidInput(
                "The input delay is not a whole number of samples.",
                f"expected a multiple of {period:g} s, got {delay!r} s",
                f"delay={period:g} for one sample",
            )
        check_delay(samples, inputs, period)
        quanta = () if quantisation is None else tuple(np.broadcast_to(steps, (len(measured),)).tolist())
        return Channel(quanta if any(quanta) else (), round(samples))

    def quantised(self, y: Any) -> Any:
        """Measurements (p,) rounded to their steps, on any element."""
        if not self.quanta:
            return y
        rounded = [q * np.floor(value / q + 0.5) if q > 0.0 else value for value, q in zip(y, self.quanta)]
        return np.array(rounded)

    def delayed(self, queue: Any, u: Any) -> tuple[Any, Any]:
        """The input that acts now (m,), and the queue (delay · m,) for the next sample."""
        waiting = np.concatenate([queue, u])
        return waiting[: len(u)], waiting[len(u) :]

    def settings(self) -> dict[str, Any]:
        """For the record of a run."""
        return {"quantisation": list(self.quanta) or "none", "input_delay_samples": self.delay}


#: Nothing in between.
DIRECT = Channel((), 0)
