"""design.json: the numbers of the page, finite or null."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.design import Design, design_files
from flexhinf.design.page.numbers import finite
from flexhinf.design.response import step_response

Make = Callable[[str], Design]

#: Keys of the first version, which programs may read.
KEPT = {
    "version", "robot", "joints", "gamma_star", "gamma", "degree", "states", "operating_point", "operating_input",
    "open_modes", "closed_modes", "estimator_modes", "degrees", "step", "mujoco", "rigid", "noise_variances",
    "initial_variance",
}  # fmt: skip


def numbers(design: Design) -> dict[str, Any]:
    """Of its file."""
    return json.loads(design_files(design, ["flexhinf"])["design.json"])


def leaves(value: Any) -> list[Any]:
    """All that is no list and no object."""
    if isinstance(value, dict):
        return [leaf for entry in value.values() for leaf in leaves(entry)]
    return [leaf for entry in value for leaf in leaves(entry)] if isinstance(value, list) else [value]


@pytest.mark.parametrize("name", ["met", "rings", "robust", "cart", "true state"])
def test_every_number_is_finite_or_null(page_design: Make, name: str) -> None:
    found = numbers(page_design(name))
    assert set(found) >= KEPT
    assert all(math.isfinite(leaf) for leaf in leaves(found) if isinstance(leaf, float))


def test_what_is_not_finite_becomes_null() -> None:
    value = {"a": np.array([1.0, np.inf]), "b": (np.nan, {"c": np.float64(2.0)}), "d": True, "e": "text"}
    assert finite(value) == {"a": [1.0, None], "b": [None, {"c": 2.0}], "d": True, "e": "text"}


def test_the_file_has_what_was_found(page_design: Make) -> None:
    design = page_design("met")
    found = numbers(design)
    assert found["met"] is True
    assert [line["what"] for line in found["specification"]] == [line.what for line in design.met]
    assert found["weights"]["wanted"] == {"bandwidth": [4.0], "damping": 0.3}
    assert sum(one["used"] for one in found["weights"]["tries"]) == 1
    assert found["margins"]["peak_sensitivity"] == design.margins.peak_sensitivity
    assert found["draws"]["settling_time_s"] == pytest.approx(design.draws.settling.tolist())
    assert found["inputs"]["to rest at the goal"] == pytest.approx(abs(design.bench.rest(design.goal)[1][0]))
    assert found["inputs"]["the step, nominal robot"] == np.abs(design.response.run.signals["input"]).max()
    assert found["attained"]["gain"] == design.guarantee.attained.gain
    assert found["budget"][-1]["spent"] == design.guarantee.expenses[-1].budget.total
    assert found["load"]["joints"][0]["load"] == design.disturbed.load[0]


def test_a_run_that_diverged_is_null_in_the_file(page_design: Make) -> None:
    design = page_design("met")
    draws = dataclasses.replace(design.draws, overshoot=np.full(16, np.inf), settling=np.full(16, np.inf))
    found = numbers(dataclasses.replace(design, draws=draws))
    assert found["draws"]["overshoot_percent"] == [None] * 16
    assert found["draws"]["diverged"] == 16


@pytest.mark.oracle
def test_kept_positions_are_those_of_the_robot_that_was_drawn(page_design: Make) -> None:
    design = page_design("met")
    bench, draws, k = design.bench, design.draws, 5
    assert draws is not None
    known = bench.true_plant.parameters.values
    values = {name: value for name, value in draws.values[k].items() if name in known}
    loop = bench.loop(
        bench.controller(bench.start), bench.true_plant.with_parameters(**values), design.sub_steps[1]
    )
    begin = bench.rest(bench.start, draws.values[k])
    seed = design.specification.seed + 1 + k
    run = step_response(loop, begin, bench.goal, bench.noise, design.duration, seed)
    at = np.searchsorted(run.run.time, draws.time - 1e-9)
    assert np.array_equal(draws.positions[k], run.positions[at])
    assert len(draws.time) <= 401
    assert draws.time[-1] > 0.98 * design.duration
