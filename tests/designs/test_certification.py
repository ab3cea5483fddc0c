"""The proof that a design carries: what it covers, what refuses it, and the time that it may take."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.certify.a_cubic import CUBIC
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.certify import Parameter, Signal
from flexhinf.designs import certification
from flexhinf.designs.certification import DesignProof, certify_design, prove_design, with_tolerances
from flexhinf.designs.specification import Specification
from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.pages.design import region
from flexhinf.pages.design.region import proof_text

ARM, page = fh.paper_arm(), import_module("flexhinf.pages.certificate")
PENALTY = fh.Penalty((75.0, 27.0, 90.0, 27.0, 330.0), effort=10.0)
ASKED = Specification(pose=(np.pi,), checked_penalty=(60.0, 0.0, 0.0, 0.0, 300.0))


@pytest.fixture(scope="module")
def made() -> Any:
    """A quadratic V about upright, with its sampled region."""
    problem = ARM.problem(PENALTY, pose=(np.pi,))
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=2)
    check = solution.sampled_region(1.6 * star, (60.0, 0.0, 0.0, 0.0, 300.0))
    assert check is not None
    return SimpleNamespace(
        goal=np.array([np.pi]), solution=solution, law=solution,
        chosen=SimpleNamespace(level=check.level, looked=True, degree=2),
        design_problem=SimpleNamespace(gamma_star=star, nominal=problem),
        problem=problem, proved=None,
    )  # fmt: skip


def worth(spent: float) -> Any:
    """An attenuation whose step spends so much of an unknown level."""
    from flexhinf.analysis import BudgetTerm
    from flexhinf.analysis.dissipation import DissipationBudget

    zero = np.zeros(2)
    budget = DissipationBudget(np.arange(2.0), np.inf, 100.0, np.array([0.0, spent]), zero, zero, True)
    return SimpleNamespace(attained=None, budget=(BudgetTerm("sampling", budget, spent),))


def proof_of(made: Any, start: float = 100.0, spent: float = 10.0, **asked: Any) -> DesignProof:
    return prove_design(ARM, replace(ASKED, **asked), made, start, worth(spent))


@pytest.mark.ci("a sampled region, and its proof")
def test_the_sampled_region_is_proved_and_the_budget_is_judged_by_it(made: Any) -> None:
    found = proof_of(made)
    given = found.certificate
    assert given is not None
    assert given.level == pytest.approx(0.999 * made.chosen.level)
    assert given.sampled_level == made.chosen.level
    assert len(given.starts) == 2
    assert found.inside
    assert found.lasts
    assert found.budget[0].budget.level == given.level
    assert not replace(found, start=given.level * 1.01).inside
    assert not proof_of(made, spent=given.level).lasts


@pytest.mark.ci("a proof that fails, and the one below it")
def test_a_level_that_was_sampled_too_large_is_lowered(made: Any) -> None:
    chosen = SimpleNamespace(level=1.01 * made.chosen.level, looked=True, degree=2)
    larger = SimpleNamespace(**{**vars(made), "chosen": chosen})
    given = proof_of(larger).certificate
    assert given is not None
    assert given.level == pytest.approx(0.98 * larger.chosen.level)


@pytest.mark.parametrize(
    ("changes", "asked", "reason"),
    [
        ({}, {"proof_seconds": 0.0}, "--set proof_seconds=0"),
        ({}, {"proof_seconds": 1e-6}, " 1e-06 s"),
        ({"law": None}, {}, "schedule"),
        ({"chosen": SimpleNamespace(level=np.nan, looked=True, degree=2)}, {}, "region"),
        ({"solution": SimpleNamespace(state_names=("x",) * 10)}, {}, " 5 states"),
    ],
)
def test_what_is_not_proved_says_why(made: Any, changes: dict, asked: dict, reason: str) -> None:
    found = proof_of(SimpleNamespace(**{**vars(made), **changes}), **asked)
    assert found.certificate is None
    assert reason in found.reason
    assert not found.inside
    assert not found.lasts


@pytest.mark.ci("proves a design")
def test_a_degree_that_is_not_proved_does_not_stop_the_others(
    made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    choices = [SimpleNamespace(degree=degree, solution=made.solution, law=made.solution) for degree in (2, 4)]
    laws = SimpleNamespace(**vars(made) | {"choices": choices, "chosen": choices[0]})
    monkeypatch.setattr(certification, "synthesise", lambda *_: laws)
    proof = certification.certify

    def only_the_first(*arguments: Any, about: str, **settings: Any) -> Any:
        if "degree 4" in about:
            raise NumericalFailure("No energy of the errors was found.", "it is not negative definite", "10")
        return proof(*arguments, about=about, **settings)

    monkeypatch.setattr(certification, "certify", only_the_first)
    asked = replace(ASKED, checked_gamma_ratio=1.6)
    first, other = certify_design(ARM, asked, lambda step: None, lambda *_: None, observer=1.0)
    assert first.certificate is not None
    assert first.certificate.feedback == "output injection observer"
    assert [step.amplitude for step in first.steps] == [start.amplitude for start in first.certificate.starts]
    assert other.certificate is None
    assert "definite" in other.reason


@pytest.mark.ci("proves a design")
def test_what_no_degree_could_mend_ends_the_proofs_for_all_tolerances(
    made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    choice = SimpleNamespace(degree=2, solution=made.solution)
    laws = SimpleNamespace(**vars(made) | {"choices": [choice], "chosen": choice, "start": np.array([3.0])})
    monkeypatch.setattr(certification, "synthesise", lambda *_: laws)

    def found(asked: Specification) -> Any:
        return certify_design(ARM, asked, lambda step: None, lambda *_: None, tolerances=True)

    with refused_with(InvalidInput, "penalty", "'foo'"):
        found(replace(ASKED, checked_penalty={"foo": 1.0}))

    def unsettled(*_: Any) -> Any:
        raise NumericalFailure("Unsettled.", "V is 1 after 9 s")

    monkeypatch.setattr(certification.proved_step, "sampled_box", unsettled)
    assert found(ASKED)[0].reason  # of this degree
    monkeypatch.setattr(certification.proved_step, "sampled_box", lambda *_: None)
    monkeypatch.setattr(
        certification.proved_step, "prove_box", lambda *_, **__: SimpleNamespace(certificate=CUBIC)
    )
    monkeypatch.setattr(certification.starts, "proved_steps", unsettled)
    with pytest.raises(NumericalFailure, match="Unsettled"):
        found(ASKED)


def test_what_is_not_proved_for_all_tolerances_says_why(made: Any) -> None:
    nominal = DesignProof(None, "not tried")

    def why(**changes: Any) -> str:
        found = with_tolerances(
            ARM, ASKED, SimpleNamespace(**vars(made) | {"start": np.array([0.0])} | changes), nominal
        )
        assert found.box is None
        return found.box_reason

    paper = fh.linear_law(
        ARM.problem(pose=(np.pi,)), gamma=2.0 * fh.smallest_gamma(ARM.problem(pose=(np.pi,)))
    )
    assert "quadratic V" in why(solution=paper, law=paper)
    cubic = SimpleNamespace(state_names=("x",) * 5, degree=4)
    assert unnamed(why(solution=cubic, law=cubic), "degree 3", "--degrees 2") == []
    assert why(law=None) == ""  # nothing is tried where no region is
    assert why(chosen=SimpleNamespace(level=np.nan, looked=False, degree=2)) == ""


def test_what_is_shown_of_a_bound_holds() -> None:
    """Rounded to few digits, a gain is not smaller than the proved one, and a step or a level not larger."""
    given = replace(CUBIC, gamma=2.00006, level=0.12468)
    given = replace(given, starts=(replace(CUBIC.starts[0], amplitude=0.49968),))
    shown = SimpleNamespace(certificate=given, limit=None, worst=(), attained=None)
    one = SimpleNamespace(steps=(), box=None)
    shown_numbers = [(entry.value, entry.unit) for entry in page._facts(one, given, degrees=True)]  # type: ignore[arg-type]
    assert [value for value, _ in shown_numbers] == ["0.499", "≤ 2.001", "0.1246"]
    assert shown_numbers[0][1] == "m"
    assert " 0.0623 N²·s" in str(page._budget(shown, degrees=False))  # type: ignore[arg-type]
    turned = replace(given, states=(Signal("position", "rad"),))
    assert page._steps_text(turned, degrees=True).startswith("28.6°")
    assert region._amplitude_text(SimpleNamespace(  # type: ignore[arg-type]
        robot=SimpleNamespace(links=SimpleNamespace(slides=[False])), specification=SimpleNamespace(in_degrees=True)
    ), 1.1169999) == "63.9°"  # fmt: skip


def test_the_budget_is_claimed_for_the_law_of_its_v_alone() -> None:
    """Of another V nothing is said about inputs that differ from the law, whether parameters are uncertain or not."""
    own = replace(CUBIC, parameters=(Parameter("softening", 1.0, 1.0, "N/m3"),))
    other = replace(own, law=((((1,), -1.1),),))
    for given, claimed in ((own, True), (other, False)):
        assert given.is_gradient_law == claimed == given.check(threads=1).gradient_law
        shown = str([section for section in page._theorem(given) if section.title == "Proved"])
        assert ("Budget" in shown) == claimed


@pytest.mark.nightly("a proof for all tolerances; tests/designs/test_step_proof.py has one of a whole design")
def test_a_design_that_searches_weights_is_proved_for_all_tolerances() -> None:
    """90°, the last 10 degrees, damping 0.4: the time is enough by far."""
    asked = Specification(
        pose=(np.pi / 2,),
        start=(np.radians(80.0),),
        angle_unit="deg",
        preset="damped",
        damping=0.4,
        degrees=(2,),
        draws=0,
    )
    found = fh.design(ARM, asked).evidence
    box = found.proof.box
    assert box is not None, found.proof.box_reason
    assert box.certificate is not None
    assert box.certificate.step_amplitude == pytest.approx(np.radians(10.0))
    assert box.gamma < 3.0 * fh.smallest_gamma(box.problem)
    text = proof_text(found)
    assert unnamed(text, "proved", "every robot", "10°") == []
