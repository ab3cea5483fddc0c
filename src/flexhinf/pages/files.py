"""The files of a report: page, numbers, controller and every run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.result import Comparison, Design
from flexhinf.errors import InvalidInput
from flexhinf.pages.comparison import comparison_page
from flexhinf.pages.numbers import comparison_numbers, design_numbers
from flexhinf.pages.page import design_page
from flexhinf.pages.proof import BOX_FILE
from flexhinf.report import to_json, write

#: Runs are NetCDF files: a fifth of the size of text, with units.
ENDING = "nc"


def design_files(
    design: Design, command: Sequence[str], warnings: Sequence[str] = (), beside: Sequence[str] = ()
) -> dict[str, str | bytes]:
    """index.html, design.json, the controller, every run of the nominal robot, and a proof as certificate.json.

    Parameters
    ----------
    command : sequence of str
        That makes the report again; empty for a report that is written from Python.
    warnings : sequence of str
        Of the robot's file.
    beside : sequence of str
        Names of files that the caller writes into the same folder: the page lists them.
    """
    runs = {f"runs/{name}": response.run.save for name, response in _responses(design.evaluation).items()}
    for k, response in enumerate(design.evaluation.ring_down.responses):
        runs[f"runs/ring-down-{k + 1}"] = response.run.save
    if design.mujoco is not None:
        runs["runs/step-mujoco"] = design.mujoco.run.save
    saved = {
        "controller": design.controller().save,
        **{f"{name}.{ENDING}": save for name, save in runs.items()},
    }
    files: dict[str, str | bytes] = {"design.json": to_json(design_numbers(design)), **_saved(saved)}
    if design.proof.certificate is not None:
        files["certificate.json"] = design.proof.certificate.text()
    if design.proof.box is not None and design.proof.box.certificate is not None:
        files[BOX_FILE] = design.proof.box.certificate.text()
    page = design_page(design, command, warnings, (*files, *beside))
    return {"index.html": page.html(), **files}


def comparison_files(
    comparison: Comparison, command: Sequence[str], warnings: Sequence[str] = (), beside: Sequence[str] = ()
) -> dict[str, str | bytes]:
    """index.html, comparison.json, and every run of the nominal robot, in a folder for each law."""
    saved = {
        f"runs/{row.name}/{name}.{ENDING}": response.run.save
        for row in comparison.compared
        if row.evaluation is not None
        for name, response in _responses(row.evaluation).items()
    }
    files: dict[str, str | bytes] = {
        "comparison.json": to_json(comparison_numbers(comparison)),
        **_saved(saved),
    }
    page = comparison_page(comparison, command, warnings, (*files, *beside))
    return {"index.html": page.html(), **files}


def write_design(design: Design, folder: str | Path) -> Path:
    """Write the report of a design into a folder, which is returned.

    Raises
    ------
    InvalidInput
        As `flexhinf.report.write`.
    """
    return write(folder, design_files(design, ()))


def write_comparison(comparison: Comparison, folder: str | Path) -> Path:
    """Write the report of a comparison into a folder, which is returned; raises as `write_design`."""
    return write(folder, comparison_files(comparison, ()))


def _responses(e: LawEvaluation) -> dict[str, Any]:
    return {"step": e.step, "load": e.load_response.response, "move": e.move.response}


def _saved(files: Mapping[str, Callable[[Path], object]]) -> dict[str, bytes]:
    """What each function writes; what cannot be written, as the controller of a law that is code, is left out."""
    found = {}
    with TemporaryDirectory() as folder:
        for name, save in files.items():
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                save(path)
            except InvalidInput:
                continue
            found[name] = path.read_bytes()
    return found
