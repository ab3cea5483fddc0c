"""Figures 3–12 of the paper, one file each."""

from __future__ import annotations

from collections.abc import Callable

from flexhinf.paper.experiments import Experiments
from flexhinf.paper.figures.drawn import Drawn
from flexhinf.paper.figures.figure_03 import figure_03
from flexhinf.paper.figures.figure_04 import figure_04
from flexhinf.paper.figures.figure_05 import figure_05
from flexhinf.paper.figures.figure_06 import figure_06
from flexhinf.paper.figures.figure_07 import figure_07
from flexhinf.paper.figures.figure_08 import figure_08
from flexhinf.paper.figures.figure_09 import figure_09
from flexhinf.paper.figures.figure_10 import figure_10
from flexhinf.paper.figures.figure_11 import figure_11
from flexhinf.paper.figures.figure_12 import figure_12

__all__ = ["FIGURES", "Drawn"]

#: In the order of the paper.
FIGURES: tuple[Callable[[Experiments], Drawn], ...] = (
    figure_03,
    figure_04,
    figure_05,
    figure_06,
    figure_07,
    figure_08,
    figure_09,
    figure_10,
    figure_11,
    figure_12,
)
