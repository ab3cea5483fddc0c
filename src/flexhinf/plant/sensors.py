"""Sensors as robots have them: each with its own period, delay, noise and quantisation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.notebook import StatedRepr
from flexhinf.validation import checked_kind, checked_text, distinct, one_of, real_array, value_text

#: A time this close to a whole number of samples (in samples) is one.
WHOLE = 1e-6

#: Longest period and longest delay of a sensor, samples: each sample of delay is a state of the estimator.
LONGEST_PERIOD, LONGEST_DELAY = 10_000, 100


@dataclass(frozen=True, repr=False)
class Sensor(StatedRepr):
    """A measured signal, or a group of them, and how its sensor measures it.

    Parameters
    ----------
    name : str
        Of a measured signal of the plant, or of a group, such as ``motor_position`` of all joints.
    period : float, optional
        s, a multiple of the estimator's or loop's; the signal is there at samples 0, period, …. By default it is there
        at every sample.
    delay : float
        s, a multiple of the estimator's or loop's period: what is there at a sample is what was so long before.
    noise : float
        Standard deviation, in the signal's unit.
    quantisation : float
        Step of the values, in the signal's unit: 2π/4096 for an encoder of 12 bits. Its error counts as noise of
        variance q²/12.

    Raises
    ------
    InvalidInput
        If one of them is no such number.

    Examples
    --------
    >>> import flexhinf as fh
    >>> sensors = (
    ...     fh.Sensor("motor_position", noise=1e-5, quantisation=2e-5),
    ...     fh.Sensor("link_position", period=4e-3, delay=2e-3, noise=1e-4),
    ... )
    >>> plant = fh.load_robot("paper").plant(("link_position", "motor_position"))
    >>> ukf = fh.UnscentedKalmanFilter(plant, 1e-3, 1e-8, None, [0.0] * 4, 1e-4, sensors=sensors)
    >>> ukf.plant.states[4:]
    ('link_position_past_1', 'link_position_past_2')
    """

    name: str
    period: float | None = None
    delay: float = 0.0
    noise: float = 0.0
    quantisation: float = 0.0

    def __post_init__(self) -> None:
        checked_text("the name of a sensor's signal", self.name)
        for what in ("period", "delay", "noise", "quantisation"):
            value = getattr(self, what)
            if what == "period" and value is None:
                continue
            try:
                number = float(real_array(value))
            except (TypeError, ValueError):
                number = np.nan
            refuse_if(
                isinstance(value, bool)
                or not (0.0 < number < np.inf or (number == 0.0 and what != "period")),
                f"The {what} of the sensor {self.name!r} is no such number.",
                f"expected {'seconds > 0' if what == 'period' else 'a finite number >= 0'}, got {value_text(value)}",
                f"{what}=1e-3",
            )
            object.__setattr__(self, what, number)


@dataclass(frozen=True, eq=False)
class SensorTable:
    """Sensors by the elements of a measurement, (p,) each: standard deviations, quantisation steps, and periods and
    delays in samples."""

    deviations: np.ndarray
    quanta: np.ndarray
    periods: np.ndarray
    delays: np.ndarray

    @staticmethod
    def of(
        sensors: Sequence[Sensor] | Sensor,
        outputs: Sequence[str],
        expanded: Callable[[str], tuple[str, ...]],
        period: float,
        near: float = WHOLE,
    ) -> SensorTable:
        """The table of these outputs, sampled every `period`, s; `expanded` gives the signals of a group.

        A time within `near` samples of a whole number of them is one. Raises InvalidInput: if an output has no sensor,
        or two; for a name that is none; and for a period or delay that is not a whole number of samples.
        """
        several = (sensors,) if isinstance(sensors, Sensor) else sensors
        checked_kind(
            "The sensors are no sequence of sensors.",
            several,
            Sequence,
            "a tuple of fh.Sensor",
            "sensors=(fh.Sensor('motor_position', noise=1e-5),)",
        )
        found: list[tuple[str, Sensor]] = []
        for sensor in several:
            checked_kind(
                "The sensors are no sequence of sensors.",
                sensor,
                Sensor,
                "a tuple of fh.Sensor",
                "sensors=(fh.Sensor('motor_position', noise=1e-5),)",
            )
            for name in expanded(sensor.name):
                one_of(f"There is no measured signal {name!r}.", name, outputs)
                found.append((name, sensor))
        distinct("Of the sensors' signals, the name", tuple(name for name, _ in found))
        table = dict(found)
        missing = [name for name in outputs if name not in table]
        refuse_if(
            missing,
            "Some measured signals have no sensor.",
            f"expected one for each of {list(outputs)}, got none for {missing}",
            f"fh.Sensor({missing[0] if missing else ''!r}, noise=…)",
        )
        rows = [table[name] for name in outputs]
        periods, delays = (
            np.array(
                [_samples(sensor, what, getattr(sensor, what), period, near) for sensor in rows], dtype=int
            )
            for what in ("period", "delay")
        )
        deviations, quanta = (
            np.array([getattr(sensor, what) for sensor in rows]) for what in ("noise", "quantisation")
        )
        return SensorTable(deviations, quanta, periods, delays)

    @property
    def variances(self) -> np.ndarray:
        """R^n of noise and quantisation, (p,)."""
        return self.deviations**2 + self.quanta**2 / 12.0


def _samples(sensor: Sensor, what: str, seconds: float | None, period: float, near: float) -> int:
    seconds = period if seconds is None else seconds
    number, most = seconds / period, {"period": LONGEST_PERIOD, "delay": LONGEST_DELAY}[what]
    if not abs(number - round(number)) <= near or round(number) > most:
        raise InvalidInput(
            f"The {what} of the sensor {sensor.name!r} is not a whole number of samples.",
            f"expected a multiple of {period:g} s, at most {most * period:g} s, got {seconds:g} s",
            f"{what}={max(1, round(min(number, most))) * period:g}",
        )
    return round(number)
