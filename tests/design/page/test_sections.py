"""The page answers from the top down, and says what was computed."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from html import unescape

import numpy as np
import pytest

from flexhinf.design import Design
from flexhinf.design.page import design_page
from flexhinf.design.page.corners import sweep_cells
from flexhinf.design.page.drawn import spread_rows, worst_draw
from flexhinf.design.page.guarantee import level_rows
from flexhinf.design.page.headline import title_of
from flexhinf.design.page.margins import margin_rows
from flexhinf.design.page.weights import robust_rows, some_tries, try_rows

Make = Callable[[str], Design]
ORDER = [
    "specification", "weights", "step", "draws", "load", "move", "modes", "margins", "corners", "attained",
    "budget", "region", "rigid", "rest", "law",
]  # fmt: skip


def text_of(design: Design, section: str) -> str:
    """What a section says, without mark-up."""
    (found,) = [part for part in design_page(design, ["flexhinf"]).sections if part.id == section]
    return re.sub(r"\s+", " ", unescape(re.sub(r"<svg.*?</svg>|<[^>]+>", " ", found.html(), flags=re.DOTALL)))


def test_every_question_has_its_section_in_order(page_design: Make) -> None:
    page = design_page(page_design("met"), ["flexhinf", "design", "paper"])
    assert [section.id for section in page.sections] == ORDER
    assert page.verdict.startswith("Specification met (8 of 8 lines).")
    assert page.title == "A cubic nonlinear H∞ law for the robot “paper”"
    html = page.html()
    assert "<script" not in html
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", html, flags=re.DOTALL)


def test_what_was_not_asked_for_has_no_section(page_design: Make) -> None:
    page = design_page(page_design("true state"), ["flexhinf"])
    ids = [section.id for section in page.sections]
    assert not {"draws", "rigid", "mujoco"} & set(ids)
    assert "figure-estimate" not in page.html()
    assert "Specification" in page.verdict


def test_what_is_missed_stands_first(page_design: Make) -> None:
    design = page_design("met")
    worse = [dataclasses.replace(line, asked=0.5 * line.found) if line.what == "peak input" else line
             for line in design.met]  # fmt: skip
    changed = dataclasses.replace(design, met=tuple(worse))
    verdict = design_page(changed, ["flexhinf"]).verdict
    assert verdict.startswith("Specification NOT MET (2 of 8 lines missed): peak input")
    assert f"peak input {design.met[3].found:.3g} V (at most {0.5 * design.met[3].found:.3g} V" in verdict
    assert text_of(changed, "specification").count(" NO ") == 2
    assert " NO " not in text_of(design, "specification")


def test_defaults_of_ours_are_not_called_a_specification_of_the_users(page_design: Make) -> None:
    assert "all of them our defaults" in design_page(page_design("rings"), ["flexhinf"]).verdict
    assert "all of them our defaults" not in design_page(page_design("met"), ["flexhinf"]).verdict


def test_the_search_is_told_with_the_try_that_is_used(page_design: Make) -> None:
    design = page_design("met")
    rows, found = try_rows(design), design.game.found
    assert found is not None
    assert [row[0] for row in rows] == sorted(t.knob for t in found.tries)
    (used,) = [row for row in rows if row[-1]]
    assert used[0] == found.chosen.knob
    assert used[3] >= 0.3
    shown = some_tries(rows)
    assert used in shown
    assert shown[0] is rows[0]
    assert shown[-1] is rows[-1]
    assert f"{len(rows)} tries" in text_of(design, "weights")


def test_the_robust_preset_tells_what_its_tolerances_cost(page_design: Make) -> None:
    design = page_design("robust")
    r = design.game.robustness
    assert r is not None
    (_, plain, robust), (_, gain, robust_gain) = robust_rows(design)
    assert (plain, robust) == (r.nominal_gamma_star, r.gamma_star)
    assert (gain, robust_gain) == (r.nominal_gain, r.robust_gain)
    assert robust > plain
    text = text_of(design, "weights")
    assert f"{100 * (robust / plain - 1):.1f}" in text
    assert f"{r.channels} channels" in text


def test_the_limit_of_the_input_is_drawn_or_told(page_design: Make) -> None:
    assert "dashed: asked: at most ±60 V" in text_of(page_design("met"), "step")
    assert "saturation at ±300 N or N·m, beyond the panel" in text_of(page_design("cart"), "step")
    assert "±" not in text_of(page_design("rings"), "step")


def test_the_spread_is_that_of_the_draws(page_design: Make) -> None:
    design = page_design("met")
    draws = design.draws
    assert draws is not None
    for (name, *_, median, high, worst), values in zip(
        spread_rows(design), (draws.overshoot, draws.settling, draws.peak)
    ):
        ordered = np.sort(values)
        assert worst == ordered[-1], name
        assert median == ordered[8]  # the higher of the two in the middle of 16
        assert high == ordered[15]
    last = worst_draw(draws)
    assert draws.settling[last] == draws.settling.max()
    assert f"number {last + 1}" in text_of(design, "draws")


def test_runs_that_diverge_are_counted_and_never_drawn(page_design: Make) -> None:
    design = page_design("met")
    draws = design.draws
    assert draws is not None
    overshoot, settling, positions = draws.overshoot.copy(), draws.settling.copy(), draws.positions.copy()
    overshoot[3] = settling[3] = np.inf
    positions[3, 40:] = np.nan
    gone = dataclasses.replace(draws, overshoot=overshoot, settling=settling, positions=positions)
    text = text_of(dataclasses.replace(design, draws=gone), "draws")
    assert "15 of 16 settle, 1 diverge" in text
    assert "1 that diverged are left out" in text
    assert "never" in text
    assert "number 4" in text


def test_margins_stand_beside_those_of_the_true_state(page_design: Make) -> None:
    design = page_design("met")
    rows = {what: (ours, state) for what, ours, state in margin_rows(design)}
    assert rows["peak sensitivity"][0] == f"{design.margins.peak_sensitivity:.3g}"
    assert rows["peak sensitivity"][1] == f"{design.state_margins.peak_sensitivity:.3g}"
    assert rows["the same in periods"][0] == f"{1e3 * design.margins.delay_margin_s:.3g}"
    unstable = dataclasses.replace(design, margins=dataclasses.replace(design.margins, stable=False))
    assert {ours for _, ours, _ in margin_rows(unstable)} == {"unstable"}


def test_the_sweep_has_a_row_for_every_ratio(page_design: Make) -> None:
    design = page_design("rings")
    tolerances = design.tolerances
    assert tolerances is not None
    cells = sweep_cells(design)
    assert len(cells) == len(set(tolerances.ratios))
    for row, (_, unstable, rate, *_) in enumerate(cells):
        swept = tolerances.swept[row]
        count = int(np.count_nonzero(swept.rates >= 0.0))
        assert unstable.split()[0] == str(count)
        assert rate == f"{swept.rates.max():.3g}".replace("-", "−") or "·" in rate
    assert f"{tolerances.unstable} as designed" in text_of(design, "corners")


def test_levels_from_below_and_from_above(page_design: Make) -> None:
    design = page_design("met")
    rows = dict(level_rows(design))
    assert rows["γ of the law"] == pytest.approx(1.5 * rows["smallest level γ*, linear part"])
    assert rows["γ of the inequality that was checked in the region"] == pytest.approx(
        1.6 * design.gamma_star
    )
    assert design.guarantee.attained is not None
    assert rows["attained by the worst disturbance found"] == design.guarantee.attained.gain


def test_a_linear_law_is_not_called_nonlinear(page_design: Make) -> None:
    assert title_of(page_design("rings")) == "A linear H∞ law for the robot “paper”"


@pytest.mark.slow
def test_joints_that_slide_have_their_units(page_design: Make) -> None:
    design = page_design("cart")
    assert "(−0.01 m, 0.2 rad = 11.5°)" in design_page(design, ["flexhinf"]).asked
    for section, units in {
        "step": ("m or rad", "N or N·m"),
        "load": ("N or N·m",),
        "rest": ("m or rad", "N or N·m"),
        "weights": ("1/m", "1/rad", "1/(N/s)", "1/(N·m/s)"),
        "specification": (" N ", " N·m "),
    }.items():
        text = text_of(design, section)
        assert all(unit in text for unit in units), section
