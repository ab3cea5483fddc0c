"""The laws that can be compared: names, sensors, parameters, and that each can be made."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.baselines import MotorPD
from flexhinf.design import Specification
from flexhinf.design.laws import (
    CHANNELS,
    CONTAINED,
    DEGREE,
    DESIGN,
    ESTIMATOR_NOISE,
    LAWS,
    MOTOR_NOISE,
    NL_HINF,
    LawFactory,
    law_kind,
    law_names,
    weighted,
)
from flexhinf.design.problem.presets import sized_channels
from flexhinf.design.synthesis.steps import synthesise
from flexhinf.errors import InvalidInput
from flexhinf.hinf import solve_hji

NAMES = [name for name in LAWS if name != DESIGN]

#: Laws without an integral.
PROPORTIONAL = ("pd", "pd-gravity", "torque", "flatness", "position-drive", "velocity-drive")


@pytest.fixture(
    scope="module",
    params=["paper", pytest.param("robust", marks=pytest.mark.ci("searches weights by the whole loop"))],
)
def factory(request: Any) -> LawFactory:
    s = Specification(
        pose=(0.8,), start=(0.3,), degrees=(4,), rays=0, preset=request.param, torque_noise=1e-7
    )
    return LawFactory(synthesise(fh.load_robot("vertical-rig"), s, lambda text: None), 5.0)


def test_the_strongest_rivals_are_in_the_default_set() -> None:
    assert {"flatness-i", "torque-i", "pid", "pd", "pd-gravity", "lqr", "nlqr", "hinf"} <= set(law_names())


def test_the_design_and_the_same_tuned_are_first_and_each_name_is_there_once() -> None:
    assert law_names(("pd", "lqr", "pd", DESIGN)) == (DESIGN, NL_HINF, "pd", "lqr")
    assert law_names(("nl-hinf-4",)) == (DESIGN, NL_HINF, "nl-hinf-4")
    assert law_names(())[0] == DESIGN


@pytest.mark.parametrize(
    ("name", "near"), [("pdd", "pd"), ("flatnes", "flatness"), ("nl-hinf-14", "nl-hinf-4"), ("xyz", "--laws")]
)
def test_a_name_that_is_not_known_is_refused_with_the_nearest(name: str, near: str) -> None:
    with pytest.raises(InvalidInput, match=f"(?s)law '{name}'.*{near}"):
        law_names(["pd", name])


def test_the_names_of_a_refusal_are_those_of_laws() -> None:
    with pytest.raises(InvalidInput) as refused:
        law_kind("nl-hinf-1")
    names = re.findall(r"'([^']+)'", refused.value.found.rpartition(", got ")[0])
    assert set(LAWS) < set(names)
    assert [law_kind(name).name for name in names] == names


def test_a_law_on_the_motor_side_measures_the_motor() -> None:
    """A PD acts on the encoder of its motor, not through a filter on the link."""
    assert law_kind("pd").sensors == (("motor_position",),)
    assert law_kind("pd-gravity").sensors == (("motor_position",),)
    for name in ("pid", "torque", "torque-i", "flatness", "flatness-i"):
        assert all("motor_position" in sensors for sensors in law_kind(name).sensors)
    for name in ("lqr", "nlqr", "hinf", "lqg"):
        assert law_kind(name).sensors == ()


def test_a_law_that_integrates_the_link_s_error_measures_the_link() -> None:
    for name in ("pid", "torque-i", "flatness-i"):
        assert any("link_position" in sensors for sensors in law_kind(name).sensors)


@pytest.mark.parametrize("name", NAMES)
def test_every_law_is_made_at_its_start_and_changes_with_each_parameter(
    factory: LawFactory, name: str
) -> None:
    """All parameters are searched, so each must act."""
    kind = law_kind(name)
    start, bounds = factory.start(kind), factory.bounds(kind)
    plain = factory.make(kind, start)
    assert plain.input_names == tuple(factory.synthesis.problem.plant.inputs)
    assert any(n.endswith("_integral") for n in plain.state_names) == (name not in PROPORTIONAL)
    for parameter in start:
        low, high = bounds[parameter]
        assert low <= start[parameter] <= high
        factor = 0.75 if parameter in (DEGREE, CHANNELS) else 1.1
        changed = factory.make(kind, {**start, parameter: factor * start[parameter]})
        same = changed.law_data.shape == plain.law_data.shape and np.allclose(
            changed.law_data, plain.law_data, rtol=1e-9
        )
        assert same == (parameter in (ESTIMATOR_NOISE, MOTOR_NOISE))
    assert ESTIMATOR_NOISE in start


def test_the_design_s_own_weights_and_level_give_the_design_s_own_law(factory: LawFactory) -> None:
    kind = law_kind("nl-hinf-4")
    values = {**factory.start(kind), "velocity_weight": 1e-12}
    own = factory.synthesis.solution
    np.testing.assert_allclose(factory.make(kind, values).law_data, own.law_data, rtol=1e-6, atol=1e-9)
    linear = factory.make(law_kind("hinf"), values)
    np.testing.assert_allclose(linear.gain, own.gain, rtol=1e-6)  # type: ignore[attr-defined]
    assert factory.make(law_kind(DESIGN), {}) is factory.synthesis.law


def test_a_pd_is_made_from_its_bandwidth_and_damping(factory: LawFactory) -> None:
    made = factory.make(law_kind("pd"), {"bandwidth": 7.0, "damping": 0.6, ESTIMATOR_NOISE: 1.0})
    expected = MotorPD.tuned(factory.synthesis.problem, 7.0, 0.6)
    np.testing.assert_allclose(made.law_data, expected.law_data)


@pytest.mark.oracle
def test_weights_are_those_of_the_quadratic_form() -> None:
    """hᵀh and R2 of the changed problem against the paper's, by hand."""
    problem = fh.paper_arm().problem()
    changed = weighted(problem, 0.5, 2.0, 0.1)
    h, names = changed.expand(1).h_parts[1], changed.state_names
    expected = np.zeros(5)
    expected[names.index("link_position")] = 60.0**2
    expected[names.index("link_velocity")] = (0.1 * 60.0) ** 2
    expected[names.index("link_position_integral")] = (2.0 * 300.0) ** 2
    np.testing.assert_allclose(h.T @ h, np.diag(expected), atol=1e-9)
    np.testing.assert_allclose(changed.r2, 0.5 * problem.r2)
    same = weighted(problem, 1.0, 1.0, 0.0)
    np.testing.assert_allclose(
        solve_hji(same, np.inf, 4).law_data, solve_hji(problem, np.inf, 4).law_data, rtol=1e-9
    )


