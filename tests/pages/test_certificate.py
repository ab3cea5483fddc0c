"""The page of a certificate: theorem, pictures, budget and gain, and the numbers that it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.pages.conftest import CHECKED_PENALTY

from flexhinf.certify.certificate import path_start
from flexhinf.certify.starts import start_surface
from flexhinf.designs.certification import CertifiedDegree, Evidence
from flexhinf.designs.specification import Specification
from flexhinf.pages.certificate import certificate_page

ASKED = Specification(pose=(np.pi,))


@pytest.mark.ci("proves a law")
def test_the_proved_starts_lie_where_v_is_below_the_level(proved_degree: CertifiedDegree) -> None:
    given, solution = proved_degree.certificate, proved_degree.choice.solution
    assert given is not None
    surface = start_surface(solution, given, CHECKED_PENALTY)
    assert surface is not None
    inside = surface.value <= given.level
    assert inside.any()
    assert not inside[:, [0, -1]].any()
    assert (surface.residual[inside & (surface.value > 0.0)] < 0.0).all()
    for path, start in zip(surface.paths, given.starts):
        assert path[-1, 0] == start.amplitude
        assert solution.value(path_start(given, start, start.amplitude)) <= given.level


@pytest.mark.ci("proves a law, and samples its margin on two planes")
def test_slices_show_r_and_where_it_is_worst(evidence: Evidence) -> None:
    """Inside, r < 0 at every point but the goal; the point that limits the level lies on its line, with r = 0."""
    given = evidence.certificate
    for cut in (evidence.surface, evidence.limit):
        assert cut is not None
        inside = (cut.value <= given.level) & (cut.value > 0.0)
        worst = cut.worst(given.level)[2]
        assert worst == cut.rate[inside].max() < 0.0
    plane = evidence.limit
    assert plane is not None
    above, middle = (np.argmin(np.abs(axis - at)) for axis, at in ((plane.up, 1.0), (plane.across, 0.0)))
    assert plane.value[above, middle] == pytest.approx(1.14e4, rel=0.05)
    assert (plane.residual[above:, middle] > 0.0).any()


@pytest.mark.ci("proves a law")
def test_the_worst_disturbance_keeps_v_below_its_bound(evidence: Evidence) -> None:
    given, (run,) = evidence.certificate, evidence.worst
    bound = run.value[0] + run.spent
    assert (np.diff(run.spent) >= 0.0).all()
    assert run.spent[-1] > 0.0
    assert bound[-1] <= given.level * (1.0 + 1e-3)
    assert (run.value <= bound * (1.0 + 1e-9)).all()
    assert run.value[-1] < 1e-3 * run.value[0]


@pytest.mark.ci("proves a law, and draws its page")
@pytest.mark.parametrize(("decay", "text"), [(0.0, "decay rate"), (0.2, "√(2αc)/γ")])
def test_the_page_has_theorem_pictures_and_both_bounds(
    proved_degree: CertifiedDegree, evidence: Evidence, decay: float, text: str
) -> None:
    given = replace(evidence, certificate=replace(evidence.certificate, decay=decay))
    html = certificate_page((proved_degree,), proved_degree, given, ASKED, ["flexhinf", "certify"]).html()
    for part in (
        'id="hypotheses"', 'id="proved"', 'id="not-proved"', "link position", "gain",
        'id="figure-starts"', 'id="figure-limit"', 'id="figure-largest"', 'id="figure-worst"',
        "r = 0", text, "flexhinf certify --check", "latency covered",
    ):  # fmt: skip
        assert part in html
    assert "gamma" not in html.split('id="starts"')[0].split('id="hypotheses"')[1]
