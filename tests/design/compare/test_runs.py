"""All laws run on the same plants, disturbances and seeds, and a row is the same each time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.design.compare import Comparison
from flexhinf.design.compare.merits import MERITS
from flexhinf.design.compare.runs import Runner
from flexhinf.design.draws import drawn_steps
from flexhinf.design.move import move_response


def test_rows_are_reproducible(made: Callable[..., Comparison]) -> None:
    once, again = (made(["pd", "lqg"]) for _ in range(2))
    for a, b in zip(once.rows, again.rows, strict=True):
        assert a.figures == b.figures
        assert a.runs is not None
        assert b.runs is not None
        np.testing.assert_array_equal(a.runs.step.run.signals["input"], b.runs.step.run.signals["input"])


def test_every_law_gets_bitwise_the_same_plants(
    made: Callable[..., Comparison], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: dict[int, list[bytes]] = {}
    plain = Runner.plant

    def spied(self: Runner, values: Any) -> Any:
        plant = plain(self, values)
        if values is not None:
            seen.setdefault(id(self.law), []).append(plant.parameters.vector().tobytes())
        return plant

    monkeypatch.setattr(Runner, "plant", spied)
    result = made(["pd", "torque", "lqg"], draws=4)
    assert len(result.drawn) == 4
    assert len(seen) == 4
    first, *others = [sorted(vectors) for vectors in seen.values()]
    assert len(first) == 8  # step and move of each
    assert len(set(first)) == 4
    assert all(other == first for other in others)


def test_the_plants_are_those_that_a_design_draws(rig: Comparison) -> None:
    bench = rig.reference.bench
    drawn = drawn_steps(bench, 3, 0.05, rig.sub_steps)
    assert [dict(values) for values in rig.drawn] == [dict(values) for values in drawn.values]


def test_noise_is_the_same_for_all_laws_and_another_for_each_robot(rig: Comparison) -> None:
    def noise(run: Any) -> np.ndarray:
        return run.signals["output"][:, 0] - run.signals["state"][:, 0]

    runs = [row.runs.step.run for row in rig.compared if row.runs is not None]
    for run in runs[1:]:
        np.testing.assert_allclose(noise(run), noise(runs[0]), atol=1e-12)
    runner = Runner(rig.reference.bench, rig.reference.synthesis.law, rig.sub_steps)
    one, other = (runner.step(0.1, values=rig.drawn[0], seed=seed).run for seed in (1, 2))
    assert np.abs(noise(one) - noise(other)).max() > 1e-6


def test_a_moving_law_on_the_nominal_robot_is_the_design_s_move(rig: Comparison) -> None:
    reference = rig.reference
    ours = Runner(reference.bench, reference.synthesis.law).move(reference.plan)
    theirs = move_response(reference.bench, reference.plan)
    np.testing.assert_allclose(ours.error, theirs.error, atol=1e-10)


def test_every_run_begins_at_rest(rig: Comparison) -> None:
    start, goal = rig.reference.bench.start, rig.reference.bench.goal
    for row in rig.compared:
        assert row.runs is not None
        np.testing.assert_allclose(row.runs.step.positions[0], start, atol=1e-12)
        np.testing.assert_allclose(row.runs.move.response.positions[0], start, atol=1e-12)
        still = row.runs.loaded.response.positions[row.runs.loaded.response.run.time < row.runs.loaded.at]
        np.testing.assert_allclose(still, np.broadcast_to(goal, still.shape), atol=2e-3)


def test_a_step_that_continues_the_input_does_so(rig: Comparison) -> None:
    held = rig.reference.bench.rest(rig.reference.bench.start)[1]
    for row in rig.compared:
        assert row.runs is not None
        first = row.runs.step.run.signals["input"][0]
        if row.runs.raw is None:
            assert not row.kind.integral
            continue
        np.testing.assert_allclose(first, held, atol=1e-6)
        assert abs(row.runs.raw.run.signals["input"][0] - held).max() > 0.1 * np.abs(held).max()


def test_the_step_of_the_reference_is_that_of_the_design(rig: Comparison) -> None:
    reference, runs = rig.reference, rig.first.runs
    assert runs is not None
    own = reference.bench.step(reference.step_duration)
    np.testing.assert_allclose(runs.step.positions, own.positions, atol=1e-9)
    np.testing.assert_allclose(runs.step.run.signals["input"], own.run.signals["input"], atol=1e-8)


def test_a_law_without_integrals_has_no_bias_that_fades(rig: Comparison) -> None:
    """The first input of a PD is what its formula says of the whole error, and what holds the goal."""
    row, bench = rig.row("pd"), rig.reference.bench
    assert row is not None
    assert row.tuned is not None
    assert row.runs is not None
    law: Any = row.tuned.law
    (begin, _), (goal, held) = (bench.robot.operating_point(pose) for pose in (bench.start, bench.goal))
    expected = held + law.gain @ (begin - goal)
    np.testing.assert_allclose(row.runs.step.run.signals["input"][0], expected, rtol=0.02)


@pytest.mark.parametrize("name", ["pd", "lqr"])
def test_draws_are_run_as_the_law_is_commanded(rig: Comparison, name: str) -> None:
    row = rig.row(name) or rig.first
    assert row.tuned is not None
    runner = Runner(rig.reference.bench, row.tuned.law, rig.sub_steps)
    step, _ = runner.drawn(rig.drawn[:1], 0.2, rig.reference.plan)[0]
    held = rig.reference.bench.rest(rig.reference.bench.start, rig.drawn[0])[1]
    jump = abs(step.run.signals["input"][0] - held).max()
    assert (jump < 0.01 * np.abs(held).max()) == row.kind.integral


def test_figures_are_there_for_all_merits(rig: Comparison) -> None:
    for row in rig.compared:
        missing = {merit.key for merit in MERITS if row.figures[merit.key] is None}
        assert missing <= {"damping"} | {key for key in row.figures if key.startswith("raw")}


def test_a_constant_load_leaves_what_the_spring_and_the_gain_give(made: Callable[..., Comparison]) -> None:
    """PD, the true state fed back: at rest (K + G') δq − K δθ = d, and K δq = (K + K_p) δθ."""
    result = made(["pd"], estimator="none", draws=0, duration=3.0, load=0.001)
    row, reference = result.row("pd"), result.reference
    assert row is not None
    assert row.tuned is not None
    law: Any = row.tuned.law
    joints, load = law.joints, float(reference.load[0])
    stiffness = np.array([
        [joints.stiffness[0] + joints.gravity_slope[0, 0], -joints.stiffness[0]],
        [-joints.stiffness[0], joints.stiffness[0] + law.proportional[0]],
    ])  # fmt: skip
    away = abs(np.linalg.solve(stiffness, [load, 0.0])[0])
    assert row.figures["load_remaining"] == pytest.approx(away, rel=0.03)
