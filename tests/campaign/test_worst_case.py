"""The worst plant in a box: known maxima, a dense grid by another route, other seeds, and what is kept on disk."""

from __future__ import annotations

import itertools
import json
import math
import pickle
import sys
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.campaign.conftest import Feedback, made_campaign, made_loop, spring, tolerances
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.analysis import EquilibriumLoop
from flexhinf.analysis.search import climb
from flexhinf.campaign import (
    Campaign,
    Journal,
    Sample,
    Tolerances,
    Variable,
    drive,
    run_batch,
    stored_worst,
    stored_worsts,
    worst_case,
)
from flexhinf.campaign.manifest import sealed
from flexhinf.errors import InvalidInput

#: The file, beside the function of the same name.
files = sys.modules["flexhinf.campaign.worst_case"]

#: Long enough to settle.
QUIET = {"duration": 12.0, "noise": 1e-5, "reference": 0.1}

TURN = np.array([[0.8, -0.6], [0.6, 0.8]])


def bowl(t):
    """Largest inside, at (0.62, 0.31), forty times as steep across as along a line askew."""
    a, b = ((t - [0.62, 0.31]) @ TURN).T
    return -(a**2) - 40.0 * b**2


def ramp(t):
    """Largest at the corner (1, 0, 1)."""
    return t @ np.array([3.0, -2.0, 1e-3]) + t[:, 0] * t[:, 2]


def steps(t):
    """Jumps, as a settling time has them: largest at (1, 1)."""
    return np.floor(20.0 * t.sum(axis=1))


def waves(t):
    """Nine summits; the highest at (0.9, 0.9)."""
    return (np.cos(5.0 * np.pi * (t - 0.9)) - (t - 0.9) ** 2).sum(axis=1)


STARTS = np.random.default_rng(3).random((24, 3))


@pytest.mark.parametrize(
    ("function", "where", "within"),
    [
        (bowl, (0.62, 0.31), 2e-4),
        (ramp, (1.0, 0.0, 1.0), 0.0),
        (steps, (1.0, 1.0), 0.1),
        (waves, (0.9, 0.9), 2e-4),
    ],
)
def test_known_maxima_are_found(function, where, within):
    starts = STARTS[: 24 if function is waves else 8, : len(where)]
    found = climb(function, starts)
    np.testing.assert_allclose(found.point, where, rtol=0.0, atol=within)
    assert found.value == pytest.approx(function(found.point[None, :])[0], abs=1e-15)
    assert found.evaluations < 200 * len(starts)


def test_a_search_without_a_slope_a_value_or_an_end_stays_at_its_best_start():
    flat = climb(lambda t: np.zeros(len(t)), STARTS)
    assert (flat.value, flat.point.tolist()) == (0.0, STARTS[0].tolist())
    holes = climb(lambda t: np.where(t[:, 0] > 0.5, -math.inf, t[:, 0]), STARTS)
    assert 0.5 - 1e-3 < holes.value <= 0.5
    endless = climb(lambda t: np.where(t[:, 0] > 0.9, math.inf, t[:, 0]), STARTS[:1])
    assert endless.value == math.inf


@pytest.fixture(scope="module")
def campaign():
    return made_campaign(options=QUIET)


@pytest.fixture(scope="module")
def rows(campaign):
    parts = [run_batch(campaign, batch) for batch in range(campaign.batches)]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


