"""A report's folder: page, numbers, the controller, and every run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.certify import load_certificate
from flexhinf.designs import PoseEvidence
from flexhinf.designs.result import judged_by

Make = Callable[[str], PoseEvidence]


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_the_folder_has_the_controller_and_every_run(report_design: Make, tmp_path: Path) -> None:
    import xarray as xr

    design = judged_by(report_design("met"))
    folder = design.save(tmp_path / "report")
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    runs = {f"runs/{name}.nc" for name in ("step", "load", "move", "ring-down-1")}
    assert names == {
        "index.html", "design.json", "design.toml", "robot.toml", "controller", "certificate.json",
        "flexhinf-report.json", *runs,
    }  # fmt: skip
    assert load_certificate(folder / "certificate.json").check().proved
    page = (folder / "index.html").read_text(encoding="utf-8")
    listed = {"design.json", "controller", "runs/load.nc", "move.nc", "step.nc"}  # a folder is named once
    assert all(f"<code>{name}</code>" in page for name in listed)
    assert "Python" in page.split('class="versions"')[0]
    assert 'class="command"' not in page  # none was given
    with xr.open_dataset(folder / "runs" / "step.nc") as run:
        assert np.array_equal(run["input"].values, design.evidence.evaluation.step.inputs)
    ours, loaded = design.controller(), fh.load_controller(folder / "controller")
    y = np.array([0.01])
    assert loaded.step(y, np.asarray(design.loop.setup.goal)) == ours.step(
        y, np.asarray(design.loop.setup.goal)
    )
