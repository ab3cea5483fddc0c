"""Arguments of another kind than a function takes: refused before any work, in three parts."""

from collections.abc import Callable
from typing import Any

import pytest

import flexhinf as fh

ARM = fh.paper_arm()
PLANT = ARM.plant()


def filtered(bounds: Any) -> Any:
    return fh.UnscentedKalmanFilter(PLANT, 1e-3, 1e-4, 1e-7, [0.0] * 4, 1e-4, bounds=bounds)


def recorded(instants: Any) -> Any:
    law = fh.linear_law(ARM.problem(), gamma=200.0)
    return fh.Loop(PLANT, fh.Controller(law, None, 1e-3)).ensemble(0.1, duration=0.01, instants=instants)


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda: fh.design("arm.toml", fh.Specification()), "'arm.toml'"),
        (lambda: fh.design(ARM, {"pose": 1.0}), "'pose'"),
        (lambda: fh.compare("paper", fh.Specification()), "'paper'"),
        (lambda: fh.GeneralisedPlant(ARM, ARM.penalty), "paper"),
        (lambda: fh.GeneralisedPlant(PLANT, [1.0, 2.0]), "2.0"),
        (lambda: fh.GeneralisedPlant(PLANT, ARM.penalty, integrate=3), "got 3"),
        (lambda: fh.GeneralisedPlant(PLANT, ARM.penalty, disturbances=0), "got 0"),
        (lambda: ARM[["mass"]], "mass"),
        (lambda: ARM[{}], "{}"),
        (lambda: ARM.with_values([1.0]), "1.0"),
        (lambda: fh.Robot("arm", [1.0]), "got 1.0"),
        (lambda: fh.Robot("arm", "abc"), "'abc'"),
        (lambda: fh.Robot("arm", ARM.parameters, links=3), "got 3"),
        (lambda: fh.Robot("arm", ARM.parameters, drive=["volts"]), "volts"),
        (lambda: fh.Robot("arm", ARM.parameters, rigid=3), "got 3"),
        (lambda: filtered([1.0, 2.0]), "2.0"),
        (lambda: recorded([0.5]), "0.5"),
        (lambda: recorded("first"), "'first'"),
        (lambda: recorded([11]), "11"),
    ],
)
def test_an_argument_of_another_kind_is_refused(call: Callable[[], Any], names: str) -> None:
    with pytest.raises(fh.InvalidInput) as caught:
        call()
    assert names in caught.value.found
    assert caught.value.what.endswith(".")
    assert caught.value.advice


def test_numbers_of_samples_are_taken_as_they_are() -> None:
    assert recorded([0, 10]).instants.tolist() == [0, 10]
    assert recorded(()).instants.tolist() == []
