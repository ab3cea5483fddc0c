"""What no caller should pass, to every kind of argument: refused by name, or taken for exactly what it is."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.files import write_file


def plant(flow: Any = None, **others: Any) -> fh.Plant:
    """ẋ = (x2, −sin x1 + u), of which x1 is measured."""
    return fh.Plant(
        flow or (lambda x, u, d, p: np.array([x[1], -np.sin(x[0]) + u[0]])),
        lambda x, u, p: np.array([x[0]]),
        ("x1", "x2"),
        ("u1",),
        **others,
    )


ITSELF: list[Any] = [0.1]
ITSELF.append(ITSELF)


class Foreign:
    """An object that cannot be asked for numbers, nor printed."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("no numbers")

    def __repr__(self) -> str:
        raise RuntimeError("no text")


STRANGE = (
    ITSELF, Foreign(), [Foreign(), 0.0], None, "0.1", b"0.1", 10**5000, {0: 1.0}, {0.1}, (v for v in "ab"),
    np.ma.masked, np.zeros((2, 2, 2)), 1j, [[0.1], [0.1, 0.2]], math.nan, object(), np.array(["2020"], "M8[Y]"),
)  # fmt: skip


def estimator(kind: Any = fh.UnscentedKalmanFilter, **changed: Any) -> Any:
    settings: dict[str, Any] = {"period": 1e-2, "process_noise": 1e-6, "measurement_noise": 1e-4}
    settings |= {"mean": np.zeros(2), "covariance": 1e-2, **changed}
    return kind(plant(), **settings)


def mapping(key: Any, value: Any) -> Any:
    return {key: value}


def pair(one: Any, other: Any) -> Any:
    return [one, other]


TAKERS: dict[str, Callable[[Any], Any]] = {
    "period": lambda value: estimator(period=value),
    "period of the extended filter": lambda value: estimator(fh.ExtendedKalmanFilter, period=value),
    "alpha": lambda value: estimator(alpha=value),
    "kappa": lambda value: estimator(kappa=value),
    "beta": lambda value: estimator(beta=value),
    "mean": lambda value: estimator(mean=value),
    "measurement": lambda value: estimator().correct(value),
    "input": lambda value: estimator().predict(value),
    "point": lambda value: plant().derivative([0.0, 0.0], [value]),
    "parameter": lambda value: fh.Parameter("mass", value),
    "integrals": lambda value: plant().with_objective([1.0, 1.0], integrate=value),
    "sensors": lambda value: fh.paper_arm().plant(measured=value),
    "weights": lambda value: plant().with_objective(value),
    "weights by name": lambda value: plant().with_objective(mapping(3, value)),
    "bandwidth": lambda value: fh.Specification(bandwidth=pair(value, [value])),
}


@pytest.mark.parametrize("taker", list(TAKERS))
@pytest.mark.parametrize("value", STRANGE, ids=lambda value: type(value).__name__)
def test_what_is_no_number_or_name_is_refused_by_a_typed_error(taker: str, value: Any) -> None:
    if taker == "measurement" and (value is None or value is np.ma.masked or value is math.nan):
        TAKERS[taker](value)  # a missing element
        return
    with pytest.raises(InvalidInput) as caught:
        TAKERS[taker](value)
    assert len(str(caught.value)) < 1500


@pytest.mark.parametrize("x", [[0.1, math.inf], [-math.inf, 0.0]])
def test_a_derivative_at_infinity_is_refused(x: list[float]) -> None:
    with pytest.raises(InvalidInput, match="finite"):
        plant().derivative(x)


def test_a_spline_of_huge_values_is_refused_where_it_gave_nan() -> None:
    with pytest.raises(InvalidInput, match="proportion"):
        fh.Spline([0.0, 1.0], [1e308, -1e308])


def test_code_that_writes_into_its_arguments_is_traced_as_it_is_meant() -> None:
    """Exchanged in place, the states were exchanged for every caller as well, without a word."""

    def writing(x: Any, u: Any, d: Any, p: Any) -> Any:
        x[0], x[1] = x[1], x[0]
        return np.array([x[0], -np.sin(x[1]) + u[0]])

    point = np.array([0.3, -0.7])
    assert np.array_equal(plant(writing).derivative(point, [0.2]), plant().derivative(point, [0.2]))
    assert point.tolist() == [0.3, -0.7]


@pytest.mark.parametrize("result", [["1.0", "2.0"], [1j, 0.0], [np.ma.masked, 0.0], ["a", "b"]])
def test_code_that_returns_text_or_complex_numbers_is_refused(result: list[Any]) -> None:
    with pytest.raises(InvalidInput):
        plant(lambda x, u, d, p: result)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_pipe_or_a_device_is_never_replaced_by_a_file(tmp_path: Path) -> None:
    """A user who may do everything made /dev/null a file of 3 kB, for everybody."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InvalidInput, match="solution"):
        write_file(tmp_path / "pipe", "solution", lambda name: Path(name).write_text("text"))
    assert [path.is_fifo() for path in tmp_path.iterdir()] == [True]