@pytest.mark.oracle
def test_no_point_of_a_dense_grid_is_worse(campaign, rows):
    """The grid's runs are made alone, by Loop.run, corners and edges among them."""
    found = worst_case(campaign, "peak_input", rows)
    grid = itertools.product(np.linspace(0.8, 1.2, 9), np.linspace(15.0, 25.0, 9))
    seed = int(rows["seed"][found.sample])
    peaks = [
        campaign.loop.with_plant(campaign.loop.true_plant.with_parameters(mass=m, stiffness=k))
        .run(seed=seed, **QUIET)
        .metrics()["peak_input"]
        for m, k in grid
    ]
    assert max(peaks) <= found.found.value
    assert found.corner.value == max(peaks[k] for k in (0, 8, 72, 80))
    assert found.found.value == pytest.approx(max(peaks), rel=0.02)
    assert found.all_corners
    assert all(low <= found.found.numbers[k] <= high for k, (low, high) in found.intervals.items())


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("metric", ["overshoot_percent", "settling_time_s", "tracking_rmse"])
def test_the_worst_found_is_never_better_than_the_samples_and_replays_bit_by_bit(campaign, rows, metric):
    found, other = (worst_case(campaign, metric, rows, seed=seed) for seed in (0, 1))
    assert found.sampled.value == np.nanmax(rows[metric]) == rows[metric][found.sample]
    assert found.found.value >= found.sampled.value
    assert found.again(campaign) == found.found  # alone, where the search ran it beside hundreds
    assert worst_case(campaign, metric, rows, seed=0) == found
    assert other.found.value == pytest.approx(found.found.value, rel=0.01)
    assert found.factor == found.found.value / found.sampled.value


@pytest.mark.parametrize("starts", [1, 2, 5])
def test_the_worst_found_is_never_better_than_the_worst_of_the_corners_that_are_run(
    campaign, rows, starts, monkeypatch
):
    """Of many corners some are run."""
    monkeypatch.setattr(files, "MOST_CORNERS", 2)
    monkeypatch.setattr(files, "CORNERS", 1)
    given: list[np.ndarray] = []
    monkeypatch.setattr(
        files, "climb", lambda values, begun, progress: given.append(begun) or climb(values, begun)
    )
    for metric in ("settling_time_s", "tracking_rmse"):
        found = worst_case(campaign, metric, rows, starts=starts)
        assert (found.corners, found.all_corners) == ((4, True) if starts == 5 else (starts, False))
        assert found.found.value >= max(found.corner.value, found.sampled.value)
        begun = given.pop()
        assert len(begun) == starts
        assert starts == 1 or np.isin(begun, (0.0, 1.0)).all(axis=1).any()


def test_a_corner_that_no_sample_reaches_is_found_without_a_step(campaign, rows, monkeypatch):
    """The searches only begin."""

    def begun(values, starts, progress):
        best = int(np.argmax(values(starts)))
        return SimpleNamespace(point=starts[best], together=1)

    monkeypatch.setattr(files, "climb", begun)
    for starts in (1, 2, 3):
        found = worst_case(campaign, "peak_input", rows, starts=starts)
        assert found.found == found.corner
        assert found.worse
        assert set(found.found.numbers.values()) <= {0.8, 1.2, 15.0, 25.0}


def damped(campaign, numbers):
    """The least damping ratio by matrix exponentials, of one plant."""
    loop = campaign.loop
    linear = EquilibriumLoop(
        loop.controller.law, loop.controller.estimator, loop.true_plant, loop.controller.period, goal=[0.1]
    )
    return linear.linear(numbers).closed_loop.damping_about(math.inf)[0]


def test_the_least_damping_of_the_box_is_found_by_search(tmp_path):
    pytest.importorskip("pyarrow")
    campaign = made_campaign()
    found = worst_case(campaign, "damping")
    grid = itertools.product(np.linspace(0.8, 1.2, 5), np.linspace(15.0, 25.0, 5))
    ratios = [damped(campaign, {"mass": m, "stiffness": k}) for m, k in grid]
    assert found.least
    assert found.found.value == pytest.approx(min(ratios), rel=1e-6)
    assert found.corner.value == pytest.approx(min(ratios[k] for k in (0, 4, 20, 24)), rel=1e-9)
    assert found.nominal.value == pytest.approx(ratios[12], rel=1e-9)
    assert found.sampled.value > found.found.value > 0.1
    assert found.again(campaign) == found.found
    assert pickle.loads(pickle.dumps(campaign)).settings == campaign.settings
    journal = Journal.opened(tmp_path / "runs", campaign)
    assert stored_worsts(journal) == []
    assert [worst_case(campaign, "damping", journal=journal)] == stored_worsts(journal) == [found]


