"""What is advised where no bandwidth keeps the limits of the joints."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.cli.messages import error_text
from flexhinf.designs.synthesis import by_step


class NoBandwidth:
    """A search in which every step takes twice the limit."""

    def __init__(self, *_: Any) -> None:
        self.limits = np.array([[10.0], [np.inf]])

    def peaks(self, _: Any) -> np.ndarray:
        return np.array([[20.0], [1.0]])

    def shares(self, peaks: np.ndarray) -> np.ndarray:
        return peaks / self.limits

    def slower(self, *_: Any) -> tuple[()]:
        return ()

    def confirmed(self, *_: Any) -> tuple[None, None]:
        return None, None


@pytest.mark.parametrize(
    ("fields", "shaped"), [({}, True), ({"shaping": "quintic"}, False), ({"bandwidth": 3.0}, False)]
)
def test_a_shaped_command_is_advised_where_no_bandwidth_is_stated(
    fields: dict[str, Any], shaped: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(by_step, "_BandwidthSearch", NoBandwidth)
    s = fh.Specification(pose=(1.0,), start=(0.0,), peak_effort=10.0, **fields)
    task: Any = SimpleNamespace(robot=fh.paper_arm(), s=s, progress=lambda _: None)
    problem: Any = SimpleNamespace(target=SimpleNamespace(bandwidth=np.array([5.0])))
    with refused_with(fh.InvalidInput, "start") as refused:
        by_step.problem_within_effort(task, problem, None)
    assert ("--set shaping=quintic" in error_text(refused.value)) == shaped
