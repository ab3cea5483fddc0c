"""The text of a design's file: what was asked for, by which `design_file` makes it again, and what came of it."""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from flexhinf import __version__
from flexhinf.design.design_file import plain, weights_of
from flexhinf.design.requirements import Requirement
from flexhinf.design.result import PAGES, Design
from flexhinf.design.specification import FIELDS, Specification
from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty
from flexhinf.robot import catalogue

HEAD = f"""\
A design, by flexhinf {__version__}. The same design is made by: flexhinf design design.toml
Options on the command line win over this file, and every command that takes a robot takes it.
Units: rad (m), rad/s, s, V or N·m (N), or text with a unit: "90deg", "0.6Hz", "5ms". Paths are seen from this folder.
"""
RESULT = "What came of it. This part is not read: changing it changes nothing."


def design_text(
    design: Design,
    robot: str | Path,
    elastic: str | Path | None = None,
    folder: str | Path = ".",
    payload: str | None = None,
) -> str:
    """Text of the design file of a design: what was asked for, and what came of it.

    Parameters
    ----------
    robot, elastic : path or str
        Where the robot came from, as for `load_robot`.
    folder : path
        Where the file is to stand: paths are seen from it.
    payload : str, optional
        What the robot carries instead of its file's own payload, as for `load_robot`.

    Raises
    ------
    InvalidInput
        If the penalty is code.
    """
    slides = design.robot.links.slides
    document = request_document(design.specification, robot, elastic, folder, payload, slides)
    document.add(tomlkit.nl())
    document.add(tomlkit.comment(RESULT))
    document.add("result", _table(result_table(design)))
    return tomlkit.dumps(document)


def request_document(
    specification: Specification,
    robot: str | Path,
    elastic: str | Path | None = None,
    folder: str | Path = ".",
    payload: str | None = None,
    slides: Sequence[bool] = (False,),
) -> tomlkit.TOMLDocument:
    """A design file without a result: its table [design], with what differs from the defaults; these stand below it as
    comments."""
    values = {name: plain(name, getattr(specification, name)) for name in FIELDS}
    if isinstance(specification.penalty, Penalty) and specification.effort is None:
        values["effort"] = _one_effort(specification.penalty)
    defaults = {name: plain(name, field.default) for name, field in FIELDS.items()}
    stated = {name: value for name, value in values.items() if value != defaults[name]}
    document, table = tomlkit.document(), tomlkit.table()
    for line in HEAD.splitlines():
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    table.add("robot", _place_text(robot, folder))
    if elastic is not None:
        table.add("elastic", _place_text(elastic, folder))
    if payload is not None:
        table.add("payload", payload)
    flat = {name: value for name, value in stated.items() if not isinstance(value, dict)}
    for name, value in flat.items():
        table.add(name, value)
        if comment := _comment(name, value, slides if specification.in_degrees else ()):
            table[name].comment(comment)
    table.add(tomlkit.nl())
    table.add(tomlkit.comment("By default:"))
    for name, value in defaults.items():
        if value is not None and name not in stated:
            unit = _comment(name, value)
            text = f"{name} = {tomlkit.item(value).as_string()}"
            table.add(tomlkit.comment(f"{text}  # {unit}" if unit else text))
    for name, value in stated.items():
        if isinstance(value, dict):
            table.add(name, _table(value))
    document.add("design", table)
    return document


def _comment(name: str, value: Any, slides: Sequence[bool] = ()) -> str:
    """The unit of a field; where the report shows degrees, those of positions, of which joints `slides` tells."""
    if name not in ("pose", "start", "via", "tracking_error") or not slides:
        return FIELDS[name].about.unit
    positions = np.ravel(value)
    if len(positions) == 1 and len(set(slides)) > 1:  # one for joints of both kinds
        return FIELDS[name].about.unit
    kinds = itertools.cycle(slides)
    return ", ".join(f"{q:.6g} m" if s else f"{math.degrees(q):.6g}°" for q, s in zip(positions, kinds))


