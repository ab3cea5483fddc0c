"""A robot within its tolerances by how it differs from the nominal one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from flexhinf.design.result import Design
from flexhinf.report import number
from flexhinf.robot.extras import EXTRAS

__all__ = ["change_words"]

#: So many changes are told, the largest first.
TOLD = 6


def change_words(design: Design, values: Mapping[str, Any]) -> str:
    """Parameters of a plant furthest from nominal, in per cent; those of extras that are off are left out."""
    nominal, joints = design.bench.true_plant.parameters.values, design.robot.joint_names
    off = _off(design)
    changes = []
    for name, value in values.items():
        if name not in nominal or name in off:
            continue
        new, old = (np.ravel(np.asarray(v, dtype=float)) for v in (value, nominal[name]))
        for i in np.flatnonzero(old != 0.0):
            place = ""
            if len(new) > 1:
                place = f" {joints[i]}" if len(new) == len(joints) else f" {i + 1}"
            changes.append((100.0 * (new[i] / old[i] - 1.0), name.replace("_", " ") + place))
    changes = [change for change in changes if abs(change[0]) > 1e-9]
    largest = sorted(changes, key=lambda change: -abs(change[0]))[:TOLD]
    words = [f"{name} {'' if change < 0 else '+'}{number(change, 2)} %" for change, name in largest]
    if len(changes) > TOLD:
        words.append("others by less")
    return ", ".join(words) or "the nominal one"


def _off(design: Design) -> set[str]:
    """Parameters that do not act in the true plant."""
    on = {EXTRAS[name] for name in design.specification.extras}
    if "stribeck_friction" in design.specification.extras:
        on.add(EXTRAS["coulomb_friction"])
    return set(EXTRAS.values()) - on
