"""A law made for a problem: names and operating point are the problem's."""

from __future__ import annotations

import abc
from typing import Any

import numpy as np

from flexhinf.plant.plant import GeneralisedPlant

__all__ = ["ProblemLaw"]


class ProblemLaw(abc.ABC):
    """Base of laws that stand for a `GeneralisedPlant` (see `flexhinf.plant.protocols.Law`).

    Attributes
    ----------
    problem : GeneralisedPlant
    """

    problem: GeneralisedPlant

    @property
    def state_names(self) -> tuple[str, ...]:
        """Of the problem."""
        return self.problem.state_names

    @property
    def input_names(self) -> tuple[str, ...]:
        """Of the problem."""
        return self.problem.input_names

    @property
    def operating_point(self) -> np.ndarray:
        """x* of the problem, (n,)."""
        return self.problem.operating_point

    @property
    def operating_input(self) -> np.ndarray:
        """u* of the problem, (m,)."""
        return self.problem.operating_input

    @property
    @abc.abstractmethod
    def law_data(self) -> np.ndarray:
        """Numbers of the law, flat."""

    @property
    @abc.abstractmethod
    def law_key(self) -> str:
        """What distinguishes the law's code from another's."""

    @abc.abstractmethod
    def evaluate_law(self, x: Any, data: Any) -> Any:
        """k(x), (m,), for a deviation x (n,) on any element."""
