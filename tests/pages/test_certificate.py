"""The page of a certificate: theorem, pictures, budget and gain, and the numbers that it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.certify.certificate import path_start
from flexhinf.certify.starts import limit_slice, proved_steps, start_surface, worst_step
from flexhinf.design.certification import CertifiedDegree, Evidence
from flexhinf.design.specification import Specification
from flexhinf.design.synthesis.by_step import DegreeChoice
from flexhinf.pages.certificate import certificate_page

ASKED = Specification(pose=(np.pi,))
WEIGHTS, CHECKED = (75.0, 27.0, 90.0, 27.0, 330.0), np.array([60.0, 0.0, 0.0, 0.0, 300.0])


@pytest.fixture(scope="module")
def one() -> CertifiedDegree:
    """A quadratic V about upright, proved."""
    problem = fh.paper_arm().problem(fh.Penalty(WEIGHTS, effort=10.0), pose=(np.pi,))
    star = fh.smallest_gamma(problem)
    solution = fh.solve_hji(problem, gamma=1.5 * star, degree=2)
    given = solution.certify(1.6 * star, CHECKED, level=1.0e4)
    choice = DegreeChoice(2, solution, 0.0, 0.0, 0.0, 1.1e4, 1.5, "inequality", True)
    return CertifiedDegree(choice, True, given, proved_steps(solution, given), "", 0.1)


@pytest.mark.slow
def test_the_proved_starts_lie_where_v_is_below_the_level(one: CertifiedDegree) -> None:
    given, solution = one.certificate, one.choice.solution
    assert given is not None
    surface = start_surface(solution, given, CHECKED)
    assert surface is not None
    inside = surface.value <= given.level
    assert inside.any()
    assert not inside[:, [0, -1]].any()
    assert (surface.residual[inside & (surface.value > 0.0)] < 0.0).all()
    for path, start in zip(surface.paths, given.starts):
        assert path[-1, 0] == start.amplitude
        assert solution.value(path_start(given, start, start.amplitude)) <= given.level


@pytest.fixture(scope="module")
def shown(one: CertifiedDegree) -> Evidence:
    """Its pictures, without a search for a disturbance."""
    given, solution = one.certificate, one.choice.solution
    assert given is not None
    worst = (worst_step(solution, given, given.starts[1]),)
    slices = start_surface(solution, given, CHECKED), limit_slice(solution, given, CHECKED)
    return Evidence(replace(given, sampled_level=1.1e4), *slices, worst, None)


@pytest.mark.slow
def test_slices_show_r_and_where_it_is_worst(shown: Evidence) -> None:
    """Inside, r < 0 at every point but the goal; the point that limits the level lies on its line, with r = 0."""
    given = shown.certificate
    for one in (shown.surface, shown.limit):
        assert one is not None
        inside = (one.value <= given.level) & (one.value > 0.0)
        worst = one.worst(given.level)[2]
        assert worst == one.rate[inside].max() < 0.0
    plane = shown.limit
    assert plane is not None
    above, middle = (np.argmin(np.abs(axis - at)) for axis, at in ((plane.up, 1.0), (plane.across, 0.0)))
    assert plane.value[above, middle] == pytest.approx(1.14e4, rel=0.05)
    assert (plane.residual[above:, middle] > 0.0).any()


def test_the_worst_disturbance_keeps_v_below_its_bound(shown: Evidence) -> None:
    given, (run,) = shown.certificate, shown.worst
    bound = run.value[0] + run.spent
    assert (np.diff(run.spent) >= 0.0).all()
    assert run.spent[-1] > 0.0
    assert bound[-1] <= given.level * (1.0 + 1e-3)
    assert (run.value <= bound * (1.0 + 1e-9)).all()
    assert run.value[-1] < 1e-3 * run.value[0]


@pytest.mark.parametrize(("decay", "text"), [(0.0, "decay rate"), (0.2, "√(2αc)/γ")])
def test_the_page_has_theorem_pictures_and_both_bounds(
    one: CertifiedDegree, shown: Evidence, decay: float, text: str
) -> None:
    given = replace(shown, certificate=replace(shown.certificate, decay=decay))
    html = certificate_page((one,), one, given, ASKED, ["flexhinf", "certify"]).html()
    for part in (
        'id="hypotheses"', 'id="proved"', 'id="not-proved"', "link position", "gain",
        'id="figure-starts"', 'id="figure-limit"', 'id="figure-largest"', 'id="figure-worst"',
        "r = 0", text, "flexhinf certify --check", "latency covered",
    ):  # fmt: skip
        assert part in html
    assert "gamma" not in html.split('id="starts"')[0].split('id="hypotheses"')[1]
