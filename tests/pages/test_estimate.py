"""What the page of a filtered log says of filters that are right, and wrong in a known way."""

from __future__ import annotations

from typing import Any

import pytest
from tests.logs import noisy_filter, noisy_log
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.pages import FilteredLog, judgement


def filtered(q: float, r: float, offset: float = 0.0, truth: bool = False) -> FilteredLog:
    """A filter with q times R^v and r times R^n on an oscillator whose sensor has an offset."""
    log, filter = noisy_log(4), noisy_filter(q, r)
    log = fh.Log(log.times, log.inputs, log.outputs + offset, log.truth if truth else None)
    data = fh.filter_log(filter, log)
    robot: Any = None  # of which the sentences say nothing
    return FilteredLog(robot, log, filter, data, fh.consistency(data), {})


@pytest.mark.quick_cases(3)
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
