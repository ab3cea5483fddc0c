"""What ``comparison.json`` holds. What is infinite is null, and named beside."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from flexhinf.design.compare.asked import specification_met
from flexhinf.design.compare.result import Comparison, Row, Runs

__all__ = ["numbers_of"]


def numbers_of(comparison: Comparison) -> dict[str, Any]:
    """Of one comparison; figures in SI units, named by `flexhinf.design.compare.merits.Merit.key`."""
    reference, target = comparison.reference, comparison.target
    synthesis, bench = reference.synthesis, reference.bench
    return {
        "version": 1,
        "robot": reference.robot.name,
        "joints": list(reference.robot.joint_names),
        "unit": reference.unit,
        "tune": {
            "mode": target.mode,
            "target": target.value,
            "from": target.origin,
            "share_of_way": target.share,
        },
        "design": {
            "preset": synthesis.game.preset,
            "gamma_star": synthesis.game.gamma_star,
            "gamma": synthesis.game.gamma,
            "degree": synthesis.chosen.degree,
        },
        "start": bench.start,
        "goal": bench.goal,
        "duration_s": reference.step_duration,
        "load": reference.load,
        "move_s": float(reference.plan.duration),
        "drawn": len(comparison.drawn),
        "seed": reference.specification.seed,
        "laws": [_law(comparison, row) for row in comparison.rows],
    }


def _law(comparison: Comparison, row: Row) -> dict[str, Any]:
    figures = row.figures
    return {
        "name": row.name,
        "what": row.kind.what,
        "compared": row.runs is not None,
        "failure": row.failure or row.linear_failure,
        "knob": None if row.tuned is None else {"what": row.kind.knob, "value": row.tuned.knob},
        "tuned": None
        if row.tuned is None
        else {"response": row.tuned.response, "met": row.tuned.met, "reason": row.tuned.reason},
        "figures": {key: _finite(value) for key, value in figures.items()},
        "infinite": [key for key, value in figures.items() if value is not None and np.isinf(value)],
        "needs": list(row.needs),
        "specification": [
            {
                "what": met.what,
                "where": met.where,
                "asked": met.asked,
                "found": _finite(met.found),
                "holds": met.holds,
            }
            for met in specification_met(comparison, row)
        ],
        "corners": None if row.linear is None else row.linear.corners,
        "joints": None if row.runs is None else _joints(row.runs),
    }


def _joints(runs: Runs) -> dict[str, Any]:
    """Figures of each joint."""
    return {
        "step": _plain(runs.step.metrics),
        "raw": None if runs.raw is None else _plain(runs.raw.metrics),
        "load": _plain(runs.loaded.metrics),
        "move": _plain(runs.move.metrics),
    }


def _plain(rows: list[dict[str, Any]]) -> list[Mapping[str, Any]]:
    return [{key: _finite(value) for key, value in row.items()} for row in rows]


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None
