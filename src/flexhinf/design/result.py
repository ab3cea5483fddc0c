"""What a design comes to: everything its report shows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from flexhinf.design.bench import Bench
from flexhinf.design.degrees import shrinking
from flexhinf.design.guarantee import Guarantee
from flexhinf.design.linearised import Linearised
from flexhinf.design.met import Met
from flexhinf.design.runs import Runs
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis import Synthesis
from flexhinf.design.tolerances import Tolerances
from flexhinf.robot import Robot

__all__ = ["Design"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Design(Synthesis, Linearised, Runs):
    """A synthesis, what the linearisation says of it, and its runs.

    Attributes
    ----------
    robot, specification
        What was asked.
    bench : Bench
        Law, estimator and true plant of all runs.
    tolerances : Tolerances or None
        Corners of the tolerances in the linearised loop; None for a robot that states none.
    guarantee : Guarantee
        The gain that the worst disturbance found attains, and what the controller's parts spend of the region.
    inside : bool or None
        Whether the step starts inside the region of the chosen solution; None if that was not looked at.
    met : tuple of Met
        The specification, line by line.
    """

    robot: Robot
    specification: Specification
    bench: Bench
    tolerances: Tolerances | None
    guarantee: Guarantee
    inside: bool | None
    met: tuple[Met, ...]

    @property
    def gamma_star(self) -> float:
        """Smallest level of the game."""
        return self.game.gamma_star

    @cached_property
    def shrinking(self) -> list[tuple[int, int]]:
        """Pairs of degrees where the higher allows a smaller step."""
        return shrinking(self.choices)
