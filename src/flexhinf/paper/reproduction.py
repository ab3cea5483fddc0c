"""The whole reproduction: the numbers of every figure and the verdict of every claim."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from flexhinf.paper.apart import Apart
from flexhinf.paper.claims import BY_LENGTH, CLAIMS, NOT_JUDGED
from flexhinf.paper.loop_setup import FIGURE_NUMBERS, PaperSetup, StatedClaim, figure_numbers, judge
from flexhinf.paper.settings import PaperSettings
from flexhinf.processors import single_blas
from flexhinf.report import JudgedClaim

#: How many steps of work there are, for a progress bar.
STAGES = len(FIGURE_NUMBERS) + len(CLAIMS) + 1


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Results of the reproduction: numbers of the paper's figures "03" … "12", its claims, questions of ours, and what
    makes it again. `flexhinf.pages.paper_files` has the files of its report."""

    setup: PaperSetup
    figures: dict[str, Mapping[str, object]]
    claims: tuple[JudgedClaim, ...]
    questions: tuple[JudgedClaim, ...]
    command: tuple[str, ...]

    @cached_property
    def metrics(self) -> dict[str, object]:
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
            "not_judged": [{"said": said, "why": why} for said, why in NOT_JUDGED],
        }


@single_blas()
def reproduce(
    settings: PaperSettings,
    command: Sequence[str] = ("flexhinf", "paper"),
    progress: Callable[[str], None] = lambda stage: None,
    apart: Apart | None = None,
    known: Callable[[PaperSetup, JudgedClaim | None], object] = lambda setup, claim: None,
) -> Reproduction:
    """Compute everything; nothing is written.

    `command` makes the report again; `progress` is called with the name of each next stage, `STAGES` times in all.
    With `apart`, that of `flexhinf.paper.apart.judged_apart`, another process judges claims too: numbers are the same.
    `known` is called once the numbers of the figures are there, without a claim, and with each claim as it is judged:
    what it draws then, it draws while the other process works.
    Raises InfeasibleGamma: if γ is not above γ*.
    """
    progress("synthesis")
    setup, figures, claims = PaperSetup(settings), dict[str, Mapping[str, object]](), dict[str, JudgedClaim]()
    for figure in FIGURE_NUMBERS:
        progress(f"figure {int(figure)}")
        figures[figure] = figure_numbers(setup, figure)
    known(setup, None)

    def add(stated: StatedClaim, wait: Callable[[], JudgedClaim | None] = lambda: None) -> None:
        progress(f"claim: {stated.id.replace('-', ' ')}")
        claims[stated.id] = wait() or judge(setup, stated)
        known(setup, claims[stated.id])

    begun = apart.begun if apart else [0, 0]
    for claim in reversed(BY_LENGTH):
        if begun[0] + begun[1] >= len(BY_LENGTH):
            break
        begun[1] += 1
        add(claim)
    if apart:
        for claim in BY_LENGTH[: -begun[1] or None]:  # begun there, and judged here only if it died
            add(claim, apart.judged)
    *paper, own = (claims[claim.id] for claim in CLAIMS)
    return Reproduction(setup, figures, tuple(paper), (own,), tuple(command))