def _table(values: Mapping[str, Any]) -> Any:
    """A table of plain values; tables stand below their numbers, as TOML wants it."""
    table = tomlkit.table()
    below = {name: value for name, value in values.items() if _is_table(value)}
    for name, value in values.items():
        if name not in below:
            table.add(name, value.tolist() if hasattr(value, "tolist") else value)
    for name, value in below.items():
        if isinstance(value, Mapping):
            table.add(name, _table(value))
        else:
            rows = tomlkit.aot()
            for row in value:
                rows.append(_table(row))
            table.add(name, rows)
    return table


def _is_table(value: Any) -> bool:
    rows = isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping)
    return bool(isinstance(value, Mapping) or rows)


def _place_text(source: str | Path, folder: str | Path) -> str:
    """A catalogue's name, or a path from the folder."""
    if str(source) in catalogue():
        return str(source)
    path = Path(source).resolve()
    try:
        return Path(os.path.relpath(path, Path(folder).resolve())).as_posix()
    except ValueError:  # another drive
        return path.as_posix()


def _one_effort(penalty: Penalty) -> float:
    effort = np.asarray(penalty.effort, dtype=float)
    if effort.size != 1:
        raise InvalidInput(
            "A design file holds one price of the input.",
            f"expected R2 as a number, got {effort.tolist()}",
            "the report without its design file: design_files(…)",
        )
    return float(effort.ravel()[0])


# Result --------------------------------------------------------------------------------------------
def result_table(design: Design) -> dict[str, Any]:
    """What came of a design, for the table [result]; nothing in it is None."""
    problem, samples, found = design.design_problem, design.evaluation.step_samples, design.evaluation.margins
    levels = design.setup.process_noise
    table: dict[str, Any] = {
        "verdict": import_module(PAGES).verdict(design),
        "met": design.met,
        "preset": problem.preset,
        "goal": design.goal,
        "start": design.start,
        "gamma_star": design.gamma_star,
        "gamma": design.gamma,
        "degrees": [choice.degree for choice in design.choices],
        "degree": design.chosen.degree,
        "bandwidth": found.bandwidth,
        "damping": found.damping if math.isfinite(found.damping) else None,
        "draws": 0 if samples is None else len(samples),
        "rays": design.synthesis.rays,
        "duration": design.scenario.step_duration,
        "weights_from": problem.source,
        "R2": np.asarray(problem.penalty.effort, dtype=float),
        "R2_from": problem.effort_source,
        "weights": _found_weights(design),
        "robust": None if problem.robustness is None else dataclasses.asdict(problem.robustness),
        "estimator_noise": {
            "all_states": levels.all_states,
            "link_velocities": np.asarray(levels.link_velocities),
            "motor_velocities": np.asarray(levels.motor_velocities),
            "from": levels.source,
        },
        "margins": {
            "delay_margin": found.delay_margin_s,
            "peak_sensitivity": found.peak_sensitivity,
            "gain_margin": found.gain_margin,
        },
        "specification": [_line(line) for line in design.requirements],
    }
    return {name: value for name, value in table.items() if value is not None}


def _found_weights(design: Design) -> dict[str, Any] | None:
    """By name; None for a penalty that is code."""
    states = design.design_problem.penalty.states
    if callable(states):
        return None
    plain = weights_of(states)
    if isinstance(plain, dict):
        return plain
    named = dict(zip(design.problem.state_names, plain))
    return {"rows": plain} if plain and isinstance(plain[0], list) else named


def _line(line: Requirement) -> dict[str, Any]:
    return {
        "what": line.what,
        "limit": "at most" if line.at_most else "at least",
        "asked": line.limit,
        "found": line.found,
        "unit": line.unit,
        "holds": line.met,
        "within_tolerance": line.within_tolerance,
        "where": line.where,
        "by_default": line.stated_by == "default",
    }
