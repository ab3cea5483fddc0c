"""What is known of the sensors of a log, and its outputs at the times at which they were true."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.plant import Plant, Sensor, SensorTable

if TYPE_CHECKING:
    from flexhinf.estimation.filter import RecursiveFilter

#: A period or delay that is so close to a whole number of the log's samples is one: times of a log are not exact.
NEAR = 0.05


def known_sensors(sensors: Sequence[Sensor] | Sensor, plant: Plant, period: float) -> SensorTable:
    """The table of a plant's outputs in a log of one sample every `period`, s; of the others nothing is known.

    Raises InvalidInput: as `SensorTable.of`.
    """
    several = (sensors,) if isinstance(sensors, Sensor) else tuple(sensors)
    named = {name for sensor in several for name in plant.expanded(sensor.name)}
    others = [Sensor(name) for name in plant.outputs if name not in named]
    return SensorTable.of((*several, *others), plant.outputs, plant.expanded, period, NEAR)


def at_their_times(outputs: np.ndarray, sensors: SensorTable) -> np.ndarray:
    """Outputs (N, p) moved back by the delays of their sensors, NaN where none is or a value was held only."""
    held = np.arange(len(outputs))[:, None] % sensors.periods > 0
    return moved_back(np.where(held, np.nan, outputs), sensors.delays)


def moved_back(outputs: np.ndarray, delays: np.ndarray) -> np.ndarray:
    """Outputs (N, p) at the rows at which they were true, so many samples (p,) earlier; NaN where none is known."""
    moved = np.full_like(outputs, np.nan)
    for k, delay in enumerate(delays.tolist()):
        moved[: max(0, len(outputs) - delay), k] = outputs[delay:, k]
    return moved


def new_at_their_times(filter: RecursiveFilter, times: np.ndarray, outputs: np.ndarray) -> np.ndarray:
    """Outputs (N, p) at times (N,), s, with NaN where a sensor of the filter has no new value."""
    return filter.new_values(outputs, np.rint((times - times[0]) / filter.period).astype(int))
