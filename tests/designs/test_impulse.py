"""A blow on each joint of the resting loop: what the running loop does is what is judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from flexhinf.designs import PoseEvidence, Specification
from flexhinf.designs.checks import ROOM, ImpulseRuns, impulse_runs
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.loop_setup import LoopSetup
from flexhinf.loop.simulation.ring_down import Oscillation, RingDown
from flexhinf.pages.design.runs import ring_down, ring_down_rows
from flexhinf.report import with_figures

Setups = Callable[..., LoopSetup]


def struck(setup: LoopSetup, size: float = 1.0, most: float = 2.0) -> ImpulseRuns:
    return impulse_runs(setup, np.full(len(setup.goal), 2.0 * size), most)


def as_design(setup: LoopSetup, runs: ImpulseRuns) -> PoseEvidence:
    """As much of a design as the section reads."""
    evaluation = LawEvaluation(setup)
    vars(evaluation)["ring_down"] = runs
    return cast(PoseEvidence, SimpleNamespace(evaluation=evaluation))


@pytest.mark.ci("strikes a robot of a design")
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "goal", "noise"), [("paper", (1.2,), 1e-5), ("paper", (1.2,), 1e-10), ("cart", (0.1, 0.3), 1e-6)]
)
def test_a_small_blow_shows_the_damping_of_the_linear_loop(
    setup_of: Setups, name: str, goal: tuple[float, ...], noise: float
) -> None:
    """Law and estimator: with 1e-10 it is the estimation error that rings, which the law's modes do not show."""
    setup = setup_of(name, goal, torque_noise=noise)
    runs = struck(setup, 0.1)
    assert runs.exponential
    assert runs.damping == pytest.approx(LawEvaluation(setup).margins.damping, rel=0.01)


@pytest.mark.ci("strikes a robot of a design")
def test_a_blow_is_an_impulse_on_one_link_and_the_motors_stay_below_their_limits(setup_of: Setups) -> None:
    setup = setup_of("cart", (0.1, 0.3))
    runs = struck(setup)
    before, held = setup.equilibrium(setup.goal)
    names = setup.true_plant.states
    gone = np.array([response.run.signals["state"][0] - before for response in runs.responses])
    assert not gone[:, [k for k, name in enumerate(names) if "link_velocity" not in name]].any()
    a = setup.true_plant.linearise(before, held)[2]
    np.testing.assert_allclose(gone[1], a[:, 1] * runs.impulses[1], rtol=1e-9, atol=1e-12)
    used = np.abs(runs.responses[1].inputs - held).max()
    limit = np.abs(held).max() + 0.5 * used
    limited = replace(setup, specification=replace(setup.specification, peak_effort=limit))
    smaller = struck(limited)
    assert smaller.impulses[1] < runs.impulses[1]
    room = limit - np.abs(held)
    for response in smaller.responses:
        assert (np.abs(response.inputs - held) <= ROOM * room + 1e-9).all()
    assert smaller.damping == pytest.approx(runs.damping, rel=0.02)


@pytest.mark.ci("strikes a robot of a design")
def test_a_loop_that_rings_misses_the_line_with_its_joint(setup_of: Setups) -> None:
    setup = setup_of("planar-two-link", (0.4, 0.6), torque_noise=1e-10)
    runs = struck(setup)
    line = runs.requirement(Specification(damping=0.2), 0.2)
    assert not line.met
    assert (line.found, line.joint) == (runs.damping, setup.joints[runs.worst])
    assert line.stated_by == "--damping"
    assert runs.requirement(Specification(), 0.5 * runs.damping).met
    rows = ring_down_rows(runs)
    assert [row["joint"] for row in rows] == list(setup.joints)
    for k, response in enumerate(runs.responses):
        away = [
            abs(q - response.goal[k])
            for q in response.run.signal("state", f"link_position_{setup.joints[k]}")
        ]
        assert rows[k]["peak_deviation"] == max(away)
    row = rows[runs.worst]
    # A single mode leaves exp(−2π·3·ζ/√(1 − ζ²)) after three periods; others beside it a little more or less.
    left = np.exp(-6.0 * np.pi * runs.damping / np.sqrt(1.0 - runs.damping**2))
    assert 0.3 * left < row["left"] < 3.0 * left
    [[figure, table]] = with_figures(ring_down(as_design(setup, runs)))
    assert f" {runs.damping:.2g}" in figure.caption
    assert len(table.rows) == 2


@pytest.mark.parametrize(
    ("frequency", "damping", "met"), [(147.0, 0.00911, True), (14.7, 0.00911, False), (147.0, -0.001, False)]
)
def test_a_fast_oscillation_only_has_to_decay(frequency: float, damping: float, met: bool) -> None:
    """As in the requirement on the linear loop, see `oscillation_requirements`."""
    fit = RingDown(((Oscillation(frequency, damping, 0.5), Oscillation(5.0, 0.3, 1.0)),), 0.0, True)
    runs = ImpulseRuns((cast(Any, SimpleNamespace(joints=("joint",))),), np.ones(1), fit)
    line = runs.requirement(Specification(), 0.2)
    assert line.met is met
    assert "350 rad/s" in line.criterion


@pytest.mark.ci("strikes a robot of a design")
def test_a_delay_is_remembered(setup_of: Setups) -> None:
    setup = setup_of("paper", (1.2,), unknown_delay=8e-3)
    runs = struck(setup, 0.1)
    assert runs.damping == pytest.approx(LawEvaluation(setup).margins.damping, rel=0.01)


@pytest.mark.ci("a loop of its own")
def test_runs_that_leave_the_numbers_are_not_damped(setup_of: Setups) -> None:
    setup = setup_of(
        "paper", (np.pi / 2,), (0.0,), degree=4, game={"bandwidth": 9.0, "damping": 0.1}, period=0.1
    )
    runs = impulse_runs(setup, np.array([1.0]), 20.0)
    assert runs.ring_down is None
    assert runs.damping == -np.inf
    assert not runs.requirement(Specification(), 0.1).met
    design = as_design(setup, runs)
    (note,) = ring_down(design)
    assert "diverges" in note.text
    assert ring_down_rows(runs)[0]["damping"] is None
    assert ring_down_rows(runs)[0]["peak_deviation"] is None


@pytest.mark.ci("strikes a robot of a design")
def test_dry_friction_is_part_of_what_is_judged(setup_of: Setups) -> None:
    """A motor that sticks leaves its link swinging: the linear loop, without friction, does not show that."""
    options: dict[str, Any] = {"torque_noise": 1e-6, "period": 2e-3}
    free = setup_of("planar-two-link", (0.4, 0.6), **options)
    rough = setup_of("planar-two-link", (0.4, 0.6), extras=("coulomb_friction",), **options)
    assert LawEvaluation(rough).margins.damping == pytest.approx(
        LawEvaluation(free).margins.damping, rel=1e-6
    )
    runs = struck(rough)
    assert runs.damping < 0.8 * struck(free).damping
    assert runs.ring_down is not None
    vars(runs)["ring_down"] = replace(runs.ring_down, error=0.3, rests=False)
    assert runs.damping == 0.0
    note = next(ring_down(as_design(rough, runs)))
    assert "decay" in note.text
