import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.loop import BlackBox, Controller, Loop, Sine, Step
from flexhinf.plant import rk4_step
from flexhinf.robot import paper_arm

# Kernels that run once each: 1 s instead of 2 s.
pytestmark = pytest.mark.usefixtures("unoptimised")


class Box(BlackBox):
    """The arm as a thing that integrates itself; what it shows of itself varies."""

    def __init__(self, plant, parts):
        self.plant, self.parts = plant, parts

    def reset(self, initial_state):
        self.x = np.zeros(self.plant.n) if initial_state is None else np.array(initial_state)

    def step(self, u, disturbance, period):
        for _ in range(self.parts):
            d = disturbance if len(disturbance) else None
            flow = lambda x, v: self.plant.derivative(x, u, d)  # noqa: E731, B023
            self.x = rk4_step(flow, self.x, (None,) * 3, period / self.parts)

    def output(self):
        return self.x[:1]


class OpenBox(Box):
    states = property(lambda self: self.plant.states)
    disturbances = property(lambda self: self.plant.disturbances)
    units = property(lambda self: self.plant.units)

    def state(self):
        return self.x


@pytest.fixture
def loops(made):
    plant, controller = paper_arm().plant(), Controller(made.law, made.ukf(), saturation=14.0)
    loop = Loop(plant, controller)
    return loop, lambda kind=OpenBox: Loop(kind(plant, loop.sub_steps), controller)


@pytest.mark.oracle
def test_our_plant_as_a_black_box_runs_the_same(loops):
    loop, boxed = loops
    settings = {
        "reference": Sine(0.5, 0.4, offset=0.2), "disturbance": {"link_torque": Step(2.0, at=0.15)}, "noise": 1e-3,
        "duration": 0.4, "initial_state": {"link_position": 0.1, "motor_position": 0.1}, "seed": 4,
    }  # fmt: skip
    one, two = loop.run(**settings), boxed().run(**settings)
    assert set(one.signals) == set(two.signals)
    for name, values in one.signals.items():
        np.testing.assert_allclose(two.signals[name], values, atol=1e-12, err_msg=name)
    assert one.names == two.names
    assert one.units == two.units


def test_a_closed_box_is_judged_by_its_measurement(loops):
    _, boxed = loops
    run = boxed(Box).run(1.0, duration=0.2)
    assert "state" not in run.signals
    np.testing.assert_array_equal(run.tracked("link_position"), run.signals["output"][:, 0])
    metrics = run.metrics()
    assert metrics["estimation_rmse"] == []
    assert metrics["peak_input"] == np.abs(run.signals["input"]).max() > 5.0
    assert run.units["estimate"][0] == "rad"
    assert "state" not in run.data
    assert run.plot().axes


def test_the_controller_is_not_touched(loops):
    loop, boxed = loops
    first = loop.controller.step(0.2, 1.0)
    boxed().run(1.0, duration=0.05)
    second = loop.controller.step(0.3, 1.0)
    loop.controller.reset()
    np.testing.assert_array_equal(loop.controller.step(0.2, 1.0), first)
    np.testing.assert_array_equal(loop.controller.step(0.3, 1.0), second)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(
    ("kind", "value"), [(OpenBox, np.inf), (OpenBox, None), (Box, np.nan), (Box, np.inf)]
)
def test_a_box_that_breaks_is_told(loops, kind, value):
    class Breaking(kind):
        def output(self):
            return self.x[:1] if self.x[0] < 0.05 else np.array([value])

    class Lost(kind):
        def state(self):
            return self.x if self.x[0] < 0.05 else self.x * np.nan

    _, boxed = loops
    run = boxed(Lost if value is None else Breaking).run(1.0, duration=2.0)
    assert run.status == "diverged"
    assert "plant" in run.message
    assert len(run.time) > 10
    assert not np.isfinite(
        [run.signals["output"][-1, 0], *run.signals.get("state", np.zeros((1, 1)))[-1]]
    ).all()


def test_a_box_whose_sensor_gives_nothing_for_a_while_goes_on(loops):
    class Blind(OpenBox):
        def output(self):
            return self.x[:1] if not 0.02 < self.x[0] < 0.1 else np.array([np.nan])

    loop, boxed = loops
    run = boxed(Blind).run(1.0, duration=0.5)
    lost = np.isnan(run.signals["output"][:, 0])
    assert run.status == "completed"
    assert 5 < lost.sum() < 200
    stepped = loop.controller.fresh()
    for y, u in zip(run.signals["output"], run.signals["input"], strict=True):
        np.testing.assert_array_equal(stepped.step(None if np.isnan(y[0]) else y, 1.0), u)


def test_a_box_that_does_not_fit_is_refused(loops):
    class Wide(Box):
        def output(self):
            return self.x[:2]

    _, boxed = loops
    with refused_with(InvalidInput, "['link_position']", "(2,)"):
        boxed(Wide).run(1.0, duration=0.1)
    with pytest.raises(InvalidInput):
        boxed(Box).run(1.0, disturbance={"link_torque": 1.0}, duration=0.1)
    with pytest.raises(InvalidInput):
        boxed().run(1.0, initial_state={"speed": 1.0}, duration=0.1)
    assert isinstance(Box(None, 1), BlackBox)
    assert not isinstance(object(), BlackBox)
