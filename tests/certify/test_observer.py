"""Output feedback: what an output-injection observer pays for is proved, and what it does not is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.certify import Certificate, Term, Verification, load_certificate
from flexhinf.certify.certificate import theorem_text
from flexhinf.certify.checker import statements as checked
from flexhinf.certify.claim import Observer
from flexhinf.certify.proof import _storage
from flexhinf.errors import InvalidInput

BANDWIDTH = 10.0


def error_axes(observer: Observer) -> np.ndarray:
    """Largest initial error in each single state without disturbances (n_e,): ½ X_ii e_i² = ε."""
    return np.sqrt(2.0 * observer.energy / np.diag(np.array(observer.storage)))


@cache
def solution(torques: bool) -> tuple[fh.HJISolution, float]:
    arm, penalty = fh.paper_arm(), fh.Penalty((75, 27, 90, 27, 330), effort=10.0)
    channels: Any = (
        {"disturbances": ("link_torque", "motor_torque")} if torques else {"command": "disturbance"}
    )
    problem = arm.plant().with_objective(penalty, integrate=("link_position",), pose=(np.pi,), **channels)
    smallest = fh.smallest_gamma(problem)
    return fh.solve_hji(problem, gamma=1.5 * smallest, degree=2), 1.6 * smallest


@cache
def proved(torques: bool) -> Certificate:
    found, gamma = solution(torques)
    level = 12_000.0 if torques else 11_000.0
    return found.certify(gamma, (60, 0, 0, 0, 300), level, observer=BANDWIDTH)


def refusal(certificate: Certificate, **changes: Any) -> str:
    """Why the checker refuses the certificate with its observer, or the claim, changed."""
    observer = {key: value for key, value in changes.items() if key in Observer.__dataclass_fields__}
    claim = {key: value for key, value in changes.items() if key not in observer}
    assert certificate.observer is not None
    return replace(certificate, observer=replace(certificate.observer, **observer), **claim).why_no_observer()


def scaled(matrix: Any, factor: float) -> Any:
    return tuple(tuple(factor * value for value in row) for row in matrix)


@pytest.mark.ci("proves two claims of the paper's arm")
def test_errors_of_a_tenth_of_the_level_are_covered() -> None:
    certificate = proved(False)
    found = certificate.check(threads=1, sample=0)
    assert found.proved, found.reason
    observer = certificate.observer
    assert observer is not None
    assert (observer.energy, observer.gain_error) == (
        0.1 * certificate.level,
        0.0,
    )  # a command moves no error
    assert observer.known == ("link_position_integral",)
    assert error_axes(observer)[2] > 0.29  # rad, motor position
    assert 1.35 < certificate.step_amplitude < 1.42
    dearer = replace(certificate, observer=replace(observer, energy=1.02 * observer.energy))
    assert "inside" in dearer.check(sample=0).reason  # starts keep what the errors may take


@pytest.mark.ci("one more proof of the paper's arm")
def test_disturbances_on_the_plant_have_a_gain_of_their_own() -> None:
    certificate = proved(True)
    assert certificate.observer is not None
    gain = certificate.observer.gain_error
    assert certificate.why_no_observer() == ""
    assert 20 < gain < 30
    assert "gamma_e^2" in refusal(certificate, gain_error=0.6 * gain)
    assert "no gain" in refusal(certificate, gain_error=0.0)


def wrong() -> dict[str, tuple[dict[str, Any], str]]:
    observer = proved(False).observer
    assert observer is not None
    x = np.array(observer.storage)
    asymmetric = x + np.triu(np.full_like(x, 1e-9), 1)
    return {
        "X": ({"storage": scaled(observer.storage, 0.97)}, "not negative definite"),
        "X not symmetric": ({"storage": tuple(map(tuple, asymmetric))}, "not symmetric"),
        "X negative": ({"storage": scaled(observer.storage, -1.0)}, "X is not positive definite"),
        "M": ({"weight": scaled(observer.weight, 0.97)}, "does not bound the slopes"),
        "M too large": ({"weight": scaled(observer.weight, 1.05)}, "not negative definite"),
        "L": ({"gain": scaled(observer.gain, 0.9)}, "not negative definite"),
        "L of the other sign": ({"gain": scaled(observer.gain, -1.0)}, "not negative definite"),
        "the motor is measured": ({"measured": ((0.0, 0.0, 1.0, 0.0, 0.0),)}, "nonlinear in what is not measured"),
    }  # fmt: skip


WRONG = (
    "X", "X not symmetric", "X negative", "M", "M too large", "L", "L of the other sign", "the motor is measured"
)  # fmt: skip


@pytest.mark.ci("proofs with other observers")
@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_pay_is_refused(name: str) -> None:
    changes, reason = wrong()[name]
    assert reason in refusal(proved(False), **changes)


def test_a_plant_that_is_not_of_the_form_is_refused() -> None:
    certificate = proved(False)
    drift = certificate.drift
    hidden = (*drift[:3], (*drift[3], Term(1e-3, (0, 0, 0, 3, 0))), drift[4])
    assert unnamed(refusal(certificate, drift=hidden), "motor_velocity", "nonlinear") == []
    other = (*drift[:4], (Term(1.0, (0, 0, 1, 0, 0)),))
    assert unnamed(refusal(certificate, drift=other), "link_position_integral", "computed") == []
    wide = tuple(
        replace(p, high=1.01 * p.high) if p.name == "stiffness" else p for p in certificate.parameters
    )
    assert "parameters" in refusal(certificate, parameters=wide)
    moved = (*certificate.g2[:3], ((Term(9.0, (1, 0, 0, 0, 0)),),), certificate.g2[4])
    assert "input matrix" in refusal(certificate, g2=moved)


def test_the_slopes_are_bounded_where_the_estimates_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """With V of degree four M must hold on S enlarged by the errors: M of the slopes at the goal does not."""
    flat = proved(False)
    assert flat.observer is not None
    bent = (*flat.value, ((0, 0, 0, 4, 0), 0.02))
    assert unnamed(refusal(flat, value=bent), "M", "slopes") == []
    monkeypatch.setattr(checked, "_hull", lambda claim, *rest: [checked.fmpq(0)] * len(claim.states))
    assert refusal(flat, value=bent) == ""


def test_what_is_proved_is_what_runs_do() -> None:
    """V + ½eᵀXe never grows with the command at rest, from a start of the largest step with the largest error."""
    certificate, (found, _) = proved(False), solution(False)
    observer = certificate.observer
    assert observer is not None
    x_e, gain, c = np.array(observer.storage), np.array(observer.gain), np.array(observer.measured)[:, :4]
    linear = found.expansion.f_parts[1][:4, :4].copy()
    linear[1, 0] -= 9.8  # the sine is measured: it is in y
    closed = linear - gain @ c
    assert np.linalg.eigvals(closed).real.max() < -BANDWIDTH
    from scipy.integrate import solve_ivp

    def rates(_: float, s: np.ndarray) -> np.ndarray:
        x, e = s[:5], s[5:]
        f, _g1, g2, _h = found.exact_fields(x[None])
        estimate = x - np.r_[e, 0.0]
        return np.r_[f[0] + g2[0] @ found.inputs(estimate[None])[0], closed @ e]

    error = np.array([0.0, 0.0, error_axes(observer)[2], 0.0])
    first = np.array([-certificate.step_amplitude, 0, -certificate.step_amplitude, 0, 0])
    first *= np.sqrt(certificate.start_level / float(found.value(first)))
    run = solve_ivp(rates, (0.0, 3.0), np.r_[first, error], "LSODA", rtol=1e-9, atol=1e-10)
    whole = np.array(found.value(run.y[:5].T)) + 0.5 * np.einsum("it,ij,jt->t", run.y[5:], x_e, run.y[5:])
    assert whole[0] == pytest.approx(certificate.level)
    assert np.diff(whole).max() < 1e-6 * whole[0]


def test_the_file_and_the_theorem_say_it(tmp_path: Any) -> None:
    certificate = proved(False)
    certificate.save(tmp_path / "c.json")
    assert load_certificate(tmp_path / "c.json") == certificate
    found = Verification(True, gradient_law=True)
    text = theorem_text(certificate, found)
    signals = "link_position, link_velocity, motor_position, motor_velocity"
    names = signals, "y = (link_position)", "link_position_integral", "6. Output feedback", "estimates (6.)"
    assert unnamed(text, *names, "noise", "sampling") == []
    assert " motor_position 0.3" in text
    assert certificate.observer is not None
    said = re.findall(r"(?:_position|_velocity) ([\d.]+) rad", text.partition("one state alone")[2])
    shares = np.array(said, float) / error_axes(certificate.observer)
    assert len(shares) == 4
    assert (shares <= 1).all()  # rounded towards what holds
    assert (shares > 1 - 1e-5).all()
    state = theorem_text(replace(certificate, observer=None, feedback="state"), found)
    assert "6." not in state
    not_proved = state.partition("Not proved")[2]
    assert unnamed(not_proved, "estimator", "sampling", "delay", "saturation", "quantisation", "noise") == []


def test_an_observer_needs_a_bandwidth() -> None:
    found, gamma = solution(False)
    with refused_with(InvalidInput, "observer", -1.0):
        found.certify(gamma, (60, 0, 0, 0, 300), 11_000.0, observer=-1.0)
    with refused_with(InvalidInput, "feedback", "'output injection observer'", "'state'"):
        replace(proved(False), feedback="state")


@pytest.mark.nightly("a proof of degree four; those of degree two are above")
def test_a_law_of_degree_three_is_covered_for_smaller_errors() -> None:
    """180°, V of degree four, on the hull of S and its estimates: 6 s of CPU."""
    arm = fh.paper_arm()
    problem = arm.problem(fh.Penalty((75, 27, 90, 27, 330), effort=10.0), pose=(np.pi,))
    smallest = fh.smallest_gamma(problem)
    found = fh.solve_hji(problem, gamma=1.5 * smallest, degree=4)
    certificate = found.certify(1.6 * smallest, (60, 0, 0, 0, 300), observer=BANDWIDTH)
    assert certificate.observer is not None
    assert certificate.check().proved
    assert 1.8 < certificate.step_amplitude < 1.95
    assert error_axes(certificate.observer)[[0, 2]] == pytest.approx((0.039, 0.133), abs=0.001)
    small = scaled(certificate.observer.weight, 0.85)  # M of the search is little larger than need be
    assert unnamed(refusal(certificate, weight=small), "M", "slopes") == []


@pytest.mark.parametrize("width", [1, 2, 3])
def test_the_storage_of_errors_solves_its_equation_for_any_number_of_disturbances(width: int) -> None:
    """AᵀX + XA + M + XGGᵀX/γ² = 0, with a gain γ that is at least that of the errors and at most twice as large."""
    rng = np.random.default_rng(width)
    a, noise = rng.normal(size=(3, 3)) - 4.0 * np.eye(3), rng.normal(size=(3, width))
    root = rng.normal(size=(3, 3))
    weight = root @ root.T + np.eye(3)
    found = _storage(a, noise, weight)
    assert found is not None
    x, gain = found
    pushed = x @ noise @ noise.T @ x / gain**2
    np.testing.assert_allclose(a.T @ x + x @ a + weight + pushed, 0.0, atol=1e-9)
    assert np.linalg.eigvalsh(x)[0] > 0.0
    out = np.linalg.cholesky(weight).T
    sizes = [
        np.linalg.norm(out @ np.linalg.solve(1j * w * np.eye(3) - a, noise), 2)
        for w in np.linspace(0.0, 50.0, 501)
    ]
    assert 1.0 < gain / max(sizes) < 2.0
