"""A loop that costs milliseconds: a mass on a spring, its velocity fed back, and what is uncertain about it."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.campaign import Campaign, Journal, Tolerances, Variable, drive
from flexhinf.plant import Law

OPTIONS = {"duration": 0.4, "noise": 1e-3, "reference": 0.1}


class Feedback(Law):
    """u = −K x of position, velocity and the integral of the position's error."""

    law_key = "campaign-feedback"
    state_names, input_names = ("position", "velocity", "position_integral"), ("force",)
    operating_point, operating_input = np.zeros(3), np.zeros(1)

    def __init__(self, gain=(60.0, 12.0, 100.0)):
        self.gain = np.array(gain)

    @property
    def law_data(self):
        return self.gain

    def evaluate_law(self, x, data):
        return np.array([-(data[0] * x[0] + data[1] * x[1] + data[2] * x[2])])


class Deadly:
    """A metric of which the first call kills its process: SIGKILL, once."""

    def __init__(self, mark):
        self.mark = mark

    def __call__(self, run):
        if not self.mark.exists():
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return float(abs(run.signals["input"]).max())


def flow(x, u, d, p):
    return np.array([x[1], (u[0] + d[0] - p.stiffness * x[0]) / p.mass])


def output(x, u, p):
    return np.array([x[0]])


def spring():
    return fh.Plant(
        flow, output, states=("position", "velocity"), inputs=("force",), disturbances=("push",),
        parameters={"mass": 1.0, "stiffness": 20.0},
    )  # fmt: skip


def made_loop(gain=(60.0, 12.0, 100.0)):
    plant = spring()
    filter = fh.ExtendedKalmanFilter(plant, 4e-3, 1e-6, 1e-6, np.zeros(2), 1e-4)
    return fh.Loop(plant, fh.Controller(Feedback(gain), filter, 4e-3), sub_steps=1)


def tolerances(method="random", distribution="uniform"):
    variables = [
        Variable("mass", 0.8, 1.2, distribution, "kg"),
        Variable("stiffness", 15.0, 25.0, distribution),
    ]
    return Tolerances(variables, method)


def made_campaign(samples=50, batch=16, seed=1, **changes):
    given = {"draw": tolerances(), "options": OPTIONS, **changes}
    return Campaign(made_loop(), samples=samples, batch=batch, seed=seed, **given)


@pytest.fixture(autouse=True)
def lanes(monkeypatch):
    """Also these few samples run in lanes; in fixtures of modules each is run alone."""
    monkeypatch.setenv("FLEXHINF_LANES_FROM", "0")


@pytest.fixture(scope="session")
def loop():
    return made_loop()


@pytest.fixture
def campaign():
    return made_campaign()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of a campaign that nobody interrupted."""
    folder, campaign = tmp_path_factory.mktemp("whole") / "campaign", made_campaign()
    drive(campaign, Journal.opened(folder, campaign))
    return folder
