"""The noise levels that the estimator assumes, and how they were found."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.design.result import Design
from flexhinf.design.weights.estimator_noise import NoiseCandidate, NoiseSearch
from flexhinf.report import Column, Paragraph, Table, number

__all__ = ["blocks", "selected_candidates"]

#: Candidates beside the one that is used, the nearest in the order of the search.
NEIGHBOURS = 3


def blocks(design: Design) -> list[Any]:
    """Levels in use, and the candidates of the search; none without an estimator."""
    if design.specification.estimator == "none":
        return []
    return [Paragraph(_text(design)), *([] if design.noise_search is None else [_table(design)])]


def _text(design: Design) -> str:
    noise = design.setup.process_noise
    levels = (
        ("every state", noise.all_states),
        ("link velocities", noise.link_velocities),
        ("motor velocities", noise.motor_velocities),
    )
    used = ", ".join(f"{number(level, 3)} on {where}" for where, level in levels if level) or "0"
    text = (
        f"Rᵛ, the variance of the process noise per sample that the estimator assumes: {used} ({noise.source}). Rⁿ "
        f"of a measured position: {number(design.specification.measurement_noise, 3)}. Rᵛ is a parameter of the "
        "design: a larger one makes the estimator faster, which gives the loop its margins back and costs noise at "
        "the motors."
    )
    if design.noise_search is None:
        return text
    return f"{text} {_outcome(design.noise_search)}"


def _outcome(search: NoiseSearch) -> str:
    """What the search reached, in one sentence or two."""
    chosen, least = search.chosen, "with the least noise at the motors"
    if chosen.feasible:
        return f"The search took the levels {least} that keep every limit of the running loop."
    if chosen.unstable or not set(chosen.missed) <= set(search.unreachable):
        outcome = "No levels keep all limits of the running loop: the search took those that miss them least."
    else:
        outcome = f"The search took the levels {least} that keep the other limits."
    if not search.unreachable:
        return outcome
    return f"No levels reach the limit of the {' and the '.join(search.unreachable)}, which was left out. {outcome}"


def selected_candidates(design: Design) -> list[NoiseCandidate]:
    """The candidate that is used and its neighbours in the order of the search."""
    search = design.noise_search
    assert search is not None
    every = list(search.candidates)
    used = next((k for k, one in enumerate(every) if one is search.chosen), len(every) - 1)
    return every[max(0, used - NEIGHBOURS) : used + NEIGHBOURS + 1]


def _table(design: Design) -> Table:
    search = design.noise_search
    assert search is not None
    rows = [
        (
            number(one.levels.motor_velocities, 3),
            number(one.levels.link_velocities, 3),
            _finite(one.peak_sensitivity),
            _finite(one.gain_margin),
            _finite(one.damping),
            _finite(one.compliance),
            _finite(one.input_noise),
            one.unstable,
            "used" if one is search.chosen else ("" if one.feasible else "misses a limit"),
        )
        for one in selected_candidates(design)
    ]
    unit = design.setup.model.unit(design.setup.model.inputs[0])
    columns = (
        "Rᵛ, motor velocities",
        "Rᵛ, link velocities",
        Column("peak sensitivity", "", 2),
        Column("gain margin", "", 2),
        Column("smallest damping ratio", "", 3),
        Column("compliance / true state", "", 2),
        Column("noise at the motor (rms)", unit),
        "unstable corners",
        "",
    )
    caption = f"{len(rows)} of {len(search.candidates)} candidates; design.json has all"
    return Table(columns, rows, caption, "table-noise-search")


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
