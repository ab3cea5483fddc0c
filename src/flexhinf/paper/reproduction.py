"""The whole reproduction: the numbers of every figure, the verdict of every claim, and the files of the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

from flexhinf.paper.apart import judged_apart
from flexhinf.paper.estimators import BETTER_THAN_EKF, UKF
from flexhinf.paper.loop_setup import FIGURE_NUMBERS, PaperSetup, StatedClaim, figure_numbers, judge
from flexhinf.paper.responses import ABOUT_THE_GOAL, GAIN, STEPS_AND_TRACKING, TORQUES
from flexhinf.paper.settings import PaperSettings
from flexhinf.paper.tolerances import COIL, TOLERANCES
from flexhinf.report import Claim

#: The claims in the order of the report; the last one is a question of ours.
CLAIMS: tuple[StatedClaim, ...] = (
    *STEPS_AND_TRACKING,
    COIL,
    GAIN,
    TOLERANCES,
    *TORQUES,
    *UKF,
    ABOUT_THE_GOAL,
)

#: What takes half of the time of all.
LONG_CLAIMS = (TOLERANCES, BETTER_THAN_EKF)

#: How many steps of work there are, for a progress bar.
STAGES = len(FIGURE_NUMBERS) + len(CLAIMS) + 1


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Results of the reproduction: numbers of the paper's figures "03" … "12", its claims, questions of ours, and what
    makes it again."""

    setup: PaperSetup
    figures: dict[str, dict[str, Any]]
    claims: tuple[Claim, ...]
    questions: tuple[Claim, ...]
    command: tuple[str, ...]
    drawings: Mapping[str, str] | None = None  # of the paper's figures, as SVG, where they are drawn already

    @cached_property
    def files(self) -> dict[str, str]:
        """Files of the report: index.html, figure_03.svg … figure_12.svg, metrics.json."""
        return import_module("flexhinf.pages.paper").paper_files(self)

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """Content of ``metrics.json``."""
        return {
            "version": 1,
            "gamma_star": self.setup.gamma_star,
            "gamma": self.setup.gamma,
            **{
                "period_s" if name == "period" else name: value
                for name, value in vars(self.setup.settings).items()
            },
            "figures": self.figures,
            "claims": [claim.as_dict() for claim in self.claims],
            "our_questions": [claim.as_dict() for claim in self.questions],
        }


def reproduce(
    settings: PaperSettings,
    command: Sequence[str] = ("flexhinf", "paper"),
    progress: Callable[[str], None] = lambda stage: None,
    processes: int = 1,
) -> Reproduction:
    """Compute everything; nothing is written.

    `command` makes the report again; `progress` is called with the name of each next stage, `STAGES` times in all. With
    two `processes` another one judges the claims that take longest, and this one draws meanwhile; numbers and drawings
    are the same. It imports the main module again, as every process of Python's multiprocessing does.
    Raises InfeasibleGamma: if γ is not above γ*.
    """
    apart = LONG_CLAIMS if processes > 1 else ()
    with judged_apart(settings, apart) if apart else nullcontext() as judged:
        return _reproduced(settings, command, progress, apart, judged)


def _reproduced(
    settings: PaperSettings,
    command: Sequence[str],
    progress: Callable[[str], None],
    apart: Sequence[StatedClaim],
    judged: Callable[[], Claim | None] | None,
) -> Reproduction:
    progress("synthesis")
    setup, figures = PaperSetup(settings), dict[str, dict[str, Any]]()
    drawings, claims = None, dict[str, Claim]()
    for figure in FIGURE_NUMBERS:
        progress(f"figure {int(figure)}")
        figures[figure] = figure_numbers(setup, figure)
    for claim in (*(each for each in CLAIMS if each not in apart), *apart):
        if claim in apart and drawings is None:
            drawings = import_module("flexhinf.pages.paper").draw_figures(setup)
        progress(f"claim: {claim.id.replace('-', ' ')}")
        claims[claim.id] = (judged() if judged and claim in apart else None) or judge(setup, claim)
    *paper, own = (claims[claim.id] for claim in CLAIMS)
    return Reproduction(setup, figures, tuple(paper), (own,), tuple(command), drawings)
