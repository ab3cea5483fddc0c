"""What the page of a filtered log says of filters that are right, and wrong in a known way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.pages import FilteredLog, judgement

PERIOD, COUNT = 0.01, 2000
Q, R = np.diag([1e-6, 1e-3]), 1e-4


def filtered(q: float, r: float, offset: float = 0.0, truth: bool = False) -> FilteredLog:
    """A filter with q times R^v and r times R^n on an oscillator whose sensor has an offset."""
    from scipy.linalg import expm

    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], -40.0 * x[0] - 0.3 * x[1] + u[0]]),
        lambda x, u, p: x[:1], ("position", "velocity"), ("force",), outputs=("position",),
    )  # fmt: skip
    rng, step = np.random.default_rng(4), expm(PERIOD * np.array([[0.0, 1.0], [-40.0, -0.3]]))
    x, states = np.array([0.1, 0.0]), []
    for _ in range(COUNT):
        states.append(x)
        x = step @ x + rng.multivariate_normal(np.zeros(2), Q)
    y = np.array(states)[:, 0] + offset + np.sqrt(R) * rng.normal(size=COUNT)
    log = fh.Log(PERIOD * np.arange(COUNT), np.zeros(COUNT), y, np.array(states) if truth else None)
    filter = fh.ExtendedKalmanFilter(plant, PERIOD, q * Q, r * R, [0.1, 0.0], 1e-8, form="square_root")
    data = fh.filter_log(filter, log)
    robot: Any = None  # of which the sentences say nothing
    return FilteredLog(robot, log, filter, data, fh.consistency(data), {})


@pytest.mark.parametrize(
    ("q", "r", "offset", "fits", "anchors", "absent"),
    [
        (1.0, 1.0, 0.0, True, ("white", 1.0), ("alternate", "follow", "offset")),
        (1 / 25, 1 / 25, 0.0, False, ("larger", "white", "too small", 25.0), ("alternate", "follow")),
        (25.0, 25.0, 0.0, False, ("smaller", "white", "too large", 25.0), ("alternate", "follow")),
        (1e-3, 1.0, 0.0, False, ("larger", "follow", "model", "latency"), ("alternate", "white")),
        (1e4, 1.0, 0.0, False, ("smaller", "alternate", "too large"), ("follow", "white")),
        (1.0, 1.0, 0.05, False, ("position", "offset"), ("alternate",)),
    ],
)  # fmt: skip
def test_what_innovations_say(
    q: float, r: float, offset: float, fits: bool, anchors: tuple[Any, ...], absent: tuple[str, ...]
) -> None:
    judged, texts = judgement(filtered(q, r, offset))
    text = " ".join(texts)
    assert judged == fits
    assert unnamed(text, *anchors) == [], text
    assert unnamed(text, *absent) == list(absent), text


def test_errors_beside_the_truth_are_told() -> None:
    fits, texts = judgement(filtered(1.0, 1.0, truth=True))
    assert fits
    assert unnamed(" ".join(texts), "NEES") == []
    fits, texts = judgement(filtered(1e-3, 1.0, truth=True))
    assert not fits
    assert unnamed(" ".join(texts), "NEES", "larger") == []
