"""An estimator of more states than the law has: which are the law's, and the input that balances an estimated load.

The law reads its own states by their names, wherever they stand in the estimate. What else is estimated (a load, a
stiffness, an offset of an encoder) makes the estimate of its states right, and nothing more: the law stays as it is.

A load moves the equilibrium. With f(x, u, z) of the estimator's model, z the loads, and rows E of the states that are
held (the tracked ones), the equilibrium at the same position moves by X z and U z,

    [ ∂f/∂x  ∂f/∂u ] [ X ]     [ ∂f/∂z ]
    [   E      0   ] [ U ]  = −[   0   ],

at the law's operating point. A controller that compensates the loads acts about x* + X z and u* + U z. On a robot with
linear springs X and U are the same at every pose: a torque d on a link asks for −d at the motor, and the motor stands
by −d/K beside where it stood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant import Estimator, Law, Plant
from flexhinf.validation import checked_names, distinct, one_of, value_text


@dataclass(frozen=True, eq=False)
class EstimatedStates:
    """Names of the estimated states (N,), and `places` (n,) of the law's among them; empty where they are the same."""

    names: tuple[str, ...]
    places: tuple[int, ...]
    start: np.ndarray

    @staticmethod
    def of(law: Law, estimator: Estimator | None) -> EstimatedStates:
        """Of an estimator with the law's states, or of the state that is fed back."""
        own = law.plant_states
        if estimator is None:
            return EstimatedStates(own, (), np.asarray(law.operating_point, dtype=float)[: len(own)])
        names, start = tuple(estimator.plant.states), np.asarray(estimator.initial[0], dtype=float)
        places = () if names == own else tuple(names.index(name) for name in own)
        return EstimatedStates(names, places, start)

    def whole(self, x: Any) -> np.ndarray:
        """The law's state x (n,) among the estimated ones (N,), the others where the estimate begins."""
        if not self.places:
            return np.array(x, dtype=float)
        whole = self.start.copy()
        whole[list(self.places)] = x
        return whole

    def own(self, whole: Any) -> Any:
        """The law's states (n, ...) of an estimate (N, ...), on any element."""
        return np.asarray(whole)[list(self.places)] if self.places else whole


def constant_states(model: Plant, x: np.ndarray, u: np.ndarray) -> list[int]:
    """Places of the states that stay what they are, whatever else is: parameters, loads and offsets."""
    rows = np.hstack(model.change_slopes(x, u))
    return np.flatnonzero(~rows.any(axis=1) & (model.change(x, u) == 0.0)).tolist()


#: Part of a load that may be left, relative to the load, where the inputs balance it.
BALANCED = 1e-9


def compensated_places(compensate: Any, law: Law, estimator: Estimator | None) -> tuple[int, ...]:
    """Places in the estimate of the loads that are compensated, by name or by group; () for None.

    Raises InvalidInput: without an estimator; for a name that is no load that is estimated beside the law's states.
    """
    if compensate is None:
        return ()
    if estimator is None:
        raise InvalidInput(
            "Nothing estimates the loads that are to be compensated.",
            f"expected compensate=None without an estimator, got {value_text(compensate)}",
            "an estimator of plant.augmented(disturbances=('link_torque',))",
        )
    plant, own = estimator.plant, law.plant_states
    names = plant.expanded(checked_names("The compensated loads", compensate))
    distinct("Of the compensated loads, the name", names)
    loads = [name for name in plant.states if name in plant.disturbances and name not in own]
    for name in names:
        one_of(
            f"No load {name!r} is estimated.",
            name,
            loads,
            "an estimator of plant.augmented(disturbances=(...)), whose state has the name of the disturbance",
        )
    return tuple(plant.index(name) for name in names)


def balance(
    laws: Sequence[Law], estimator: Estimator, states: EstimatedStates, places: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """X (n, k) and U (m, k) of the loads at these places of the estimate.

    Raises InvalidInput: if the inputs cannot balance a load, or if several laws would do so differently.
    """
    every = [_balance(law, estimator.plant, states, list(places)) for law in laws]
    first = np.vstack(every[0])
    for other in map(np.vstack, every[1:]):
        refuse_if(
            np.abs(other - first).max() > 1e-6 * np.abs(first).max(),
            "The laws of the schedule balance a load in different ways.",
            f"expected the same moves of state and input, got {first.tolist()} and {other.tolist()}",
            "compensate=None, or one law",
        )
    return every[0]


def _balance(
    law: Law, model: Plant, states: EstimatedStates, places: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    own = law.plant_states
    point, u = (np.asarray(part, dtype=float) for part in (law.operating_point, law.operating_input))
    x = states.whole(point[: len(own)])
    x[places] = 0.0
    a, b, _ = model.change_slopes(x, u)
    still = {*constant_states(model, x, u), *places}
    free = [i for i in range(model.n) if i not in still]
    held = [free.index(model.index(name)) for name in law.tracked or own[: len(u)]]
    rows = np.block([
        [a[np.ix_(free, free)], b[free]],
        [np.eye(len(free))[held], np.zeros((len(held), len(u)))],
    ])  # fmt: skip
    acting = np.vstack([-a[np.ix_(free, places)], np.zeros((len(held), len(places)))])
    moved = np.linalg.lstsq(rows, acting, rcond=None)[0]
    left = np.abs(rows @ moved - acting).max(axis=0)
    worst = int(np.argmax(left))
    refuse_if(
        not left[worst] <= BALANCED * max(1.0, np.abs(acting).max()),
        f"The inputs cannot balance the load {model.states[places[worst]]!r}.",
        f"expected an equilibrium with {list(law.tracked or own[: len(u)])} held, {left[worst]:.3g} is left per unit "
        "of the load",
        "compensate=(...) without it",
    )
    by_name = {model.states[place]: row for place, row in zip(free, moved)}
    return np.array([by_name.get(name, np.zeros(len(places))) for name in own]), moved[len(free) :]
