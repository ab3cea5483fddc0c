"""The design file of a design: what was asked for, by which `design_file` makes it again, and what came of it."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flexhinf import __version__
from flexhinf.design.file_fields import FIELDS
from flexhinf.design.met import Met, all_hold
from flexhinf.design.page.words import verdict, vibrations
from flexhinf.design.result import Design
from flexhinf.design.specification import Specification
from flexhinf.design.toml_text import toml_table, toml_value
from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty
from flexhinf.robot import catalogue

__all__ = ["asked_text", "design_text"]

HEAD = f"""\
# A design, by flexhinf {__version__}. It is made again by: flexhinf design design.toml
# Options on the command line win over it, and every command that takes a robot takes this file.
# Units: rad (m), rad/s, s, V or N·m (N). Paths are seen from the folder of this file.

"""
FOUND = """
# What came of it. This part is not read: changing it changes nothing.
"""


def design_text(
    design: Design, robot: str | Path, elastic: str | Path | None = None, folder: str | Path = "."
) -> str:
    """Text of the design file, as TOML.

    Parameters
    ----------
    design : Design
    robot, elastic : path or str
        Where the robot came from, as for `load_robot`.
    folder : path
        Where the file is to stand: paths are seen from it.

    Raises
    ------
    InvalidInput
        If the penalty is code.
    """
    asked = asked_text(design.specification, robot, elastic, folder)
    return HEAD + asked + FOUND + toml_table("found", _found(design))


def asked_text(
    specification: Specification,
    robot: str | Path,
    elastic: str | Path | None = None,
    folder: str | Path = ".",
) -> str:
    """The table [design]: what differs from the defaults; the defaults stand below it as comments."""
    places = {"robot": _place(robot, folder)}
    if elastic is not None:
        places["elastic"] = _place(elastic, folder)
    values = {name: _plain(name, getattr(specification, name)) for name in FIELDS}
    if isinstance(specification.penalty, Penalty) and specification.effort is None:
        values["effort"] = _one_effort(specification.penalty)
    defaults = {name: _plain(name, getattr(Specification(), name)) for name in FIELDS}
    stated = {name: value for name, value in values.items() if value != defaults[name]}
    table = toml_table("design", {**places, **stated})
    head, *below = table.split("\n\n", 1)
    left = [
        f"# {name} = {toml_value(value)}"
        for name, value in defaults.items()
        if value is not None and name not in stated
    ]
    comments = "\n".join(["# By default:", *left])
    return "\n\n".join([head.rstrip("\n"), comments, *below]).rstrip("\n") + "\n"


def _place(source: str | Path, folder: str | Path) -> str:
    """A catalogue's name, or a path from the folder."""
    if str(source) in catalogue():
        return str(source)
    path = Path(source).resolve()
    try:
        return Path(os.path.relpath(path, Path(folder).resolve())).as_posix()
    except ValueError:  # another drive
        return path.as_posix()


def _plain(name: str, value: Any) -> Any:
    """Lists and numbers, for TOML."""
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if name in ("penalty", "checked_penalty"):
        return _weights(value)
    return np.asarray(value).tolist()


def _weights(penalty: Any) -> Any:
    states = penalty.states if isinstance(penalty, Penalty) else penalty
    if callable(states):
        raise InvalidInput(
            "A design file cannot hold a penalty that is code.",
            f"expected weights by name, one per state, or rows, got {penalty!r}",
            "the report without its design file: design_files(…)",
        )
    if isinstance(states, Mapping):
        return {name: np.asarray(weight, dtype=float).tolist() for name, weight in states.items()}
    return np.asarray(states, dtype=float).tolist()


def _one_effort(penalty: Penalty) -> float:
    effort = np.asarray(penalty.effort, dtype=float)
    if effort.size != 1:
        raise InvalidInput(
            "A design file holds one price of the input.",
            f"expected R2 as a number, got {effort.tolist()}",
            "the report without its design file: design_files(…)",
        )
    return float(effort.ravel()[0])


# What came of it ----------------------------------------------------------------------------------
def _found(design: Design) -> dict[str, Any]:
    game, chosen = design.game, design.chosen
    damped = vibrations(design.closed_modes)
    found: dict[str, Any] = {
        "verdict": verdict(design),
        "met": all_hold(design.met),
        "preset": game.preset,
        "goal": design.goal,
        "start": design.start,
        "gamma_star": design.gamma_star,
        "gamma": design.solution.gamma,
        "degrees": [choice.degree for choice in design.choices],
        "degree": chosen.degree,
        "bandwidth": design.bandwidth,
        "damping": min(damped) if damped else None,
        "draws": 0 if design.draws is None else len(design.draws),
        "rays": design.rays,
        "duration": design.duration,
        "weights_from": game.source,
        "R2": np.asarray(game.penalty.effort, dtype=float),
        "R2_from": game.effort_source,
        "weights": _found_weights(design),
        "robust": None if game.robustness is None else dataclasses.asdict(game.robustness),
        "margins": {
            "delay_margin": design.margins.delay_margin_s,
            "peak_sensitivity": design.margins.peak_sensitivity,
        },
        "specification": [_line(line) for line in design.met],
    }
    return {name: value for name, value in found.items() if value is not None}


def _found_weights(design: Design) -> dict[str, Any] | None:
    """By name; None for a penalty that is code."""
    states = design.game.penalty.states
    if callable(states):
        return None
    plain = _weights(states)
    if isinstance(plain, dict):
        return plain
    named = dict(zip(design.problem.state_names, plain))
    return {"rows": plain} if plain and isinstance(plain[0], list) else named


def _line(met: Met) -> dict[str, Any]:
    return {
        "what": met.what,
        "limit": "at most" if met.at_most else "at least",
        "asked": met.asked,
        "found": met.found,
        "unit": met.unit,
        "holds": met.holds,
        "where": met.where,
        "by_default": not met.asked_for,
    }