def test_a_box_with_unstable_linear_loops_has_one_as_its_worst_plant():
    box = Tolerances([Variable("mass", 0.8, 1.2), Variable("stiffness", -100.0, 25.0)])
    campaign = made_campaign(draw=box)
    found = worst_case(campaign, "damping", starts=2)
    assert (found.found.status, math.isnan(found.factor)) == ("unstable", True)
    assert found.found.value < 0.0
    assert damped(campaign, found.found.numbers) == pytest.approx(found.found.value, rel=1e-6)


def test_a_parameter_that_is_called_damping_is_not_the_damping_of_the_loop():
    def flow(x, u, d, p):
        return np.array([x[1], (u[0] - p.stiffness * x[0] - p.damping * x[1]) / p.mass])

    numbers = {"mass": 1.0, "stiffness": 20.0, "damping": 0.5}
    damped = fh.Plant(
        flow, lambda x, u, p: np.array([x[0]]), ("position", "velocity"), ("force",), (), numbers
    )
    box = Tolerances([Variable("damping", 0.4, 0.6, unit="N·s/m"), Variable("mass", 0.8, 1.2)])
    campaign = Campaign(fh.Loop(damped, made_loop().controller, 1), box, 4, options=QUIET)
    rows = run_batch(campaign, 0)
    found, apart = (worst_case(campaign, "damping", given, starts=1) for given in (rows, None))
    assert found == apart
    assert (found.unit, found.least) == ("", True)
    assert found.found.numbers["damping"] == 0.4
    (ratio,), _ = campaign.linear_damping([box.built(found.found.numbers, found.sample)])
    assert found.found.value == pytest.approx(ratio)


def test_linear_loops_that_are_not_known_are_refused():
    def fixed(x, step, p):
        return x

    moving = Tolerances([Variable("mass", 0.8, 1.2)], build=lambda n: Sample(n, {"reference": 0.1}, n))
    late = fh.Loop(spring(), made_loop().controller, 1, delay=5 * 4e-3)
    sticky = spring()
    sticky = fh.Plant(
        sticky.flow, sticky.output, sticky.states, sticky.inputs, sticky.disturbances,
        {"mass": 1.0, "stiffness": 20.0}, arrest=fixed,
    )  # fmt: skip
    sticking = fh.Loop(sticky, made_loop().controller, 1)
    for loop, draw, words in (
        (made_loop(), moving, ("goal", "move")),
        (late, tolerances(), ("delay", "4.6", "6")),
        (sticking, tolerances(), ("smooth", "stick", "LinearPlant")),
    ):
        with refused_with(InvalidInput, *words, "overshoot_percent"):
            worst_case(Campaign(loop, draw, 4, options=QUIET), "damping")


def final_force(run):
    return float(run.signals["input"][-1, 0])


def test_the_plant_is_the_one_that_is_known_to_be_the_worst():
    """At rest the force is stiffness times position: the stiffest spring needs most, the softest least."""
    options = {"reference": 0.1, "duration": 12.0}
    loop = fh.Loop(spring(), fh.Controller(Feedback(), None, 4e-3))
    campaign = Campaign(loop, tolerances(), 6, metrics={"force": final_force}, options=options)
    most, least = (worst_case(campaign, "force", least=least, starts=2) for least in (False, True))
    assert (most.found.numbers["stiffness"], least.found.numbers["stiffness"]) == (25.0, 15.0)
    assert most.found.value == pytest.approx(2.5, rel=5e-3)
    assert least.found.value == pytest.approx(1.5, rel=5e-3)
    assert abs(most.alone["mass"] - 2.5) < 0.05 < abs(most.alone["stiffness"] - 2.5)
    assert most.nominal.numbers == {"mass": 1.0, "stiffness": 20.0}


def test_a_sample_that_diverges_is_the_worst_and_one_outside_the_box_is_not_compared(campaign, rows):
    status = rows["status"].copy()
    status[7] = "diverged"
    found = worst_case(campaign, "peak_input", {**rows, "status": status})
    assert (found.sample, found.worse, found.found.status) == (7, False, "diverged")
    assert math.isnan(found.factor)
    mass = rows["mass"].copy()
    mass[np.argmax(rows["peak_input"])] = 3.0
    found = worst_case(campaign, "peak_input", {**rows, "mass": mass}, starts=1)
    assert found.outside == 1
    assert found.sampled.value < rows["peak_input"].max()


