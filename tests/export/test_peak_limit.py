"""A stated peak input limits the controller that is saved: in Python, from its file, and in C."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.designs.responses import joint_limits

QUICK = {"degrees": "2", "draws": 0, "rays": 0, "proof_seconds": 0}


@pytest.fixture(scope="module")
def limited() -> fh.Design:
    peaks = fh.Specification(pose="30deg", start="0", peak_effort=6.5, saturation=12.0, **QUICK)
    return fh.design(fh.load_robot("paper"), peaks)


@pytest.mark.ci("designs a controller")
@pytest.mark.oracle
def test_a_peak_below_the_motors_limit_saturates_every_controller(
    limited: fh.Design, compiler: str, tmp_path: Path
) -> None:
    """Old code wrote the saturation alone, 12 V; then a jump to 150° takes all of it."""
    limited.controller().save(path := tmp_path / "controller.json")
    library = fh.compile_controller(fh.load_controller(path), tmp_path / "arm.so")
    goal = np.radians(150.0)
    for controller in (limited.controller(), fh.load_controller(path), fh.load_compiled(library)):
        inputs = np.array([controller.step([0.0], [goal]) for _ in range(400)]).ravel()
        assert np.abs(inputs).max() == pytest.approx(6.5, rel=1e-12)


@pytest.mark.ci("designs a controller")
def test_what_the_step_demands_is_judged_without_the_limit(limited: fh.Design) -> None:
    evaluation, limits = limited.loop.evaluation, limited.loop.setup.limits
    assert limits.saturation.tolist() == [12.0]
    assert evaluation.step.peak_input == pytest.approx(6.5, rel=1e-12)
    assert evaluation.unlimited_step.peak_input > 6.5
    what = "peak input without limits"
    (peak,) = (line for line in limited.requirements if line.what == what and "nominal" in line.where)
    assert peak.found == evaluation.unlimited_step.peak_input
    assert not peak.met


def test_a_robots_own_limit_is_no_stated_peak() -> None:
    """`--saturation` above it stays what is stated."""
    robot = fh.load_robot("scara")
    limits = (
        fh.Specification(saturation=300.0),
        fh.Specification(saturation=300.0, peak_effort=(100.0, 400.0, 9.0, 9.0)),
    )
    own, stated = (joint_limits(robot, s) for s in limits)
    assert own.saturated.tolist() == [300.0] * 4
    assert stated.saturated.tolist() == [100.0, 300.0, 9.0, 9.0]
