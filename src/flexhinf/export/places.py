"""Where the numbers of a controller's step lie, by constants of C."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.codegen import BufferPart
from flexhinf.codegen.naming import Names
from flexhinf.export.names import (
    MEMORY,
    ROWS,
    constants,
    named_parameters,
    parameter_units,
    unread_parameters,
)
from flexhinf.loop import Controller

if TYPE_CHECKING:
    from flexhinf.robot import Robot

#: A constant, its value, and its comment.
Row = tuple[str, int, str]


def _rows(name: str, place: slice) -> list[tuple[str, int, int, str]]:
    """Name, begin, size and comment of each row of a part that is a table."""
    rows = list(ROWS.get(name, {}).items())[
        : place.stop - place.start
    ]  # of a status, the first ones may be all
    size = (place.stop - place.start) // max(1, len(rows))
    return [(f"{name}_{row}", place.start + k * size, size, text) for k, (row, text) in enumerate(rows)]


class Places:
    """Constants of C for places in the memory and the numbers of a controller's step; their names begin with `prefix`.

    `signals`: Names of the elements of y, r, u and the state, by the letter in their constants. `sizes`: Numbers in
    each vector of the step, by its name.
    """

    def __init__(
        self,
        controller: Controller,
        prefix: str,
        signals: Mapping[str, tuple[str, ...]],
        sizes: Mapping[str, int],
        robot: Robot | None,
    ) -> None:
        self.controller, self.prefix, self.signals, self.sizes = controller, prefix, signals, sizes
        self.robot = robot

    @property
    def doubt(self) -> int | None:
        """Where the memory says whether the estimate is in doubt, and at how many samples it was, (2,); None of an
        estimator that does not say."""
        place = self.controller.memory.places.get("doubt")
        return None if place is None else place.start

    @property
    def rejected(self) -> int | None:
        """Where the memory counts rejected measurements, (p,); None without a gate and limits of measurements."""
        if self.controller.mode.checks_measurements:
            return self.controller.memory.places["readings"].start + 2 * self.sizes["y"]
        return self._of_belief("rejected")

    def _at(self, part: str) -> str:
        """The constant for where a part of the memory begins."""
        return f"{self.prefix}_AT_{part.upper()}"

    def _of_belief(self, part: str) -> int | None:
        """Where a part of the belief begins in the memory; None without it."""
        name = self._at(f"{part}_of_belief")
        return next((place for constant, place, _ in self.belief() if constant == name), None)

    def memory(self) -> list[Row]:
        """The parts of the memory, and the places of the estimated states in it."""
        return [*self._memory(), *self._states()]

    def _states(self) -> list[Row]:
        mean, states = self._of_belief("mean"), self.signals["X"]
        if mean is None:
            return []
        named = zip(constants(self._at("x"), states), states)
        return [(name, mean + k, f"mean of {state}") for k, (name, state) in enumerate(named)]

    def _memory(self) -> list[Row]:
        rows: list[Row] = []
        for name, place in self.controller.memory.places.items():
            rows.append((self._at(name), place.start, MEMORY[name]))
            rows += self.belief() if name == "belief" else []
            rows += [(self._at(row), begin, text) for row, begin, _, text in _rows(name, place)]
        if self.rejected is not None:
            rows.append((self._at("rejected"), self.rejected, "how many of each measurement were rejected"))
        return rows

    def belief(self) -> list[Row]:
        """The parts of what the estimator believes, with their sizes."""
        estimator, rows = self.controller.estimator, list[Row]()
        if estimator is not None:
            place = self.controller.memory.places["belief"].start
            for name, part in zip(estimator.initial._fields, estimator.initial):
                shape = " x ".join(map(str, np.shape(part) or (1,)))
                rows.append((self._at(f"{name}_of_belief"), place, shape))
                place += np.size(part)
        return rows

    def numbers(self) -> list[Row]:
        """The parts of the numbers of the step, and how many there are in each; of tables the rows too."""
        rows: list[Row] = []
        for name, place in self.controller.data.places.items():
            if place.stop > place.start:
                rows.append((f"{self.prefix}_P_{name.upper()}", place.start, str(place.stop - place.start)))
                rows += [
                    (f"{self.prefix}_P_{row.upper()}", begin, f"{size}: {text}")
                    for row, begin, size, text in _rows(name, place)
                ]
        return rows

    def _pieces(self) -> list[tuple[str, int, int]]:
        """Name, begin and size of each part of the numbers of the step, and of each row where it is a table."""
        pieces: list[tuple[str, int, int]] = []
        for name, place in self.controller.data.places.items():
            rows = [row[:3] for row in _rows(name, place)] if place.stop > place.start else []
            pieces += rows or [(name, place.start, place.stop - place.start)]
        return pieces

    def parameters(self) -> list[Row]:
        """Parameters of the estimator's model with their units, which are a part of the numbers."""
        taken = {name for name, *_ in self.numbers()}
        names = Names(taken)
        named = list(named_parameters(self.controller, parameter_units(self.controller, self.robot)))
        texts = constants(f"{self.prefix}_P", [name for name, *_ in named])
        first = self.controller.data.places["parameters"].start if named else 0
        unread = unread_parameters(self.controller)
        return [
            (
                names.allot(f"{text}_OF_MODEL" if text in taken else text),
                first + k,
                (unit or "no unit stated") + "; the model leaves it out" * (k in unread),
            )
            for text, (_, k, unit) in zip(texts, named, strict=True)
        ]

    def parts(self) -> dict[str, tuple[BufferPart, ...]]:
        """The parts of the buffers of the step's program."""
        whole = {*map(self._at, (*ROWS, *(("belief", "rejected") if self.belief() else ())))}
        memory = tuple(BufferPart(name, place) for name, place, _ in self._memory() if name not in whole)
        data = tuple(
            BufferPart(f"{self.prefix}_P_{name.upper()}", begin)
            for name, begin, size in self._pieces()
            if size
        )
        return {"memory": memory, "after": memory, "data": data}

    def elements(self) -> dict[str, list[str]]:
        """What the elements of the step's vectors are called in the source, by vector."""
        parts = [*self.parts()["memory"], BufferPart("", self.sizes["memory"])]
        memory = [
            part.name + f" + {k}" * (k > 0)
            for part, after in pairwise(parts)
            for k in range(after.offset - part.offset)
        ]
        for name, place, _ in self._states():
            memory[place] = name
        data = [
            f"{name}[{k}]" if name in self.long_parts() else f"{self.prefix}_P_{name.upper()}"
            for name, _, size in self._pieces()
            for k in range(size)
        ]
        for name, place, _ in self.parameters():
            data[place] = name
        known = {kind.lower(): constants(f"{self.prefix}_{kind}", self.signals[kind]) for kind in "YRU"}
        known["estimated"] = constants(f"{self.prefix}_X", self.signals["X"])
        known |= {"memory": memory, "after": memory, "data": data}
        sizes = {**self.sizes, "estimated": self.sizes["estimate"], "after": self.sizes["memory"]}
        return {name: texts for name, texts in known.items() if len(texts) == sizes[name]}

    def constants_of_sizes(self) -> dict[str, str]:
        """The header's constants for how many numbers each vector of the step has."""
        names = {
            "y": "MEASUREMENTS",
            "u": "INPUTS",
            "estimate": "STATES",
            "estimated": "STATES",
            "memory": "MEMORY",
            "after": "MEMORY",
            "data": "PARAMETERS",
        }
        commands = {"r": "COMMANDS"} if self.signals["R"] else {}
        return {buffer: f"{self.prefix}_{name}" for buffer, name in (names | commands).items()}

    def long_parts(self) -> dict[str, str]:
        """Where those parts of the numbers of the step are that have several."""
        several = [name for name, _, size in self._pieces() if size > 1]
        return {name: f"data + {self.prefix}_P_{name.upper()}" for name in several}
