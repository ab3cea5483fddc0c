"""Base of the laws to compare with: a plant, the equilibrium they are made for, and what they integrate."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.plant import GeneralisedPlant, Law, Plant
from flexhinf.scalars import jacobian
from flexhinf.untrusted import read_only, real_array


def equilibrium_of(problem: GeneralisedPlant) -> tuple[np.ndarray, np.ndarray]:
    """(x*, u*) of a problem, (n,) and (m,) without integrals."""
    return problem.operating_point[: problem.plant.n], problem.operating_input


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class EquilibriumLaw(Law):
    """A `flexhinf.plant.Law` about an equilibrium of a plant.

    Parameters
    ----------
    plant : Plant
        The model that the law was made from.
    equilibrium : (x*, u*)
        State (n,) and input (m,) where the plant rests.
    integrate : sequence of str
        States whose tracking error is integrated, single names or groups; ``NAME_integral`` are the last states.

    Raises
    ------
    InvalidInput
        If names or shapes do not fit the plant.
    """

    plant: Plant
    equilibrium: tuple[Any, Any]
    integrate: Sequence[str] = ()

    def __post_init__(self) -> None:
        x, u = (real_array(part) for part in self.equilibrium)
        shapes = (self.plant.n,), (len(self.plant.inputs),)
        if (x.shape, u.shape) != shapes or not (np.all(np.isfinite(x)) and np.all(np.isfinite(u))):
            raise InvalidInput(
                "The equilibrium of the law does not fit its plant.",
                f"expected a finite state and input of shapes {shapes}, got {x.shape} and {u.shape}",
                "robot.operating_point(pose)",
            )
        object.__setattr__(self, "equilibrium", read_only((x, u)))
        object.__setattr__(self, "integrate", self.plant.expanded(self.integrate))
        for name in self.integrate:
            self.plant.index(name)

    @property
    def state_names(self) -> tuple[str, ...]:
        """States of the plant, then integrals."""
        return (*self.plant.states, *(f"{name}_integral" for name in self.integrate))

    @property
    def input_names(self) -> tuple[str, ...]:
        """Inputs of the plant."""
        return tuple(self.plant.inputs)

    @property
    def operating_point(self) -> np.ndarray:
        """x* with integrals (zero), (n,)."""
        return np.concatenate([self.equilibrium[0], np.zeros(len(self.integrate))])

    @property
    def operating_input(self) -> np.ndarray:
        """u*, (m,)."""
        return self.equilibrium[1]

    @cached_property
    def slope(self) -> np.ndarray:
        """∂k/∂x at the equilibrium, (m, n)."""
        n, data = len(self.state_names), self.law_data
        return jacobian(self.evaluate_law, n, data.size)(np.zeros(n), data)[1]

    def closed_loop(self, plant: Plant | None = None) -> np.ndarray:
        """∂ẋ/∂x of a plant (its own by default) with this law at the equilibrium, the state fed back, (n, n)."""
        a, b, _, _ = (self.plant if plant is None else plant).linearise(*self.equilibrium)
        states = len(a)
        loop = np.zeros((len(self.state_names),) * 2)
        loop[:states, :states] = a
        loop[:states] += b @ self.slope
        for row, name in enumerate(self.integrate, start=states):
            loop[row, self.plant.index(name)] = 1.0
        return loop


class LinearFeedback(EquilibriumLaw):
    """k(x) = K x. The gain is data, so all such laws of one size share their code."""

    @property
    @abc.abstractmethod
    def gain(self) -> np.ndarray:
        """K, (m, n)."""

    @property
    def law_data(self) -> np.ndarray:
        """K, flat."""
        return self.gain.ravel()

    @property
    def law_key(self) -> str:
        """One text for all numbers."""
        return "linear feedback"

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """K x on any element."""
        return data.reshape(len(self.input_names), -1) @ x


class PlacedLaw(EquilibriumLaw):
    """A law that depends on where it acts, not only on the deviation.

    `evaluate_about` says what it does about any reference; `evaluate_law` is that at the equilibrium,
    which therefore is part of the law's numbers.
    """

    @property
    @abc.abstractmethod
    def numbers(self) -> np.ndarray:
        """Numbers of the law without its equilibrium, flat."""

    @abc.abstractmethod
    def feedback(self, x: Any, state: Any, input: Any, numbers: Any) -> Any:
        """k (m,) for a deviation x (n,) from the reference (state, input), of any element."""

    @property
    def law_data(self) -> np.ndarray:
        """Numbers, then x* and u*, flat."""
        return np.concatenate([self.numbers, *self.equilibrium])

    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), (m,), about the equilibrium."""
        inputs = len(self.input_names)
        return self.evaluate_about(x, data[-self.plant.n - inputs : -inputs], data[-inputs:], data)

    def evaluate_about(self, x: Any, state: Any, input: Any, data: Any) -> Any:
        """k (m,) for a deviation x (n,), integrals last, from a reference state (n,) and its input (m,).

        The input of the plant is then input + k; k = 0 for x = 0.
        """
        return self.feedback(x, state, input, data[: -self.plant.n - len(self.input_names)])
