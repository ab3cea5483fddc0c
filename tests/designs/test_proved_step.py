"""The search for the proved step."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.certify import box
from flexhinf.certify.box import tolerance_statement
from flexhinf.certify.certificate import path_start
from flexhinf.certify.starts import robot_start
from flexhinf.designs import proved_step
from flexhinf.designs.proved_step import search_proved_step
from flexhinf.designs.specification import Specification
from flexhinf.designs.synthesis.steps import synthesise
from flexhinf.errors import InvalidInput

ARM = fh.paper_arm()


@pytest.mark.nightly("proves many candidates; others of this file are found among fewer")
def test_the_smaller_gain_of_two_laws_is_proved_for_a_wanted_step() -> None:
    one = {"tolerances": 0.0, "bandwidths": (1.0,), "dampings": (None,), "step": 1.0, "most_cells": 300_000}
    alone = search_proved_step(ARM, (np.pi,), degrees=(2,), ratios=(2.0,), **one)
    both = search_proved_step(ARM, (np.pi,), degrees=(2, 4), ratios=(1.5, 2.0), **one)
    assert alone.candidates == 2  # of the presets robust and damped
    assert both.candidates > 2
    assert both.gamma < alone.gamma
    for found in (alone, both):
        assert found.certificate is not None
        assert found.certificate.gamma == found.gamma
        assert found.certificate.step_amplitude >= found.step == 1.0
        assert found.peak_effort > 5.0


@pytest.mark.ci("searches and proves laws")
def test_the_largest_step_is_the_one_that_the_limit_leaves() -> None:
    few = {"tolerances": 0.0, "bandwidths": (1.0,), "dampings": (None,), "ratios": (1.5,)}
    found = search_proved_step(ARM, (np.pi,), effort_limit=20.0, **few)
    assert 0.3 < found.step < np.pi
    assert 18.0 < found.peak_effort <= 20.0
    assert found.gamma_star == fh.smallest_gamma(found.problem) < found.gamma


@pytest.mark.ci("searches and proves laws")
def test_a_limit_that_no_law_keeps_is_said() -> None:
    with pytest.raises(InvalidInput, match=r"(?s)step.*proved.*input of 3[0-9.]+\n"):
        search_proved_step(
            ARM, (np.pi,), 3.0, effort_limit=1.0, bandwidths=(1.0,), dampings=(0.4,), ratios=(1.5,)
        )


@pytest.mark.ci("a proof over a box of all tolerances")
def test_half_a_turn_within_forty_volts_is_proved_for_all_tolerances() -> None:
    found = search_proved_step(
        ARM, (np.pi,), np.pi, effort_limit=40.0, bandwidths=(1.0,), dampings=(0.4,), ratios=(1.5,)
    )
    assert found.peak_effort < 40.0
    assert found.gamma < 230.0  # 490 with a multiple of its own V
    assert found.certificate is not None
    assert {p.name for p in found.certificate.parameters if p.low < p.high} >= {
        "mass",
        "stiffness",
        "resistance",
    }


@pytest.mark.parametrize(
    ("fields", "what", "advice"),
    [
        ({"via": ((0.5,),)}, "`via` contradict", "`via`"),
        ({"rays": 10}, "`rays` contradict", "`rays`"),
        ({"checked_gamma_ratio": 3.0}, "`checked_gamma_ratio` contradict", "`checked_gamma_ratio`"),
        ({"proof_seconds": 0.0}, "time", "proof_seconds=20"),
        ({"penalty": (1.0,) * 5}, "`penalty` contradict", "`penalty`"),
    ],
)
def test_a_field_that_the_preset_cannot_use_is_refused(fields: dict, what: str, advice: str) -> None:
    asked = Specification(pose=(np.pi,), start=(0.0,), preset="proved", **fields)
    with pytest.raises(InvalidInput) as refused:
        synthesise(ARM, asked, lambda text: None)
    assert what in refused.value.what
    assert refused.value.found.startswith("expected ")
    assert advice in refused.value.advice


def test_more_than_one_joint_is_refused() -> None:
    robot = fh.load_robot("planar-two-link")
    asked = Specification(pose=(0.3, 0.3), start=(0.0, 0.0), preset="proved")
    with refused_with(InvalidInput, "joint", "2 in 'planar-two-link'", "preset='robust'"):
        synthesise(robot, asked, lambda text: None)


class Searched(Exception):
    """The search was called."""


def test_what_is_stated_is_not_searched_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict = {}

    def search(*given: Any, **settings: Any) -> Any:
        asked.update(settings)
        raise Searched

    monkeypatch.setattr(proved_step, "search_proved_step", search)

    def searched(**fields: Any) -> dict:
        asked.clear()
        with pytest.raises(Searched):
            synthesise(
                ARM,
                Specification(preset="proved", pose=(np.pi,), start=(0.0,), peak_effort=30.0, **fields),
                print,
            )
        return {name: asked.get(name) for name in ("bandwidths", "dampings", "degrees", "ratios")}

    nothing = dict.fromkeys(("bandwidths", "dampings", "degrees", "ratios"))
    assert searched() == nothing
    assert asked["effort_limit"] == 30.0
    assert asked["tolerances"] == 1.0
    assert searched(bandwidth=2.0, damping=0.3) == nothing | {"bandwidths": (1.0,), "dampings": (0.3,)}
    assert searched(degrees=(2, 4), gamma_ratio=1.8) == nothing | {"degrees": (2, 4), "ratios": (1.8,)}


def test_steps_from_above_start_on_the_other_side() -> None:
    """At 90° the weight has no symmetry: the starts of both sides are equilibria, and not mirrored."""
    problem = ARM.problem(pose=(np.pi / 2,))
    solution = fh.solve_hji(problem, 1.5 * fh.smallest_gamma(problem), 2)
    statement = tolerance_statement(solution, problem, {}, 1.0)
    ends = []
    for side in (-1.0, 1.0):
        start = robot_start(statement, side)
        assert start is not None
        x = path_start(statement, start, 1.0)
        assert x[0] == side
        there = ARM.operating_point((np.pi / 2 + side,))[0] - ARM.operating_point((np.pi / 2,))[0]
        np.testing.assert_allclose(x[:4], there, atol=1e-12)
        held = ARM.operating_point((np.pi / 2 + side,))[1]
        np.testing.assert_allclose(solution.operating_input + solution.inputs(x[None])[0], held, atol=1e-9)
        ends.append(x)
    assert abs(ends[0][4] + ends[1][4]) > 1e-3


@pytest.mark.parametrize("step", [1.0, None])
def test_a_run_whose_input_is_no_number_keeps_no_limit(
    step: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = {"tolerance_statement": box, "step_start": proved_step, "path_start": proved_step}
    for name, module in of.items():
        monkeypatch.setattr(module, name, lambda *_: None)
    monkeypatch.setattr(proved_step, "_peak_effort", lambda *_: np.nan)
    monkeypatch.setattr(proved_step, "sampled_box", lambda *_: pytest.fail("it was kept"))
    candidate = SimpleNamespace(solution=None, problem=None, bandwidth=np.ones(1))
    with refused_with(InvalidInput, "step", "input", "nan"):
        proved_step._within(candidate, {}, step, np.inf)
