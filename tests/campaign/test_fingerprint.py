"""Functions of a user are told apart by their code and by what it reads, the same in every process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import pytest
from tests.campaign.conftest import OPTIONS, made_loop
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.campaign import run_campaign
from flexhinf.campaign.draws import fingerprint, is_library_code
from flexhinf.errors import InvalidInput

TEXT = """
LIMIT = 2.0
KINDS = {"slow": 1, "fast": 2}

def helper(x):
    return x + 1.0

class Weight:
    def __init__(self, size):
        self.size = size

    def __call__(self, run):
        return self.size * run

def metric(run, scale=3.0):
    "What it says."
    if run in {"a", "b", "c"}:
        return KINDS["slow"]
    return sum(helper(x) * scale for x in run) > LIMIT  # a comment
"""


def written(text: str) -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "campaigns_of_a_user"}
    exec(compile(text, "user.py", "exec"), names)
    return names


def code(text: str = TEXT) -> str:
    return fingerprint(written(text)["metric"])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("> LIMIT", ">= LIMIT"), ("LIMIT = 2.0", "LIMIT = 2.5"), ("x + 1.0", "x - 1.0"), ("x + 1.0", "x + 1.5"),
        ("scale=3.0", "scale=4.0"), ('"slow": 1', '"slow": 3'), ('"c"}', '"d"}'), ("* scale", "/ scale"),
    ],
)  # fmt: skip
def test_what_changes_the_result_changes_the_fingerprint(old: str, new: str) -> None:
    assert code(TEXT.replace(old, new)) != code()


@pytest.mark.parametrize(
    ("old", "new"),
    [("# a comment", "# another"), ("What it says.", "Says it."), ("\n\n", "\n\n\n\n"), ("= 2.0", "= 2.00")],
)
def test_what_does_not_change_the_result_does_not(old: str, new: str) -> None:
    assert code(TEXT.replace(old, new)) == code()


def test_objects_closures_and_parts_of_functions() -> None:
    names = written(TEXT)
    weight = names["Weight"]
    assert fingerprint(weight(2.0)) == fingerprint(weight(2.0)) != fingerprint(weight(3.0))
    other = written(TEXT.replace("self.size * run", "self.size / run"))["Weight"]
    assert fingerprint(other(2.0)) != fingerprint(weight(2.0))

    def closed(size: float) -> Callable[[Any], float]:
        return lambda run: size * run

    assert fingerprint(closed(1.0)) == fingerprint(closed(1.0)) != fingerprint(closed(1.1))
    assert fingerprint(partial(closed, 1.0)) != fingerprint(partial(closed, 2.0))

    def itself(n: int) -> int:
        return n and itself(n - 1)

    assert fingerprint(itself) == fingerprint(itself)
    assert is_library_code(fh.paper_arm().draw)
    assert not is_library_code(itself)


@dataclass
class Own:
    """A metric that remembers what it has computed."""

    size: float

    @cached_property
    def square(self) -> float:
        return self.size**2

    def __call__(self, run: Any) -> float:
        return self.square


def test_what_an_object_has_computed_does_not_matter() -> None:
    fresh, used = Own(2.0), Own(2.0)
    used(None)
    assert fingerprint(fresh) == fingerprint(used) != fingerprint(Own(3.0))


@pytest.mark.ci("starts two processes")
def test_every_process_has_the_same_fingerprint() -> None:
    text = f"""
import sys; sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r})
from tests.campaign.test_fingerprint import code
print(code())
"""
    for seed in ("1", "2"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        found = subprocess.run(
            [sys.executable, "-c", text], env=environment, capture_output=True, text=True, check=True
        )
        assert found.stdout.strip() == code()


def test_a_changed_draw_or_metric_does_not_go_on_with_a_campaign(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")

    text = """
def draw(rng):
    return {"mass": 1.0 + 0.1 * rng.uniform()}

def largest(run):
    return float(abs(run.signals["input"]).max())
"""

    def go(text: str) -> None:
        names = written(text)
        options: dict[str, Any] = {"metrics": {"largest": names["largest"]}, **OPTIONS}
        run_campaign(made_loop(), names["draw"], 8, folder=tmp_path / "runs", **options)

    go(text)
    go(f"# of a user\n{text}")
    with refused_with(InvalidInput, "draw:", "code", "→", "first sample", "mass"):
        go(text.replace("0.1 *", "0.2 *"))
    with refused_with(InvalidInput, "metric largest:", "code", "→"):
        go(text.replace("max()", "min()"))


def test_a_robot_with_another_tolerance_is_another_draw(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    arm = fh.paper_arm()
    wide = arm.with_parameters(replace(arm["mass"], tolerance=20.0))
    law = fh.linear_law(arm.problem(), 1000.0)
    loop = fh.Loop(arm.plant(), fh.Controller(law, None, 1e-3))
    options: dict[str, Any] = {"duration": 0.05, "reference": 0.1, "folder": tmp_path / "runs"}
    run_campaign(loop, arm.draw, 4, **options)
    with refused_with(InvalidInput, "first sample", "mass"):
        run_campaign(loop, wide.draw, 4, **options)
