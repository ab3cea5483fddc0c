"""What each plant of an ensemble has of its own: parameters, seed, initial state, loads, sub-steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.loop.controller.controller import Controller
from flexhinf.loop.signals.sampling import check_seed
from flexhinf.loop.simulation.run_arguments import operating_state
from flexhinf.plant import Plant, fastest_modes, sub_steps
from flexhinf.untrusted import real_array, value_text


@dataclass(frozen=True, eq=False)
class EnsemblePlants:
    """N plants.

    Attributes
    ----------
    truth : (N, P) array
        Parameters.
    parts : (N,) array of int
        Runge–Kutta steps of a sample.
    seeds : tuple of int
        Of the noise.
    own : mapping of str to array
        What else they have of their own, by buffer, rows of N.
    """

    truth: np.ndarray
    parts: np.ndarray
    seeds: tuple[int, ...]
    own: Mapping[str, np.ndarray]

    @classmethod
    def of(
        cls,
        plant: Plant,
        controller: Controller,
        start: Mapping[str, np.ndarray],
        asked_sub_steps: int | None,
        given: tuple[Any, Any, Any, Any, Any],
        disturbed: bool,
    ) -> EnsemblePlants:
        """From what a user gives.

        Parameters
        ----------
        plant, controller
            The nominal true plant, and the controller of all.
        start : mapping of str to array
            What a run starts with, by buffer.
        asked_sub_steps : int or None
            Of all plants.
        given : tuple
            Parameters, seeds, initial states, loads and initial inputs, see `Ensemble.run`.
        disturbed : bool
            Whether there is a disturbance that loads could be factors of.

        Raises
        ------
        InvalidInput
            For arrays that do not fit, and for a plant that is too fast for this period.
        """
        parameters, seeds, states, loads, inputs = given
        truth = _parameters(plant, parameters)
        count = len(truth)
        own = {"x": _rows("initial states", states, count, start["x"])}
        if disturbed:
            own["load"] = _rows("loads", loads, count, np.ones(len(plant.disturbances)))
        elif loads is not None:
            raise InvalidInput(
                "There is no disturbance that loads could be factors of.",
                "expected loads=None",
                "a disturbance in Loop.ensemble",
            )
        if inputs is not None:
            rows = _rows("initial inputs", inputs, count, start["held"])
            memory = [controller.initial_memory(input=row) for row in rows]
            own["held"] = np.array([controller.input_before(row) for row in rows]).reshape(rows.shape)
            own["memory"] = np.array(memory).reshape(count, -1)
        return cls(truth, _parts(plant, controller, truth, asked_sub_steps), _seeds(seeds, count), own)

    def __len__(self) -> int:
        return len(self.truth)

    def some(self, rows: slice) -> EnsemblePlants:
        """Some of them."""
        own = {name: values[rows] for name, values in self.own.items()}
        return EnsemblePlants(self.truth[rows], self.parts[rows], self.seeds[rows], own)


def _parameters(plant: Plant, parameters: Any) -> np.ndarray:
    table = plant.parameters
    if isinstance(parameters, Sequence) and all(isinstance(row, Mapping) for row in parameters):
        return table.vectors(parameters)
    rows = real_array(parameters)
    if rows.ndim != 2 or rows.shape[1] != table.size or not np.all(np.isfinite(rows)):
        raise InvalidInput(
            "The parameters do not fit the plant.",
            f"expected rows of {table.size} finite numbers for {list(table.names)}, got {value_text(parameters)}",
            "plant.parameters.vectors([...]), or mappings by name",
        )
    return rows


def _rows(what: str, given: Any, count: int, default: np.ndarray) -> np.ndarray:
    if given is None:
        return np.broadcast_to(default, (count, len(default)))
    rows = real_array(given)
    if rows.shape != (count, len(default)) or not np.all(np.isfinite(rows)):
        raise InvalidInput(
            f"The {what} do not fit the plants.",
            f"expected finite numbers of shape {(count, len(default))}, got {value_text(given)}",
            "one row for each plant",
        )
    return rows


def _parts(plant: Plant, controller: Controller, truth: np.ndarray, asked: int | None) -> np.ndarray:
    """Sub-steps of each plant, (N,): those of a `Loop` of this plant alone."""
    if asked is not None:
        return np.full(len(truth), asked)
    point = operating_state(plant.states, controller)
    modes = fastest_modes(plant, truth, point, controller.law.operating_input)
    return np.array([sub_steps(controller.period, mode) for mode in modes.tolist()], dtype=int)


def _seeds(seeds: Any, count: int) -> tuple[int, ...]:
    given = [seeds] * count if np.ndim(seeds) == 0 else list(seeds)
    for seed in given[:1] if np.ndim(seeds) == 0 else given:
        check_seed(seed)
    if len(given) != count:
        raise InvalidInput(
            "The seeds do not fit the plants.",
            f"expected {count} integers, got {len(given)}",
            "one for each plant",
        )
    return tuple(int(seed) for seed in given)
