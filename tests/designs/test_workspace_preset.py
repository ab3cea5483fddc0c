"""The law that the preset `proved` finds for a workspace: another γ is tried before a slower law."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.workspaces import few

import flexhinf as fh
from flexhinf.designs.request import checked_specification
from flexhinf.designs.task import Task
from flexhinf.designs.workspace import preset, search
from flexhinf.designs.workspace.preset import selected_law
from flexhinf.errors import NumericalFailure
from flexhinf.modal.pair import PairWeights
from flexhinf.pages.campaign_text import proof_text
from flexhinf.robot.workspace import workspace_of

USUAL = search.GAMMA

#: Of how many times the file's errors each law tolerates, by bandwidth and γ/γ*; none of it without a law.
SHARES = {
    (28.0, USUAL): 1.05, (28.0, 2.0): 1.6, (28.0, 4.0): 1.3,
    (20.0, USUAL): 1.4, (20.0, 1.2): 9.0, (20.0, 2.0): 1.45, (20.0, 4.0): 1.9,
    (14.0, USUAL): 1.2,
}  # fmt: skip


@dataclass(frozen=True)
class Law:
    weights: PairWeights


@dataclass(frozen=True)
class Tried:
    """What the search reads of a setup."""

    law: Law
    robot: Any = None
    specification: Any = None
    task: Any = None
    random: tuple[float, float] = (0.0, 0.0)

    @property
    def gains(self) -> Law:
        return self.law

    @property
    def name(self) -> tuple[float, float]:
        return self.law.weights.bandwidth, self.law.weights.gamma


@dataclass(frozen=True)
class Found:
    """What a proof says."""

    is_stated: bool
    stated: Any = None


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> Any:
    """``found(proved, missing)``: the law, and the laws whose proofs were tried, in a search where some are proved and
    some miss a limit."""
    robot, tried = fh.load_robot("scara"), list[tuple[float, float]]()

    def known(robot: Any, s: Any, workspace: Any, weights: PairWeights, random: Any) -> Tried:
        if (weights.bandwidth, weights.gamma) not in SHARES:
            raise NumericalFailure("No law.", "none", "another")
        return Tried(Law(weights))

    def asked(proved: set[tuple[float, float]], missing: set[tuple[float, float]]) -> Any:
        def excesses(setups: list[Tried], least: Any) -> list[np.ndarray]:
            return [np.array([0.0, float(one.name in missing), 0.0, 0.0]) for one in setups]

        def proof(box: Any, setup: Tried) -> Any:
            tried.append(setup.name)
            return Found(setup.name in proved)

        laws = [[Tried(Law(PairWeights(bandwidth=each, gamma=USUAL)))] for each in (28.0, 20.0, 14.0)]
        patches = {
            "ChosenPoses": lambda *words: SimpleNamespace(wanted=None, excesses=excesses),
            "_candidates": lambda *words: iter(laws),
            "known_setup": known,
        }
        for name, value in patches.items():
            monkeypatch.setattr(search, name, value)
        stated = SimpleNamespace(parts=(None, None))
        stated.variants = [stated]
        monkeypatch.setattr(preset, "file_errors", lambda setup: stated)
        monkeypatch.setattr(preset, "sampled_pairs", lambda setup: setup)
        monkeypatch.setattr(
            preset, "popov_tolerance", lambda own, *words: SimpleNamespace(share=SHARES[own.name])
        )
        monkeypatch.setattr(preset._Box, "proved", proof)
        monkeypatch.setattr(preset, "with_others", lambda setup, proof, progress: proof)
        s = fh.Specification(workspace="limits", preset="proved", gain_margin=2.0)
        chosen = selected_law(robot, s, Task(workspace_of(robot, "limits"))).setup.gains.weights
        return (chosen.bandwidth, chosen.gamma), tried

    return asked


@pytest.mark.parametrize(
    ("proved", "missing", "law", "tried"),
    [
        # the grid refuses the usual γ; of the others the one that tolerates most, at the same bandwidth
        ({*SHARES}, set(), (28.0, 2.0), []),
        ({*SHARES}, {(28.0, 2.0)}, (28.0, 4.0), []),
        # what misses the limits with the usual γ is left to a slower law, whose usual γ is kept where it is proved
        ({*SHARES}, {(28.0, USUAL)}, (20.0, USUAL), []),
        # no law keeps the limits with the usual γ: at last others are tried of what the grid refused
        ({*SHARES}, {(28.0, USUAL), (20.0, USUAL), (14.0, USUAL)}, (28.0, 2.0), []),
        ({*SHARES}, {*SHARES} - {(28.0, 4.0)}, (28.0, 4.0), []),
        # the proof of 2 γ* fails, and 4 γ* tolerates less: it is not tried
        ({(28.0, 4.0), (20.0, USUAL)}, set(), (20.0, USUAL), [(28.0, 2.0)]),
        # nor is 2 γ* at 20 rad/s, after 1.2 γ* failed; a slower law is
        ({(20.0, 2.0), (14.0, USUAL)}, set(), (14.0, USUAL), [(28.0, 2.0), (20.0, USUAL), (20.0, 1.2)]),
    ],
)
def test_another_gamma_is_tried_before_a_slower_law(
    found: Any, proved: set[Any], missing: set[Any], law: tuple[float, float], tried: list[Any]
) -> None:
    assert found(proved, missing) == (law, [*tried, law])


@pytest.mark.ci("proves a law for wide tolerances")
def test_a_robot_of_wide_tolerances_is_proved_with_another_gamma(monkeypatch: pytest.MonkeyPatch) -> None:
    """Masses within 21 %, springs within 43 %: at 40 rad/s the usual γ does not tolerate them, and 4 γ* does, as if its
    motors were alike, which is tried after them as they are."""
    few(monkeypatch, CHOSEN_POSES=4)
    plain = fh.load_robot("scara")
    wide = [
        replace(p, tolerance=4.3 * p.tolerance) if p.name.startswith(preset.OF_PROOF) else p
        for p in plain.parameters
    ]
    robot = replace(plain, parameters=wide)
    s = checked_specification(
        robot,
        fh.Specification(
            workspace="limits",
            preset="proved",
            measured=("link_position", "motor_position"),
            measurement_noise=1e-10,
        ),
    )
    box: Any = preset._Box(lambda text: None)
    space = workspace_of(robot, "limits")

    def chosen() -> Any:
        return search.fastest_setup(robot, s, Task(space), lambda text: None, lambda: None, box.tolerant)

    setup = chosen()
    assert (setup.gains.weights.bandwidth, setup.gains.weights.gamma) == (40.0, 4.0)
    assert not box.proved(setup).is_stated
    while not box.alike:
        box = box.following
    assert (box.variant, box.left, box._shares) == (0, [], {})
    assert box.proved(setup).is_stated
    monkeypatch.setattr(search, "OTHER_GAMMAS", ())
    assert chosen().gains.weights.bandwidth < 40.0


@pytest.mark.parametrize(
    ("names", "missed", "line"),
    [
        ([preset.PROVED_PART], [], "tolerate all"),
        ([preset.PROVED_PART], [f"{preset.PROVED_PART}: 60 % (at least 100 %)"], "not all"),
        (["ripple"], [], "nothing of"),
    ],
)
def test_a_campaign_says_what_is_proved_of_its_design(names: list[str], missed: list[str], line: str) -> None:
    """It said that nothing is, whatever the design had."""
    about = {"options": {}, "design": {"requirements": names, "not_met": missed}}
    judged: Any = SimpleNamespace(count=4, table=SimpleNamespace(journal=SimpleNamespace(about=about)))
    text = proof_text(judged)
    assert text.startswith("Sampled: 4 robots")
    assert line in text
