"""``make bench-workspace``: the product's law for the workspace, as a row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.workspace import gamma
from benchmarks.workspace.arm import PERIOD, Arm
from benchmarks.workspace.goals import Reference, goals, moves, poses
from benchmarks.workspace.laws import LAWS
from benchmarks.workspace.linear import closed, late, outputs
from benchmarks.workspace.plants import PLANTS
from benchmarks.workspace.robots import ROBOTS
from benchmarks.workspace.rows import statics, written
from benchmarks.workspace.trip import Condition, trip
from scipy.optimize import brentq

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop
from flexhinf.modal import ModalLaw

PLANAR = "planar-two-link"


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm.of(ROBOTS[PLANAR].robot())


@pytest.fixture(scope="module")
def laws(arm: Arm, tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Any]:
    """By whether links are measured; each is designed, and then loaded from its file."""
    folder, found = tmp_path_factory.mktemp("rows"), {}
    for links in (True, False):
        LAWS["workspace"].make(arm, links, folder)
        before = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
        found[links] = LAWS["workspace"].make(arm, links, folder)
        assert {file: file.stat().st_mtime_ns for file in folder.iterdir()} == before
    return found


def at_rest(arm: Arm, links: bool, seed: int) -> tuple[np.ndarray, np.ndarray, Reference]:
    """A pose, what is measured there, and the reference that stays."""
    q = poses(arm, 1, seed)[0]
    theta, held = arm.rest(q)
    rest = np.concatenate([q, 0.0 * q, theta, 0.0 * q])
    return q, np.concatenate([q, theta]) if links else theta, Reference(rest, held, rest)


@pytest.mark.ci("shares two designs for a workspace")
@pytest.mark.parametrize("links", [True, False])
def test_the_linear_model_is_what_the_steps_do(arm: Arm, laws: dict[bool, Any], links: bool) -> None:
    law, rng = laws[links], np.random.default_rng(0)
    q, seen, reference = at_rest(arm, links, 4)
    law.start(q)
    assert law.step(seen, reference) == pytest.approx(reference.input, abs=1e-9)
    a, b, c, d = law.linear(q)
    x = np.zeros(len(a))
    for _ in range(40):
        y = 1e-7 * rng.standard_normal(len(seen))
        u = law.step(seen + y, reference) - reference.input
        wanted, x = c @ x + d @ y, a @ x + b @ y
        assert u == pytest.approx(wanted, rel=1e-3, abs=1e-3 * np.abs(wanted).max())


@pytest.mark.ci("shares two designs for a workspace")
@pytest.mark.parametrize("links", [True, False])
def test_the_loop_at_a_pose_is_flexhinfs(arm: Arm, laws: dict[bool, Any], links: bool) -> None:
    """The same eigenvalues with Pinocchio's model, sampled late by other code."""
    law, q = laws[links], poses(arm, 1, 6)[0]
    mine = np.abs(np.linalg.eigvals(closed(late(*arm.linear(q), 1.0), law.linear(q), outputs(2, links))))
    loop = EquilibriumLoop(
        law.controller.law, law.controller.estimator,
        arm.robot.plant(law.measured, extras=("joint_damping",)), PERIOD,
        equilibrium=arm.robot.operating_point(q), moving=True, latency=1,
    ).linear()  # fmt: skip
    theirs = np.abs(loop.closed_loop.multipliers)
    assert np.sort(mine)[::-1][:10] == pytest.approx(np.sort(theirs)[::-1][:10], abs=1e-6)


@pytest.mark.ci("shares two designs for a workspace")
def test_the_controller_is_that_of_a_design(arm: Arm, laws: dict[bool, Any]) -> None:
    """It is of the law for the workspace, knows one sample of latency, and holds the robot from the first sample."""
    controller = laws[True].controller
    assert isinstance(controller, fh.Controller)
    assert controller.summary()["law"] == ModalLaw.__name__
    assert controller.summary()["latency"] == "1 sample"
    assert laws[True].note["design_cpu"] > 0.0
    move = moves(arm, goals(arm, arm, 1)[0])[0]
    for plant in PLANTS.values():
        run = trip(plant, laws[True], [arm], [move], Condition("test"))
        assert run.refused == 0
        assert run.moves[0].arrives
        assert run.moves[0].wrong_way < 1.0
        assert run.moves[0].ripple < 1.5


@pytest.mark.oracle
def test_what_statics_leave_with_motor_encoders_alone() -> None:
    """The link of the paper's arm, heavier by a payload, on its spring: the root of a scalar equation."""
    entry = ROBOTS["paper"]
    nominal, loaded = (Arm.of(entry.robot(payload=payload)) for payload in (False, True))
    goal = np.array([1.0])
    theta = nominal.rest(goal)[0]

    def balance(q: float) -> float:
        return float((loaded.stiffness * (theta - q) - loaded.gravity(np.array([q])))[0])

    sagged = brentq(balance, 0.0, 2.0, xtol=1e-14)
    assert loaded.sagged(theta) == pytest.approx([sagged], abs=1e-9)
    move = moves(nominal, goal[None])
    assert statics(nominal, [loaded], move) == pytest.approx(abs(sagged - 1.0), abs=1e-9)
    assert statics(nominal, [nominal], move) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.ci("tunes a law for each γ")
def test_tolerances_by_gamma_are_kept_and_shown(tmp_path: Path) -> None:
    found = gamma.row(ROBOTS[PLANAR].robot(), poses=20)
    known, late = ([law[key] for law in found["laws"]] for key in ("known", "late"))
    assert all(0.0 < b < a < 1.0 for a, b in zip(known, late))  # a sample of latency costs some of it
    written(tmp_path, f"{PLANAR}.gamma", found)
    cells = gamma.table(tmp_path).splitlines()[2]
    assert cells.startswith(f"| {PLANAR} | {100 * known[0]:.1f} %")
    assert cells.count("|") == len(gamma.GAMMAS) + 2
