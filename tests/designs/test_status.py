"""What a reader must know first: what is not met, not proved and risky."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from tests.refusals import unnamed

from flexhinf.analysis.modes import Mode
from flexhinf.designs.certification import DesignProof
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.status import StatusEntries, status_of

#: Metrics under load of a joint that comes back.
FINE = {"joint": "shoulder", "recovery_time_s": 0.2, "remaining_error": 0.0}

NOTHING = DesignProof(None, "not tried")


def judged(
    lines: tuple[Requirement, ...] = (),
    inside: bool | None = True,
    proof: DesignProof = NOTHING,
    **changes: Any,
) -> StatusEntries:
    """The status of a loop that is fine but for what is given."""
    margins: dict[str, Any] = {"stable": True, "damping": 0.5, "delay_margin_s": 0.05, **changes}
    noise, recovery = margins.pop("noise", 0.0), margins.pop("recovery", 0.3)
    tolerances, estimated = margins.pop("tolerances", True), margins.pop("estimated", {})
    corners = SimpleNamespace(unstable=0, count=8) if tolerances else None
    slow, fast = margins.pop("damping"), margins.pop("fast", 1.0)
    least_damped = tuple(Mode(complex(-ratio, 1.0) * 60.0, True, "elbow") for ratio in (slow, fast))
    margins["damping_about"] = lambda below: (slow, fast)
    errors = tuple(Mode(value, True, "shoulder") for value in margins.pop("errors", ()))
    evaluation: Any = SimpleNamespace(
        corners=corners, estimator_modes=errors, margins=SimpleNamespace(**margins), input_noise=noise,
        setup=SimpleNamespace(
            specification=SimpleNamespace(period=1e-3, shows_degrees=lambda robot: False, damped_below_limit=350.0),
            joints=("elbow", "shoulder"),
            robot=SimpleNamespace(
                links=SimpleNamespace(slides=(False, False)),
                joint_names=("elbow", "shoulder"),
                estimated=estimated,
            ),
        ),
        step=SimpleNamespace(peak_input=10.0), least_damped=least_damped, input_noises=None,
        load_response=SimpleNamespace(
            metrics=[]
            if recovery == math.inf  # of a run that diverged
            else [{"joint": "elbow", "recovery_time_s": recovery, "remaining_error": 0.1}, FINE]
        ),
    )  # fmt: skip
    worth: Any = SimpleNamespace(budget=(1,), lasts=True)
    chosen: Any = SimpleNamespace(looked=inside is not None, level=1.0)
    return status_of(lines, evaluation, chosen, worth, inside, proof)


@pytest.mark.parametrize(
    ("start", "spent", "words"),
    [
        (0.5, 0.4, ("one simulated run",)),  # which says nothing of other runs
        (0.5, 0.6, ("spends more",)),
        (1.1, 0.0, ("proved region",)),
    ],
)
def test_a_proof_is_judged_for_the_step(start: float, spent: float, words: tuple[str, ...]) -> None:
    budget: Any = (SimpleNamespace(budget=SimpleNamespace(kept=start + spent <= 1.0)),)
    certificate: Any = SimpleNamespace(level=1.0, parameters=())
    found = judged(proof=DesignProof(certificate, "", start, budget)).not_proved
    assert len(found) == len(words)
    assert all(word in one for word, one in zip(words, found))


def test_what_was_estimated_and_not_measured_is_in_the_status() -> None:
    found = judged(estimated={"stiffness": ("elbow", "shoulder"), "motor_inertia": ("elbow",), "gravity": ()})
    text = "estimated, not measured: stiffness of 2 joints, motor inertia of elbow, gravity"
    assert found.risky == (text,)
    assert text in found.line


def test_a_loop_without_faults_has_an_empty_status() -> None:
    """Old code said of every design with several joints that its region is sampled, and of 8 in 10 that another R^v
    makes corners unstable: the verdict, and the table of the corners, say what is known of both."""
    assert judged() == StatusEntries()
    assert judged(inside=None) == StatusEntries()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"damping": 0.093}, ("0.093 only", "elbow")),
        ({"fast": 0.0016}, ("0.0016 only", "elbow")),
        ({"delay_margin_s": 0.0029}, ("delay", "2.9 ms", "2.9 periods")),
        (
            {"recovery": None},
            ("load", "elbow", "2 %"),
        ),
        ({"noise": 0.51}, ("noise", "5.1 %", "peak input")),
        ({"errors": (-2.0 + 62.8j, -4.0 + 90.0j)}, ("estimation error", "10 Hz", "shoulder", "0.032")),
    ],
)
def test_what_is_risky_is_named(changes: dict[str, Any], words: tuple[str, ...]) -> None:
    (risk,) = judged(**changes).risky
    assert all(word in risk for word in words)


@pytest.mark.parametrize(
    "changes",
    [
        {"damping": 0.11}, {"fast": 0.051}, {"delay_margin_s": 0.0031}, {"noise": 0.49},
        {"errors": (0.0, -5.0 + 90.0j)},  # one that swings not at all, and one that decays soon
    ],
)  # fmt: skip
def test_what_is_not_risky_is_not_named(changes: dict[str, Any]) -> None:
    assert judged(**changes).risky == ()


def test_a_robot_without_tolerances_is_met_for_the_nominal_robot_only() -> None:
    scope = judged(tolerances=False).scope
    assert "nominal robot" in scope
    line = judged(tolerances=False).line
    assert line.startswith("Specification met")
    assert scope in line
    assert judged().scope == ""


def test_what_is_met_within_the_tolerance_only_is_said() -> None:
    """Old code printed “2.52 ≤ 2.5 met” and nothing more."""
    lines = tuple(Requirement("peak sensitivity", 2.5, found, "", True, "loop", "") for found in (2.52, 2.5))
    line = judged(lines[:1]).line
    assert line.startswith("Specification met")
    assert "peak sensitivity: 2 % " in line
    assert judged(lines[1:]).scope == ""


def test_failures_come_first_in_the_line() -> None:
    line = Requirement("overshoot", 5.0, 9.0, "%", True, "the step", "", joint="elbow")
    status = judged((line,), inside=False, noise=1.0)
    assert status.not_met
    assert unnamed(status.not_met[0], "overshoot", "9 %", "elbow", "≤ 5 %") == []
    assert unnamed(status.not_proved[0], "outside", "region") == []
    said = [
        status.line.index(part[0].rstrip(".")) for part in (status.not_met, status.risky, status.not_proved)
    ]
    assert said == sorted(said)


def test_a_step_that_starts_outside_has_no_budget() -> None:
    """One cause is told once: that it starts outside."""
    from flexhinf.designs.certification import within_level

    def terms(start: float, level: float) -> Any:
        return tuple(SimpleNamespace(budget=SimpleNamespace(start=start, level=level)) for _ in range(2))

    outside, inside, unknown = terms(2.0, 1.0), terms(0.5, 1.0), terms(2.0, math.inf)
    assert within_level(outside) == ()
    assert within_level(inside) == inside
    assert within_level(unknown) == unknown
    assert within_level(()) == ()
