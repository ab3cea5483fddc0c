"""What is left of a log that a model does not fit: causes that the true robot has, and the word of a simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from tests.logs import arm_log, oscillator, recorded, undisturbed
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.identification.explanations import HYSTERESIS, Explanation, believed, explanations
from flexhinf.scalars import absolute

pytestmark = pytest.mark.usefixtures("unoptimised")

COSTLY = pytest.mark.nightly("identifies one more arm")
MEASURED, NAMES, PERIOD = ("link_position", "motor_position"), ("stiffness", "friction"), 2e-3
TIMES = PERIOD * np.arange(1500)
VOLTS = 8.0 * (np.sin(3.0 * TIMES) + 0.6 * np.sin(11.0 * TIMES) + 0.4 * np.sin(23.0 * TIMES))


def slipping(plant: fh.Plant, size: float, within: float) -> fh.Plant:
    """A plant whose spring keeps a torque on its way back, by Dahl's equation, within a twist."""

    def flow(x: Any, u: Any, d: Any, p: Any) -> Any:
        rate, torque = x[3] - x[1], size * x[4]
        moved = plant.flow(x[:4], u, np.array([d[0] + torque, d[1] - torque]), p)
        return np.append(moved, (rate - absolute(rate) * x[4]) / within)

    return fh.Plant(
        flow,
        lambda x, u, p: plant.output(x[:4], u, p),
        (*plant.states, "carried"),
        plant.inputs,
        plant.disturbances,
        dict(plant.parameters.values),
        plant.outputs,
    )


def explained(plant: fh.Plant, volts: np.ndarray, guess: fh.Robot) -> tuple[fh.Identification, Any]:
    t, u, y = recorded(plant, volts, PERIOD)
    log = fh.Log(t, u, y, names={"output": MEASURED})
    found = fh.identify(guess, log, NAMES, measured=MEASURED)
    return found, explanations(found, log)


@pytest.mark.ci("identifies logs of four arms")
@pytest.mark.parametrize(
    ("quantity", "value", "unit", "extra", "kind"),
    [
        ("coulomb_friction", 1.6, "N·m", "coulomb_friction", "dry friction"),
        ("backlash", 0.02, "rad", "backlash", "backlash"),
        pytest.param(
            "spring_hardening", 2000.0, "N·m/rad³", "spring_hardening", "a spring that hardens", marks=COSTLY
        ),
        pytest.param("damping", 0.5, "N·m·s/rad", "joint_damping", "damping of the spring", marks=COSTLY),
    ],
)
def test_what_the_true_arm_has_is_named_with_its_size(
    quantity: str, value: float, unit: str, extra: str, kind: str
) -> None:
    """Its first cause; within 15 % of the truth, as the trace is linear; and no delay is blamed."""
    arm = fh.load_robot("paper")
    true = arm.with_parameters(fh.Parameter(quantity, value, unit=unit))
    found, causes = explained(true.plant(MEASURED, extras=extra), VOLTS, arm.with_values({"stiffness": 80.0}))
    assert not found.consistent
    assert (causes[0].kind, causes[0].quantity) == (kind, quantity)
    assert causes[0].size == pytest.approx(value, rel=0.15)
    assert causes[0].share > 0.7
    assert believed(found, causes) is None


@pytest.mark.ci("identifies logs of two rigs with teeth in their gears")
@pytest.mark.parametrize(("quantity", "size"), [("torque_ripple", 0.01), ("kinematic_error", 2e-3)])
def test_teeth_of_a_gear_are_found_with_the_lines_of_a_file(quantity: str, size: float) -> None:
    """At twice the turn of the motor of a rig with a gear of 70, with the phase that the true plant has."""
    rig, phase = fh.load_robot("quanser-rotflex"), 0.8
    true = rig.with_parameters(fh.Parameter(quantity, size), fh.Parameter(f"{quantity}_phase", phase))
    found, causes = explained(true.plant(MEASURED, extras=quantity), 0.1 * VOLTS, rig)
    assert not found.consistent
    assert causes[0].quantity == quantity
    assert causes[0].size == pytest.approx(size, abs=2.0 * max(causes[0].errors))
    stated = dict(line.split(" = ") for line in causes[0].lines.split(", "))
    assert float(stated[quantity]) == pytest.approx(size, rel=0.1)
    assert float(stated[f"{quantity}_phase"]) == pytest.approx(phase, abs=0.1)


@pytest.mark.ci("identifies a log of a rig whose spring slips")
def test_hysteresis_of_a_spring_is_found() -> None:
    """By another equation than that of the trace; the size is rough, and no line of a file states it."""
    rig = fh.load_robot("quanser-rotflex")
    _, causes = explained(slipping(rig.plant(MEASURED), 0.01, 5e-3), 0.1 * VOLTS, rig)
    assert (causes[0].kind, causes[0].lines) == (HYSTERESIS, "")
    assert causes[0].size == pytest.approx(0.01, rel=0.3)


