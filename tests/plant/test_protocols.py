"""A law and an estimator are written with a few methods; the rest follows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.plant import Estimator, Gaussian, Law, Plant
from flexhinf.polynomial.algebra import PolynomialLaw


def integrator() -> Plant:
    return Plant(lambda x, u, d, p: u, lambda x, u, p: x[:1], ("x",), ("u",), outputs=("x",))


class Proportional(Law):
    """The least that is a law: names, an operating point, numbers and a formula."""

    state_names, input_names = ("x", "x_integral"), ("u",)
    operating_point, operating_input = np.zeros(2), np.zeros(1)
    law_data = np.array([2.0, 1.0])

    def evaluate_law(self, x: Any, data: Any) -> Any:
        return np.array([-(data @ x)])


class Copying(Estimator):
    """Believes every measurement."""

    def __init__(self, plant: Plant, period: float) -> None:
        self.plant, self.period = plant, period
        self.process_noise = self.measurement_noise = np.eye(1)
        self.initial = self.initial_at(np.zeros(1))

    def initial_at(self, mean: Any) -> Gaussian:
        return Gaussian(np.asarray(mean, dtype=float), np.eye(1))

    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Gaussian:
        return Gaussian(belief.mean + self.period * u, belief.covariance)

    def measurement_update(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> Gaussian:
        return Gaussian(y + 0.0 * belief.mean, belief.covariance)


def test_the_least_that_is_a_law_and_an_estimator_run_in_a_loop() -> None:
    plant, law = integrator(), Proportional()
    assert (law.plant_states, law.tracked) == (("x",), ("x",))
    assert law.law_table is None
    assert not law.depends_on_reference
    controller = fh.Controller(law, Copying(plant, 1e-2), 1e-2)
    run = fh.Loop(plant, controller).run(1.0, duration=12.0)
    assert run.signal("state", "x")[-1] == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(run.signals["estimate"], run.signals["output"])


def test_what_must_be_written_is_missed_at_once() -> None:
    class Forgetful(Law):
        pass

    with pytest.raises(TypeError, match="evaluate_law"):
        Forgetful()  # type: ignore[abstract]
    with refused_with(fh.InvalidInput, "flexhinf.plant.Law", "object"):
        fh.Controller(object(), None)  # type: ignore[arg-type]


def test_laws_share_code_only_where_they_say_so() -> None:
    """Two instances of a class without a key may differ in more than their data."""

    class Scaled(Proportional):
        def __init__(self, scale: float) -> None:
            self.scale = scale

        def evaluate_law(self, x: Any, data: Any) -> Any:
            return self.scale * super().evaluate_law(x, data)

    one, two = (fh.Controller(Scaled(scale), None) for scale in (1.0, 3.0))
    assert one.law.law_key != two.law.law_key
    np.testing.assert_allclose(two.step(0.5, 0.0), 3.0 * one.step(0.5, 0.0))


def test_a_law_written_anew_keeps_no_other_form_of_the_old_one() -> None:
    class Table(Proportional):
        @property
        def law_table(self) -> PolynomialLaw:
            return PolynomialLaw(2, (1,), -self.law_data[None, :])

        def evaluate_about(self, x: Any, state: Any, input: Any, data: Any) -> Any:
            return np.array([-(data @ x) * (1.0 + state[0])])

    class Anew(Table):
        def evaluate_law(self, x: Any, data: Any) -> Any:
            return np.array([-5.0 * x[0]])

    class Below(Anew):
        pass

    assert Table().depends_on_reference
    assert Table().law_table is not None
    for law in (Anew(), Below()):
        assert law.law_table is None
        assert not law.depends_on_reference
        x = np.array([1.0, 0.0])
        np.testing.assert_array_equal(law.evaluate_about(x, x, x, law.law_data), [-5.0])