def test_it_is_kept_whole_or_not_at_all(tmp_path, monkeypatch, campaign):
    pytest.importorskip("pyarrow")
    journal = Journal.opened(tmp_path / "runs", campaign)
    table = drive(campaign, journal)
    assert table is not None

    def stop(runs, best):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        worst_case(campaign, "peak_input", table.columns, journal=journal, progress=stop)
    assert stored_worsts(journal) == []
    with refused_with(InvalidInput, "'peak_input'", "searched"):
        stored_worst(journal, "peak_input")
    found = worst_case(campaign, "peak_input", table.columns, journal=journal)
    path = tmp_path / "runs" / "worst-case" / "peak_input.json"
    content = path.read_bytes()
    assert stored_worst(journal, "peak_input") == found
    with monkeypatch.context() as patch:
        patch.setattr(files, "climb", None)  # it is not searched again
        assert worst_case(campaign, "peak_input", table.columns, journal=journal) == found
    path.write_bytes(content[:-9])
    with refused_with(InvalidInput, "'peak_input'", "peak_input.json"):
        stored_worst(journal, "peak_input")
    with refused_with(InvalidInput, "'peak_input'", "peak_input.json", "searches again"):
        stored_worsts(journal)  # a damaged file is none that is missing
    assert worst_case(campaign, "peak_input", table.columns, journal=journal) == found
    assert stored_worsts(journal) == [found]
    assert path.read_bytes() == content
    stated = json.loads(content)
    del stated["sha256"]
    path.write_bytes(sealed(stated | {"settings": stated["settings"] | {"campaign": "another"}}))
    assert stored_worsts(journal) == []  # in this campaign nothing was searched
    with refused_with(InvalidInput, "'peak_input'", "searched"):
        stored_worst(journal, "peak_input")


def test_numbers_that_json_does_not_have(tmp_path, campaign, rows):
    pytest.importorskip("pyarrow")
    found = worst_case(campaign, "peak_input", rows, starts=1)
    odd = replace(found, found=replace(found.found, value=math.inf), alone={"mass": -math.inf})
    journal = Journal.opened(tmp_path / "runs", campaign)
    journal.store(files.FOLDER / "peak_input.json", asdict(odd))
    assert stored_worst(journal, "peak_input") == odd


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"metric": "peak"}, "metric 'peak'"),
        ({"starts": 0}, "starts=0"),
        ({"device": "tpu"}, "(?s)device.*'tpu'"),
        ({"seed": -1}, "seed=-1"),
        ({"rows": {"status": np.zeros(50)}}, "(?s)rows.*50 numbers"),
        (
            {"rows": dict.fromkeys(("status", "peak_input", "mass", "stiffness"), np.zeros(3))},
            "(?s)rows.*50 numbers",
        ),
    ],
)
def test_mistakes(campaign, rows, changes, what):
    given = {"metric": "peak_input", "rows": rows, **changes}
    with pytest.raises(InvalidInput, match=what) as error:
        worst_case(campaign, given.pop("metric"), **given)
    assert all(part in str(error.value) for part in ("found:", "try:"))


def test_a_draw_without_a_box_and_a_metric_that_no_run_has(campaign, rows):
    with refused_with(InvalidInput, "box", "FunctionDraw"):
        worst_case(made_campaign(draw=lambda rng: {"mass": 1.0}), "peak_input")
    nothing = {**rows, "peak_input": np.full(50, math.nan)}
    with refused_with(InvalidInput, "sample", "'peak_input'", "50 rows"):
        worst_case(campaign, "peak_input", nothing)


def test_numbers_that_a_normal_distribution_puts_outside():
    wide = made_campaign(samples=400, draw=tolerances("random", "normal"))
    assert worst_case(wide, "peak_input", starts=1).outside > 0
