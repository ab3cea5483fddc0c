"""One comparison of all kinds of laws on a small robot, made once; and how to make others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

import flexhinf as fh
from flexhinf.design import Specification
from flexhinf.design.compare import Comparison, compare

LAWS = ("hinf", "nlqr", "lqr-gravity", "lqg", "pd", "pid", "torque", "flatness")


@pytest.fixture(scope="session")
def asked() -> Callable[..., Specification]:
    """A specification that is quick to answer: no regions, a cubic law, an extended Kalman filter, a short run."""

    def specification(**options: Any) -> Specification:
        quick = {"pose": (0.8,), "start": (0.3,), "degrees": (4,), "rays": 0, "estimator": "ekf", "draws": 3}
        return Specification(**{**quick, "duration": 1.5, **options})

    return specification


@pytest.fixture(scope="session")
def made(asked: Callable[..., Specification]) -> Callable[..., Comparison]:
    """A comparison on the vertical rig: names of laws, the way to tune, options of the specification."""

    def make(
        laws: Sequence[str], tune: str = "peak", robot: str = "vertical-rig", **options: Any
    ) -> Comparison:
        return compare(fh.load_robot(robot), asked(**options), laws, tune)

    return make


@pytest.fixture(scope="session")
def rig(made: Callable[..., Comparison]) -> Comparison:
    """All kinds of laws on the rig; nothing may change it."""
    return made(LAWS)
