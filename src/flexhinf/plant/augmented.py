"""Plants with more states: parameters, disturbances and offsets of outputs that an estimator is to estimate.

The new states are constant, ż = 0, or z⁺ = z of a map, and drift as a random walk by the process noise that a filter
adds to them. With θ the parameters, w the disturbances and b the offsets,

    ẋ = f(x, u, d + w, θ),        y = h(x, u, θ) + b.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from flexhinf.arrays import Elements
from flexhinf.errors import refuse_if
from flexhinf.plant.model import Model
from flexhinf.plant.parameters import AS_STATED, Parameters, ParameterTable
from flexhinf.validation import checked_names, distinct, one_of

AnyModel = TypeVar("AnyModel", bound=Model)


@dataclass(frozen=True)
class Augmentation:
    """A plant, and what of it becomes states behind its own: whole parameters, disturbances, offsets of outputs."""

    plant: Model
    parameters: tuple[str, ...]
    disturbances: tuple[str, ...]
    offsets: tuple[str, ...]

    @cached_property
    def elements(self) -> dict[str, tuple[str, ...]]:
        """Names of the states that each parameter becomes: its own, or ``NAME_1`` … of an array."""
        values = self.plant.parameters.values
        return {
            name: (name,)
            if not values[name].ndim
            else tuple(f"{name}_{k + 1}" for k in range(values[name].size))
            for name in self.parameters
        }

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the new states."""
        parameters = (element for elements in self.elements.values() for element in elements)
        return (*parameters, *self.disturbances, *(f"{name}_offset" for name in self.offsets))

    def inner(self, x: Elements, p: Parameters) -> tuple[Elements, Parameters]:
        """State (n,) of the plant, and its parameters, on any element."""
        values, at, estimated = self.plant.parameters.values, self.plant.n, {}
        for name in self.parameters:
            count = values[name].size
            part = np.asarray(x[at : at + count]).reshape(values[name].shape)
            estimated[name], at = part if part.ndim else part[()], at + count
        return x[: self.plant.n], Parameters({**vars(p), **estimated})

    def flow(self, x: Elements, u: Elements, d: Elements, p: Parameters) -> Elements:
        """ẋ, or x⁺ of a map, of all states on any element."""
        plant, known = self.plant, len(self.states) - len(self.disturbances) - len(self.offsets)
        inner, parameters = self.inner(x, p)
        loads = dict(zip(self.disturbances, x[plant.n + known :]))
        total = [own + loads.get(name, 0.0) for name, own in zip(plant.disturbances, d)]
        rates = plant.evaluate_flow(inner, u, np.array(total), plant.parameters.flat(parameters))
        return np.array([*rates, *(x[plant.n :] if plant.sampled else np.zeros(len(self.states)))])

    def output(self, x: Elements, u: Elements, p: Parameters) -> Elements:
        """The measured signals with their offsets, on any element."""
        inner, parameters = self.inner(x, p)
        y = self.plant.evaluate_output(inner, u, self.plant.parameters.flat(parameters))
        offsets = dict(zip(self.offsets, x[len(x) - len(self.offsets) :]))
        return np.array([value + offsets.get(name, 0.0) for name, value in zip(self.plant.outputs, y)])


@dataclass(frozen=True)
class _Within:
    """A function (x, …, p) → x of the plant, on all states: `engaged` and `arrest`."""

    augmentation: Augmentation
    function: Callable[..., Any]

    def __call__(self, x: Elements, *others: Any) -> Elements:  # what stands between x and p, then p
        *between, p = others
        inner, parameters = self.augmentation.inner(x, p)
        return np.concatenate([self.function(inner, *between, parameters), x[len(inner) :]])


def augmented_plant(
    plant: AnyModel, parameters: Sequence[str], disturbances: Sequence[str], offsets: Sequence[str]
) -> AnyModel:
    """See `flexhinf.Plant.augmented`."""
    named = checked_names("The estimated parameters", parameters)
    table, groups = plant.parameters.values, dict(plant.groups)
    for name in named:
        one_of(f"There is no parameter {name!r}.", name, table, AS_STATED)
    loads, sensors = plant.expanded(disturbances), plant.expanded(offsets)
    for what, names, known in (
        ("disturbance", loads, plant.disturbances),
        ("measured signal", sensors, plant.outputs),
    ):
        for name in names:
            one_of(f"There is no {what} {name!r}.", name, known)
    refuse_if(
        not (named or loads or sensors),
        "Nothing is to be estimated beside the state.",
        "expected parameters=(...), disturbances=(...) or offsets=(...), got none",
        "plant.augmented(disturbances=('link_torque',))",
    )
    for what, names in (("parameters", named), ("disturbances", loads), ("offsets", sensors)):
        distinct(f"Of the estimated {what}, the name", names)
    more = Augmentation(plant, named, loads, sensors)
    units = dict(plant.units)
    for name, elements in more.elements.items():
        groups |= {name: elements} if elements != (name,) else {}
        units |= {
            element: plant.unit(name) or plant.unit(f"{name}[{k + 1}]") for k, element in enumerate(elements)
        }
    units |= {f"{name}_offset": plant.unit(name) for name in sensors}
    groups |= {
        f"{name}_offset": tuple(f"{one}_offset" for one in plant.expanded(name))
        for name in checked_names("The offsets", offsets)
        if name in plant.groups
    }
    return replace(
        plant,
        flow=more.flow,
        output=more.output,
        states=(*plant.states, *more.states),
        parameters=ParameterTable({name: value for name, value in table.items() if name not in named}),
        units={name: unit for name, unit in units.items() if unit},
        groups=groups,
        engaged=None if plant.engaged is None else _Within(more, plant.engaged),
        arrest=None if plant.arrest is None else _Within(more, plant.arrest),
    )