@pytest.mark.ci("identifies a log of an arm")
def test_nothing_explains_what_fits_and_a_delay_is_left_to_the_likelier_log() -> None:
    arm = fh.load_robot("paper")
    found, causes = explained(arm.plant(MEASURED), VOLTS, arm)
    assert found.consistent
    assert causes == ()
    t, u, y = recorded(arm.plant(MEASURED), VOLTS, PERIOD)
    log = fh.Log(t, np.append(u[1:], u[-1:], axis=0), y, names={"output": MEASURED})
    late = fh.identify(arm, log, NAMES, measured=MEASURED)
    (first, *_) = explanations(late, log)
    assert (first.kind, first.signal) == ("a delay", "motor_voltage")
    assert first.size == pytest.approx(1.0, rel=0.1)
    assert believed(late, (first,)) is late.alternative is not None


def test_a_cause_says_where_it_is_and_how_much() -> None:
    cause = Explanation("dry friction", "motor_torque_elbow", (1.234,), (0.056,), "N·m", 40.0, 0.8)
    assert unnamed(cause.text, "dry friction", "elbow", 1.23, 0.056, "N·m", 80) == []
    wave = Explanation("ripple", "motor_position", (3.0, 4.0), (0.1, 0.2), "N·m", 40.0, 0.8)
    assert wave.size == 5.0
    assert unnamed(wave.place, "motor position") == []


@pytest.mark.oracle
@pytest.mark.ci("fits an oscillator twice")
def test_the_simulation_finds_what_least_squares_finds() -> None:
    """SciPy's least squares of the outputs of the exact map of an oscillator, from a first state that is sought too."""
    from scipy.linalg import expm

    plant, rng, period = undisturbed(), np.random.default_rng(4), 0.01
    u = np.sign(np.sin(3.0 * period * np.arange(500)))

    def simulated(stiffness: float, first: np.ndarray) -> np.ndarray:
        drift = np.array([[0.0, 1.0, 0.0], [-stiffness, -0.3, 1.0], [0.0, 0.0, 0.0]])
        whole = expm(period * drift)
        x, rows = np.asarray(first, dtype=float), []
        for force in u:
            rows.append(x[0])
            x = (whole @ np.append(x, force))[:2]
        return np.array(rows)

    y = simulated(38.0, np.array([0.1, -0.2])) + 1e-2 * rng.normal(size=500)
    log = fh.Log(period * np.arange(500), u, y)
    second = fh.output_error(fh.identify(plant, log, "stiffness"), log)
    assert second is not None
    fit = least_squares(lambda z: simulated(z[0], z[1:]) - y, [40.0, 0.0, 0.0], x_scale=[40.0, 0.1, 1.0])
    error = np.sqrt(np.linalg.inv(fit.jac.T @ fit.jac)[0, 0]) * 1e-2
    assert second.values["stiffness"] == pytest.approx(fit.x[0], abs=0.05 * error)
    assert second.first == pytest.approx(fit.x[1:], abs=1e-4)
    assert second.errors["position"] == pytest.approx(np.sqrt(np.mean(fit.fun**2)), rel=1e-3)
    assert 0.7 * error < second.standard_errors["stiffness"] < 3.0 * error
    assert second.differing == ()


@pytest.mark.ci("identifies a log of an arm with dry friction")
def test_the_simulation_contradicts_numbers_that_absorb_what_is_missing() -> None:
    """It has all that the arm lacks in its errors, and says how little of the motion it has."""
    arm = fh.load_robot("paper")
    right = arm_log(arm, count=1000, measured=MEASURED)
    found = fh.identify(arm, right, NAMES, measured=MEASURED)
    fine = fh.output_error(found, right)
    assert fine is not None
    assert fine.differing == ()
    assert min(fine.fits.values()) > 0.99
    true = arm.with_parameters(fh.Parameter("coulomb_friction", 1.6, unit="N·m"))
    t, u, y = recorded(true.plant(MEASURED, extras="coulomb_friction"), VOLTS, PERIOD)
    poor = fh.output_error(fh.identify(arm, (t, u, y), NAMES, measured=MEASURED), (t, u, y))
    assert poor is not None
    assert min(poor.fits.values()) < 0.99


def test_a_plant_that_is_no_robot_has_no_causes() -> None:
    times = 0.01 * np.arange(300)
    log = fh.Log(times, np.sin(times), 0.1 * np.sin(times) ** 3)
    assert explanations(fh.identify(oscillator(), log, "stiffness"), log) == ()
