"""Numbers of maps, x⁺ = map(x, u, d, p): as those of the plant in continuous time, and as NumPy's filter says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from tests.builders import runge_kutta
from tests.logs import PERIOD, TRUE, linear_log, oscillator, share
from tests.refusals import refused_with
from tests.tiers import ci_and_night

import flexhinf as fh

TANK = {"keeps": 0.9, "gain": 0.7}


def tank(**values):
    return fh.Plant(
        lambda x, u, d, p: p.keeps * x + p.gain * u + d, lambda x, u, p: x, ("level",), ("inflow",), ("leak",),
        {**TANK, **values}, ("seen",), sampled=True,
    )  # fmt: skip


def tank_log(seed, count=400, noise=0.01, level=0.02):
    rng, x, rows = np.random.default_rng(seed), 0.0, []
    u = rng.normal(size=count)
    for push in u:
        rows.append(x + noise * rng.normal())
        x = TANK["keeps"] * x + TANK["gain"] * push + level * rng.normal()
    return 0.1 * np.arange(count), u[:, None], np.array(rows)[:, None]


def plain_likelihood(log, keeps, gain, noise, level, start):
    x, p, total = start, 1.0, 0.0
    for u, y in zip(log[1][:, 0], log[2][:, 0]):
        spread, e = p + noise**2, y - x
        if np.isfinite(y):
            total -= 0.5 * (e * e / spread + np.log(2.0 * np.pi * spread))
            x, p = x + p / spread * e, p - p * p / spread
        x, p = keeps * x + gain * u, keeps * keeps * p + level**2
    return total


@pytest.mark.oracle
def test_the_numbers_are_those_of_another_optimiser():
    log = tank_log(1)
    log[2][50:53] = np.nan
    found = fh.identify(tank(keeps=0.7, gain=1.0), log, ("keeps", "gain"))
    peer = minimize(
        lambda z: -plain_likelihood(log, *np.exp(z), log[2][0, 0]), np.log([*TANK.values(), 0.01, 0.02]),
        method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000, "maxfev": 4000},
    )  # fmt: skip
    np.testing.assert_allclose(list(found.values.values()), np.exp(peer.x[:2]), rtol=1e-4)
    exact = [*found.values.values(), found.noise["seen"], found.noise["leak"], log[2][0, 0]]
    assert found.log_likelihood == pytest.approx(plain_likelihood(log, *exact), rel=1e-9)
    for name, true in {**{"seen": 0.01, "leak": 0.02}}.items():
        assert found.noise[name] == pytest.approx(true, rel=0.2)


@pytest.mark.ci("fits a log twice")
@pytest.mark.oracle
def test_a_map_that_is_the_plant_s_step_has_the_plant_s_numbers():
    """The oscillator by four Runge–Kutta steps of a period, as the filter integrates it; only R^v comes otherwise."""

    def step(x, u, d, p):
        def rate(x):
            return np.array([x[1], -p.stiffness * x[0] - p.damping * x[1] + p.gain * u[0] + d[0]])

        for _ in range(4):
            x = runge_kutta(rate, x, PERIOD / 4.0)
        return x

    wrong = {"stiffness": 55.0, "damping": 0.5, "gain": 1.0}
    sampled = fh.Plant(
        step, lambda x, u, p: x[:1], ("position", "velocity"), ("force",), ("load",), wrong, ("position",),
        sampled=True,
    )  # fmt: skip
    log = linear_log(9)
    found, peer = (fh.identify(plant, log, tuple(TRUE)) for plant in (sampled, oscillator(**wrong)))
    for name in TRUE:
        assert abs(found.values[name] - peer.values[name]) < 0.2 * peer.standard_errors[name]
        assert found.standard_errors[name] == pytest.approx(peer.standard_errors[name], rel=0.05)
    assert found.noise["load"] * np.sqrt(PERIOD) == pytest.approx(peer.noise["load"], rel=0.05)


@pytest.mark.parametrize("logs", ci_and_night("identifies so many logs", [40], [200]))
def test_intervals_of_a_map_hold_the_truth(logs):
    inside = []
    for seed in range(logs):
        found = fh.identify(tank(keeps=0.7, gain=1.0), tank_log(seed), ("keeps", "gain"))
        inside.append([low <= TANK[name] <= high for name, (low, high) in found.intervals.items()])
    least, most = share(np.size(inside))
    assert least <= np.mean(inside) <= most


def test_the_filter_of_what_was_found_fits_and_a_plant_alone_is_filtered():
    log = tank_log(3)
    found = fh.identify(tank(gain=1.0), log, "gain")
    data = fh.filter_log(found.filter(0.1), log)
    assert data.attrs["log_likelihood"] == pytest.approx(found.log_likelihood, rel=1e-9)
    assert fh.consistency(data).innovations_fit
    assert np.isfinite(fh.filter_log(tank(), log).estimate.values).all()
    with refused_with(fh.InvalidInput, 0.1, 0.2):
        found.filter(0.2)


def test_without_disturbances_the_states_have_them():
    plant = fh.Plant(
        lambda x, u, d, p: p.keeps * x + u, lambda x, u, p: x, ("level",), ("inflow",), parameters={"keeps": 0.8},
        sampled=True,
    )  # fmt: skip
    times, u, y = tank_log(4)
    found = fh.identify(plant, (times, 0.7 * u, y), "keeps")
    assert found.values["keeps"] == pytest.approx(0.9, rel=5e-3)
    assert found.noise["level"] == pytest.approx(0.02, rel=0.2)


def test_times_that_are_no_whole_periods_apart_are_refused():
    times, u, y = tank_log(5, count=40)
    times[20:] += 0.03
    with refused_with(fh.InvalidInput, "map", 0.1):
        fh.identify(tank(), (times, u, y), "gain")
