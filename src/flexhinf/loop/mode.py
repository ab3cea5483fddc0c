"""How a controller uses its law: about a fixed point or a moving one, alone or of several, how it takes over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from flexhinf.errors import InvalidInput

__all__ = ["Mode", "Source"]


class Source(NamedTuple):
    """Where a tracked state is read: of the measurement where it is measured, else of the estimate.

    Attributes
    ----------
    measured : bool
    place : int
        In the measurement, or in the estimate.
    state : int
        Its place among the states of the plant.
    """

    measured: bool
    place: int
    state: int

    @staticmethod
    def of(name: str, states: Sequence[str], measured: Sequence[str]) -> Source:
        """The measurement itself where the state is measured, so that the integral removes the error of the
        measured signal, whatever the estimator's model gets wrong."""
        state = states.index(name)
        return Source(True, measured.index(name), state) if name in measured else Source(False, state, state)


@dataclass(frozen=True)
class Mode:
    """What the text of a step depends on, beside law and estimator.

    Parameters
    ----------
    moving : bool
        Whether the law acts about a moving reference (x_d, u_d) instead of the operating point.
    start : {"zero", "bumpless"}
        What the integrals are at the first sample: zero, or such that the input continues from the one before.
    laws : int
        How many there are, of which one is active.

    Raises
    ------
    InvalidInput
        If `moving` is neither True nor False, or there is no such start.
    """

    moving: bool = False
    start: str = "zero"
    laws: int = 1

    def __post_init__(self) -> None:
        if not isinstance(self.moving, bool):
            raise InvalidInput(
                "Whether the law acts about a moving reference is not said.",
                f"expected moving=True or moving=False, got {self.moving!r}",
                "moving=True for commands (x_d, u_d) of states and inputs",
            )
        if self.start not in ("zero", "bumpless"):
            raise InvalidInput(
                "There is no such start of a controller.",
                f"expected 'zero' or 'bumpless', got {self.start!r}",
                "start='bumpless' to continue from the last input",
            )

    @property
    def bumpless(self) -> bool:
        """Whether the law takes over the last input at the first sample."""
        return self.start == "bumpless"

    @property
    def takes_over(self) -> bool:
        """Whether a law ever takes over: at the first sample, or from another law."""
        return self.bumpless or self.laws > 1
