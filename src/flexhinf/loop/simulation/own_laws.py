"""Runs of one ensemble whose controllers differ in numbers alone: those of law, estimator and limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from flexhinf.arrays import Numbers
from flexhinf.errors import refuse_if
from flexhinf.loop.controller.controller import Controller
from flexhinf.validation import value_text


def checked_controllers(controllers: object) -> Sequence[Controller]:
    """At least one controller of a sequence of nothing else; InvalidInput for another value."""
    several = isinstance(controllers, Sequence)
    some = cast("Sequence[object]", controllers) if several else ()
    wrong = [each for each in some if not isinstance(each, Controller)] if several else [controllers]
    refuse_if(
        wrong or not some,
        "The controllers cannot be used.",
        f"expected a sequence of Controllers, got {value_text(wrong[0]) if wrong else 'none'}",
        "[fh.Controller(law, estimator, period)]",
    )
    return cast("Sequence[Controller]", controllers)


def law_rows(
    memory: np.ndarray,
    base: Controller,
    controllers: Sequence[Controller],
    count: int,
    inputs: Numbers,
    common: Numbers,
) -> dict[str, np.ndarray]:
    """Numbers, first memory and input before the first sample (N, …) of the controllers of N runs, by buffer.

    `memory`: the ensemble's first one, which must be that of its controller.
    `inputs`: (N, m), those before the first sample; else all runs have the `common` one.
    Raises InvalidInput: for what is no controller, or one of other code, period or operating point than `base`.
    """
    refuse_if(
        len(checked_controllers(controllers)) != count,
        "The controllers do not fit the plants.",
        f"expected {count}, got {len(controllers)}",
        "one for each plant",
    )
    refuse_if(
        not np.array_equal(memory, base.initial_memory(input=common), equal_nan=True),
        "Runs with a memory of their own have one controller.",
        "expected an ensemble without initial_memory and controllers, got both",
        "initial_memory=None",
    )
    different = list({id(each): each for each in controllers}.values())
    for each in different:
        refuse_if(
            wrong := _difference(base, each),
            "A controller cannot run beside those of the ensemble.",
            f"expected controllers that differ in numbers alone, got another {wrong}",
            "laws of one degree and goal with one kind of estimator; others in an ensemble of their own",
        )
    rows = [controllers, [common] * len(controllers)] if inputs is None else [controllers, np.asarray(inputs)]
    known: dict[int, tuple[np.ndarray, ...]] = {}
    starts: list[tuple[np.ndarray, ...]] = []
    for each, row in zip(*rows):
        start = known.get(id(each)) if inputs is None else None
        start = start or (each.data_vector, each.initial_memory(input=row), each.input_before(row))
        known[id(each)] = start
        starts.append(start)
    return {name: np.array(column) for name, column in zip(("data", "memory", "held"), zip(*starts))}


def _difference(base: Controller, other: Controller) -> str:
    """What two controllers of one ensemble must have in common and have not; empty if nothing."""
    pairs = {
        "period": (base.period, other.period),
        "program": (base.code_key, other.code_key),
        "rounding": (base.fused, other.fused),
        "operating point": (
            np.asarray(base.law.operating_point).tolist(),
            np.asarray(other.law.operating_point).tolist(),
        ),
        "operating input": (
            np.asarray(base.law.operating_input).tolist(),
            np.asarray(other.law.operating_input).tolist(),
        ),
        "set of measurements": (base.measured, other.measured),
    }
    return next((name for name, (a, b) in pairs.items() if a != b), "")
