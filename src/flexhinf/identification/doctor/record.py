"""What the checks of a log see of it: each signal with its file's column, its known values, its steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from flexhinf.identification.log import FileColumn, Log
from flexhinf.identification.quantisation import smallest_step
from flexhinf.identification.vibrations import vibration_periods
from flexhinf.numerals import number_text
from flexhinf.robot import Robot
from flexhinf.robot.signals import MECHANICAL

#: A gap is so many times as long as the time between most rows.
GAP = 10.0

#: Fewest different values of a signal by which it is said to have steps, and how far they may lie off the grid.
FEWEST_VALUES, OFF_GRID = 3, 0.02


@dataclass(frozen=True, eq=False)
class LoggedSignal:
    """One signal of a log.

    `name`: of the plant. `is_input`: whether it drives the robot. `unit`: SI. `rows` (K,): of the log, in which it has
    a value. `values` (K,): these, SI. `column`: of the file, with the size of its unit.
    """

    name: str
    is_input: bool
    unit: str
    rows: np.ndarray
    values: np.ndarray
    column: FileColumn

    @cached_property
    def moves(self) -> np.ndarray:
        """Changes (K − 1,) from value to value, without their sign."""
        return np.abs(np.diff(self.values))

    @cached_property
    def span(self) -> float:
        """Largest minus smallest value."""
        return float(np.ptp(self.values)) if self.values.size else 0.0

    @cached_property
    def step(self) -> float:
        """The smallest step between two values, 0 where all are equal."""
        return smallest_step(self.values)

    @cached_property
    def coarse(self) -> bool:
        """Whether all values lie on a grid, of an encoder or of printed digits, and many are equal."""
        different = np.unique(self.values)
        if self.step == 0.0 or not FEWEST_VALUES <= different.size <= 0.5 * self.values.size + 2:
            return False
        places = (different - different[0]) / self.step
        return bool(np.abs(places - np.rint(places)).max() < OFF_GRID * max(1.0, 1e-3 * places.max()))

    def filled(self, count: int) -> np.ndarray:
        """Values (count,) in all rows of the log, straight lines between those that there are."""
        return np.interp(np.arange(count), self.rows, self.values)

    @property
    def label(self) -> str:
        """The signal's name in a sentence."""
        return self.name.replace("_", " ")

    @property
    def subject(self) -> str:
        """The signal's name at the beginning of a sentence."""
        return self.label[:1].upper() + self.label[1:]

    @property
    def quantity(self) -> str:
        """What is measured of a joint, such as "link_position"; the name itself of other signals."""
        return next((q for q in MECHANICAL if self.name == q or self.name.startswith(f"{q}_")), self.name)

    @property
    def joint(self) -> str:
        """The joint, empty where there is one only."""
        return self.name.removeprefix(self.quantity).removeprefix("_")

    def text(self, value: float, digits: int = 4) -> str:
        """A value with its unit."""
        return number_text(float(f"{value:.{digits}g}"), self.unit)

    def in_file(self, value: float) -> float:
        """A value in the unit of the file."""
        return value / self.column.size

    def without(self, gone: np.ndarray) -> LoggedSignal:
        """The channel without some of its values (K,)."""
        return replace(self, rows=self.rows[~gone], values=self.values[~gone])

    def rows_of(self, places: np.ndarray) -> tuple[int, int]:
        """The first and last row of places among its values."""
        return int(self.rows[places.min()]), int(self.rows[places.max()])


@dataclass(frozen=True, eq=False)
class LogRecord:
    """A log and its robot, if there is one, with the channels of all signals."""

    log: Log
    robot: Robot | None
    channels: Sequence[LoggedSignal]

    @staticmethod
    def of(log: Log, robot: Robot | None) -> LogRecord:
        """Of a log as it is."""
        channels: list[LoggedSignal] = []
        for kind, table in (("input", log.inputs), ("output", log.outputs)):
            names = log.names.get(kind) or tuple(f"{kind} {k + 1}" for k in range(table.shape[1]))
            for name, values in zip(names, table.T):
                rows = np.flatnonzero(np.isfinite(values))
                unit = _unit(robot, name)
                column = log.columns.get(name, FileColumn(name))
                channels.append(LoggedSignal(name, kind == "input", unit, rows, values[rows], column))
        return LogRecord(log, robot, channels)

    @property
    def outputs(self) -> list[LoggedSignal]:
        """The channels of what is measured."""
        return [channel for channel in self.channels if not channel.is_input]

    @property
    def inputs(self) -> list[LoggedSignal]:
        """The channels of what drives the robot."""
        return [channel for channel in self.channels if channel.is_input]

    @cached_property
    def steps(self) -> np.ndarray:
        """Times (N − 1,) from row to row, s."""
        return np.diff(self.log.times)

    @cached_property
    def period(self) -> float:
        """The median of the steps, s."""
        return float(np.median(self.steps))

    @cached_property
    def gaps(self) -> np.ndarray:
        """Which steps (N − 1,) are so much longer than most that they are gaps."""
        return self.steps > GAP * float(np.quantile(self.steps, 0.9, method="lower"))

    @cached_property
    def vibrations(self) -> np.ndarray | None:
        """Periods of the robot's vibrations, s, the shortest first; None without a robot."""
        return None if self.robot is None else vibration_periods(self.robot)


def _unit(robot: Robot | None, name: str) -> str:
    """Unit of a signal of a robot."""
    if robot is None:
        return ""
    plant = robot.plant()
    return plant.unit(name)