def test_sources_are_in_the_bibliography_or_named() -> None:
    text = Path("docs/references.bib").read_text().lower()
    for name in LAWS:
        source = law_kind(name).source
        year = re.search(r"(1\d{3}|20\d{2})", source)
        assert year is None or year[1] in text


@pytest.mark.parametrize(("family", "contained"), [(NL_HINF, "nlqr"), ("hinf", "lqr")])
def test_nonlinear_h_infinity_contains_the_nonlinear_lqr(
    factory: LawFactory, family: str, contained: str
) -> None:
    """Old code kept the channels of the tolerances whatever was tuned: no γ made it the law of γ = ∞."""
    values = {**factory.start(law_kind(contained)), "effort": 0.4, "velocity_weight": 0.05}
    wider = {**CONTAINED, **values, DEGREE: values.get(DEGREE, 2.0)}
    law, same = factory.make(law_kind(contained), values), factory.make(law_kind(family), wider)
    np.testing.assert_allclose(same.gain, law.gain, rtol=1e-9)  # type: ignore[attr-defined]
    if family == NL_HINF:
        np.testing.assert_array_equal(same.law_data, law.law_data)


@pytest.mark.oracle
def test_channels_of_a_size_are_those_of_that_fraction_of_the_tolerances(factory: LawFactory) -> None:
    """hᵀh, R2 and g1 g1ᵀ are linear in the size; the law lies between those without channels and with all."""
    design = factory.synthesis.design_problem
    if design.robustness is None:
        assert CHANNELS not in factory.start(law_kind(NL_HINF))
        return

    def parts(size: float) -> tuple[np.ndarray, ...]:
        problem = sized_channels(design.problem, design.nominal, size)
        h = np.asarray(problem.expand(1).h_parts[1], dtype=float)
        assert problem.equilibrium is not None
        g = problem.plant.linearise(*problem.equilibrium)[2]
        return h.T @ h, np.asarray(problem.r2), g @ g.T

    for none, third, whole in zip(parts(0.0), parts(0.3), parts(1.0), strict=True):
        np.testing.assert_allclose(
            third, 0.7 * none + 0.3 * whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max()
        )
