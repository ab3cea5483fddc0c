"""The whole reproduction: figures, claims, and the files of the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from flexhinf.paper.claims import JUDGES, Judged
from flexhinf.paper.experiments import Experiments
from flexhinf.paper.figures import FIGURES, PaperFigure
from flexhinf.paper.loop_setup import PaperSettings, PaperSetup
from flexhinf.paper.page import paper_page
from flexhinf.report import to_json

#: How many steps of work there are, for a progress bar.
STAGES = len(FIGURES) + len(JUDGES) + 2


@dataclass(frozen=True)
class Reproduction:
    """What came out.

    Attributes
    ----------
    files : dict of str to str
        index.html, figure_03.svg … figure_12.svg, metrics.json.
    metrics : dict
        As in ``metrics.json``.
    """

    files: dict[str, str]
    judged: tuple[Judged, ...]
    metrics: dict[str, Any]


def reproduce(
    settings: PaperSettings,
    command: Sequence[str] = ("flexhinf", "paper"),
    progress: Callable[[str], None] | None = None,
) -> Reproduction:
    """Compute everything; nothing is written.

    Parameters
    ----------
    command : sequence of str
        What makes the report again, for the report.
    progress : callable, optional
        Called with what comes next, `STAGES` times in all.

    Raises
    ------
    InfeasibleGamma
        If γ is not above γ*.
    """
    begin = progress or (lambda text: None)
    begin("synthesis")
    experiments = Experiments(PaperSetup(settings))
    figures: list[PaperFigure] = []
    for recipe in FIGURES:
        begin(f"figure {int(recipe.number)}")
        figures.append(recipe(experiments))
    judged: list[Judged] = []
    for what, judge in JUDGES:
        begin(f"claim: {what}")
        found = judge(experiments)
        judged += found if isinstance(found, list) else [found]
    begin("report")
    metrics = _metrics(experiments, figures, judged)
    files = {
        "index.html": paper_page(experiments, figures, judged, command).html(),
        "metrics.json": to_json(metrics),
    }
    files |= {f"figure_{d.number}.svg": d.svg for d in figures}
    return Reproduction(files, tuple(judged), metrics)


def _metrics(
    experiments: Experiments, figures: Sequence[PaperFigure], judged: Sequence[Judged]
) -> dict[str, Any]:
    setup = experiments.setup
    s = setup.settings
    return {
        "version": 1,
        "gamma_star": setup.gamma_star,
        "gamma": setup.gamma,
        "gamma_ratio": s.gamma_ratio,
        "degree": s.degree,
        "period_s": s.period,
        "seed": s.seed,
        "estimator": s.estimator,
        "process_noise": s.process_noise,
        "measurement_noise": s.measurement_noise,
        "figures": {d.number: d.numbers for d in figures},
        "claims": [_entry(j) for j in judged if not j.ours],
        "our_questions": [_entry(j) for j in judged if j.ours],
    }


def _entry(judged: Judged) -> dict[str, Any]:
    """A claim as it stands in ``metrics.json``."""
    return {**judged.claim.as_dict(), **({"numbers": judged.numbers} if judged.numbers else {})}
