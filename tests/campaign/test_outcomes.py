"""How a run ends is told: it oscillates without end, or runs away, or it is only slow; and when nothing can be said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.campaign.conftest import Feedback, made_loop, spring, tolerances

import flexhinf as fh
from flexhinf.campaign import STANDARD, Campaign, run_batch, run_campaign
from flexhinf.campaign.metrics import is_unstable
from flexhinf.campaign.results import violations
from flexhinf.loop import Trajectory

T = np.arange(3000) * 1e-3


def trajectory(position, reference=1.0, disturbance=0.0):
    signals = {
        "state": position[:, None], "reference": np.broadcast_to(reference, len(T))[:, None],
        "disturbance": np.broadcast_to(disturbance, len(T))[:, None],
    }  # fmt: skip
    names = dict.fromkeys(signals, ("angle",))
    return Trajectory(T, signals, names, names, {}, ("angle",))


def wave(period, decay=0.0):
    return np.exp(-decay * T) * np.cos(2.0 * np.pi * T / period)


#: Positions that a step from 0 to 1 (the first value counts) may have, 3 s long.
ENDLESS = {
    "swings": 1.0 - wave(0.3),
    "swings a little": 1.0 - np.exp(-8.0 * T) - 0.021 * (1.0 - np.exp(-8.0 * T)) * wave(0.07),
    "swings slowly": 1.0 - wave(0.99),
    "grows": 1.0 - wave(0.2, -1.0),
    "grows fast": 1.0 - 1e-3 * wave(0.1, -4.0) - np.exp(-9.0 * T),
    "almost not damped": 1.0 - wave(0.25, 0.05),
    "runs away": np.maximum(0.0, T - 1.1) ** 2 + 1.0 - np.exp(-30.0 * T),
    "turns and turns": 6.0 * T,
    "falls through the command": 1.0 - np.exp(-9.0 * T) - 1e-4 * np.exp(3.4 * T),
    "a saw": 1.0 - np.exp(-9.0 * T) + 0.2 * (T / 0.21 % 1.0),
}
QUIET = {
    "rests": 1.0 - np.exp(-6.0 * T),
    "slow": 1.0 - np.exp(-0.1 * T),
    "hardly moves": 1.0 - np.exp(-1e-3 * T),
    "stuck": 0.3 * (1.0 - np.exp(-6.0 * T)),
    "damped": 1.0 - wave(0.25, 0.5),
    "swings within the band": 1.0 - np.exp(-8.0 * T) - 0.0199 * (1.0 - np.exp(-8.0 * T)) * wave(0.07),
    "rings": 1.0 - wave(0.1, 3.0),
    "begins late": np.where(T < 0.9, 0.0, 1.0 - np.exp(-20.0 * (T - 0.9))),
    "overshoots at its end": np.clip(T / 2.4, 0.0, 1.3),
    "goes on evenly": np.where(T < 2.9, T / 2.9, 1.0),
}


@pytest.mark.parametrize("scale", [1.0, -1e-3, 1e4])
@pytest.mark.parametrize("name", [*ENDLESS, *QUIET])
def test_what_is_unstable_by_its_definition(name, scale):
    position = (ENDLESS | QUIET)[name] - (ENDLESS | QUIET)[name][0]
    run = trajectory(scale * position, scale * (1.0 - (ENDLESS | QUIET)[name][0]))
    assert is_unstable(run) == (name in ENDLESS)


@pytest.mark.parametrize(("step", "unstable"), [(0.06, True), (0.04, False), (0.0, False)])
def test_ripple_of_a_joint_that_hardly_moves_is_not_instability(step, unstable):
    """It swings by 0.01 beside a joint that makes a step of 1: the band of a step of 5 % of that is 0.002."""
    positions = np.column_stack([QUIET["rests"], step * QUIET["rests"] + 0.005 * wave(0.07)])
    joints = ("shoulder", "elbow")
    signals = {
        "state": positions, "reference": np.broadcast_to([1.0, positions[0, 1] + step], (len(T), 2)),
        "disturbance": np.zeros((len(T), 1)),
    }  # fmt: skip
    names = {"state": joints, "reference": joints, "disturbance": ("push",)}
    assert is_unstable(Trajectory(T, signals, names, names, {}, joints)) == unstable


def test_nothing_is_said_where_the_motion_is_asked_for():
    swings, sine = ENDLESS["swings"], np.sin(20.0 * T)
    assert not is_unstable(trajectory(swings, reference=1.0 + 0.01 * sine))
    assert not is_unstable(trajectory(swings, disturbance=sine))
    assert not is_unstable(trajectory(swings, reference=np.where(T < 2.8, 0.5, 1.0)))
    assert is_unstable(trajectory(swings, reference=np.where(T < 0.5, 0.5, 1.0)))
    assert is_unstable(trajectory(swings, disturbance=np.where(T < 0.3, 0.0, 1.0)))
    assert not is_unstable(trajectory(1e-6 * sine, reference=0.0))  # no step of which 2 % could be meant
    shifted = np.where(T < 2.0, QUIET["rests"], 1.0 - 0.3 * np.exp(-6.0 * (T - 2.0)))
    assert not is_unstable(trajectory(shifted, disturbance=np.where(T < 2.0, 0.0, 1.0)))


def limited(gain, limit):
    plant = spring()
    filter = fh.ExtendedKalmanFilter(plant, 4e-3, 1e-6, 1e-6, np.zeros(2), 1e-4)
    return fh.Loop(plant, fh.Controller(Feedback(gain), filter, 4e-3, limit), sub_steps=1)


#: Loops that oscillate without end: negative damping and a limited input; integral action that is too fast.
OSCILLATING = {"limited": limited((60.0, -6.0, 300.0), 4.0), "growing": made_loop((60.0, 12.0, 3000.0))}


@pytest.mark.parametrize("name", OSCILLATING)
@pytest.mark.parametrize("duration", [2.0, 4.0])
def test_robots_that_oscillate_without_end_are_unstable_and_not_diverged(name, duration):
    found = run_campaign(OSCILLATING[name], tolerances(), 24, seed=2, reference=0.1, duration=duration)
    assert set(found.status.values) == {"unstable"}
    assert np.isnan(found.diverged_at_s.values).all()
    assert np.isinf(found.settling_time_s.values).all()
    assert np.isfinite(found.overshoot_percent.values).all()
    assert violations({name: found[name].values for name in ("status",)}, []).shape == (24, 0)


def test_lanes_say_what_each_run_alone_says():
    """Some of these loops are stable, others not; noise, a disturbance that comes, and a command that changes.
    Where the motion begins at its goal there is no step of which 2 % could be meant."""
    options = {
        "reference": fh.Step(0.1, at=0.2), "disturbance": {"push": fh.Step(0.5, at=0.4)}, "noise": 1e-4,
        "duration": 2.0,
    }  # fmt: skip
    at_its_goal = options | {"reference": 0.1, "initial_state": [0.1, 0.0]}
    wide = replace(tolerances(), variables=[replace(v, low=0.2 * v.low) for v in tolerances().variables])
    for asked, outcomes in ((options, {"completed", "unstable"}), (at_its_goal, {"completed"})):
        found = []
        for metrics in (None, replace(STANDARD, reduced=None)):
            campaign = Campaign(made_loop((60.0, 12.0, 700.0)), wide, 40, 1, asked, metrics, batch=40)
            found.append(run_batch(campaign, 0)["status"].tolist())
        assert found[0] == found[1]
        assert set(found[0]) == outcomes, found[0]


def test_a_command_or_a_disturbance_that_goes_on_is_no_oscillation(loop):
    sine = fh.Sine(0.1, 3.0)
    for options in ({"reference": sine}, {"reference": 0.1, "disturbance": {"push": fh.Sine(20.0, 3.0)}}):
        found = run_campaign(loop, tolerances(), 10, seed=1, duration=3.0, **options)
        assert set(found.status.values) == {"completed"}
