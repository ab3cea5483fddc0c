"""The page of a design: status first, every section in its place, and what was computed in it."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable
from functools import cache
from html import unescape
from types import MappingProxyType, SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from tests.pages.conftest import with_evaluation
from tests.refusals import unnamed

from flexhinf.analysis import Margins
from flexhinf.designs import PoseEvidence
from flexhinf.designs.problem.weights import Behaviour, SearchResult, TargetBehaviour, WeightCandidate
from flexhinf.designs.requirements import Requirement
from flexhinf.designs.responses import Response
from flexhinf.designs.status import StatusEntries
from flexhinf.hinf import HJISolution
from flexhinf.numerals import number
from flexhinf.pages import design_page
from flexhinf.pages.design import weights
from flexhinf.pages.design.frequency import corner_rows, corner_table, corners_text, margin_table
from flexhinf.pages.design.law import mode_table
from flexhinf.pages.design.region import level_table, region, widest_step
from flexhinf.pages.design.step import histogram_bins, spread_table
from flexhinf.pages.design.weights import candidate_table, robust_table
from flexhinf.pages.drawing import joint_table, units_of
from flexhinf.pages.page import (
    design_settings,
    input_rows,
    key_numbers,
    notes,
    remarks,
    requirement_table,
    title_of,
)
from flexhinf.report import Cell, Column, Page, with_figures

Make = Callable[[str], PoseEvidence]
ORDER = [
    "specification", "step", "draws", "load", "ring-down", "move", "margins", "modes", "corners", "weights", "noise",
    "region", "law", "files",
]  # fmt: skip


@cache
def page_of(design: PoseEvidence) -> Page:
    """The page of a design, made once."""
    return design_page(design, ["flexhinf"])


def text_of(design: PoseEvidence, section: str) -> str:
    """What a section says, without mark-up."""
    (found,) = [part for part in page_of(design).sections if part.id == section]
    html = re.sub(r"<sup>(.*?)</sup>", r"^\1", found.html())
    return re.sub(r"\s+", " ", unescape(re.sub(r"<svg.*?</svg>|<[^>]+>", " ", html, flags=re.DOTALL)))


def test_tiles_say_of_which_robots_a_number_is_and_how_many_have_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of three sampled robots one diverges: it has no overshoot, and does not settle."""
    unit = SimpleNamespace(effort="V", of=lambda unit, joint: unit)
    monkeypatch.setattr("flexhinf.pages.page.units_of", lambda e: unit)

    class Samples:
        settling, overshoot, peak = np.array([[1.0, 2.0, np.inf], [5.0, 4.0, np.inf], [7.0, 8.0, 9.0]])
        joints = MappingProxyType(dict.fromkeys(("settling", "overshoot", "peak"), ("joint",) * 3))

        def __len__(self) -> int:
            return 3

    worst = SimpleNamespace(value=0.9, joint="joint")
    step = SimpleNamespace(settling=worst, overshoot=worst, peak_input=6.0, peak=worst)
    evaluation = SimpleNamespace(
        setup=SimpleNamespace(joints=("joint",)), step=step, margins=SimpleNamespace(stable=False),
        step_samples=Samples(),
    )  # fmt: skip
    design: Any = SimpleNamespace(
        evaluation=evaluation,
        specification=SimpleNamespace(period=1e-3),
        robot=SimpleNamespace(joint_names=("joint",)),
    )
    settling, overshoot, peak, _ = key_numbers(design)
    assert unnamed(str(settling.note), "1 of 3", "not settle") == []
    assert unnamed(str(overshoot.note), "1 of 3", "diverge") == []
    assert unnamed(str(peak.note), "worst of 3", "9 V") == []


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_every_question_has_its_section_in_order(report_design: Make) -> None:
    page = design_page(report_design("met"), ["flexhinf", "design", "paper"], files=["design.json"])
    assert [section.id for section in page.sections] == ORDER
    html = page.html()
    assert html.count("<script") == 1
    assert not re.search(r"\bnan\b|\binf\b", re.sub(r"<svg.*?</svg>", "", html, flags=re.DOTALL))
    figures = re.findall(r'id="(figure-[a-z]+)"', html)
    assert figures == [
        "figure-result",
        "figure-step", "figure-arm", "figure-draws", "figure-spread", "figure-load", "figure-ringing", "figure-move",
        "figure-bode", "figure-sensitivity", "figure-nyquist", "figure-estimate", "figure-poles", "figure-search",
    ]  # fmt: skip


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_the_status_comes_first_failures_before_the_rest(report_design: Make) -> None:
    design = dataclasses.replace(report_design("rings"), status=StatusEntries(("a",), ("b",), ("c",)))
    kinds = [entry.kind for entry in page_of(design).status]
    assert kinds == ["not met", "risky", "not proved"]
    html = page_of(design).html()
    assert html.index('class="verdict"') < html.index('class="numbers"') < html.index('class="status"')
    fine = dataclasses.replace(design, status=StatusEntries())
    (met,) = page_of(fine).status
    assert met.kind == "met"
    assert all(word in met.text for word in ("defaults", "bandwidth"))
    (alone,) = design_page(
        dataclasses.replace(design, status=StatusEntries(scope="only the nominal")), ["flexhinf"]
    ).status
    assert "only the nominal" in alone.text
    assert "defaults" not in page_of(report_design("met")).status[0].text


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_the_page_says_which_step_the_region_allows(report_design: Make) -> None:
    design = report_design("met")
    assert widest_step(design) == math.inf
    robot = SimpleNamespace(links=SimpleNamespace(limits=[(0.0, 3.0), None, (-1.0, 2.5)]))
    limited: Any = SimpleNamespace(robot=robot, goal=np.array([1.0, 5.0, 1.0]))
    assert widest_step(limited) == 1.5
    text = "".join(block.html() for block in with_figures(region(design))[0])
    assert 'id="table-region"' in text


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_one_joint_is_not_named(report_design: Make) -> None:
    design = report_design("met")
    assert "mainly" not in mode_table(design).html()
    columns = (Column("way", "°", key="way", scale=2.0), Column("ends", key="ends"))
    units = units_of(design.evaluation)
    single = joint_table(units, columns, [{"joint": "a", "way": 2.865, "ends": None}], "", "")
    assert single.rows == [("way", "5.73°"), ("ends", "–")]
    both = joint_table(units, columns, [{"joint": "a", "way": 1.0}, {"joint": "b", "way": 2.0}], "", "")
    assert both.rows == [("a", 2.0, None), ("b", 4.0, None)]
    assert both.stacks
    settings = {row.name: row for row in design_settings(design.synthesis, design.evaluation)["Synthesis"]}
    assert (settings["pose"].value, settings["pose"].unit) == ([90.0], "°")  # as on the rest of the page


def test_bins_of_a_histogram_hold_equally_many_sampling_instants() -> None:
    values = 1e-3 * np.random.default_rng(0).integers(862, 908, 200)
    edges = histogram_bins(values, 1e-3)
    held = np.histogram(1e-3 * np.arange(800, 1000), edges)[0]
    assert len(set(held.tolist())) == 1
    assert edges[0] < values.min() < values.max() < edges[-1]
    assert len(histogram_bins(np.array([0.5, 0.5]), 1e-3)) > 1
    assert len(histogram_bins(values, 0.0)) == 21


def test_requirements_that_are_not_met_stand_first_with_criterion_and_joint() -> None:
    kept = Requirement("overshoot", 5.0, 4.0, "%", True, "the step", "criterion", "--overshoot")
    missed = Requirement("bandwidth", 4.0, 3.0, "rad/s", False, "running loop", "at −3 dB", joint="elbow")
    where, first, other, second = requirement_table((kept, missed)).rows
    assert (where, other) == ("running loop", "the step")
    judged = Cell("NOT MET", "red")
    assert first == ("bandwidth", "≥ 4 rad/s*", "3 rad/s (elbow)", judged, "at −3 dB", "our default")
    assert second[3:] == (Cell("met", "green"), "criterion", "`--overshoot`")
    gone = dataclasses.replace(kept, found=np.inf)
    assert (gone.limit_text, gone.achieved_text) == ("≤ 5 %", "diverges")


@pytest.mark.ci("designs with searches, and with tolerances in the problem")
def test_nothing_sampled_is_called_a_guarantee(report_design: Make) -> None:
    for name in ("met", "robust"):
        html = page_of(report_design(name)).html().lower()
        assert "guarantee" not in html
        assert "any r<sup>v" not in html
        assert "sampled" in html


@pytest.mark.ci("designs with tolerances in the problem")
def test_commands_that_are_named_exist(report_design: Make) -> None:
    """The page once sent its reader to `flexhinf certify`."""
    html = page_of(report_design("robust")).html()
    named = {word for word in re.findall(r"\bflexhinf ([a-z]+)\b", html) if word != "version"}
    assert named <= {"paper", "robots", "design", "compare", "schema"}


@pytest.mark.ci("draws a whole page")
def test_what_does_not_apply_has_no_section(report_design: Make) -> None:
    page = page_of(report_design("true state"))
    assert not {"draws", "noise", "corners", "files"} & {section.id for section in page.sections}
    assert "figure-estimate" not in page.html()
    assert "figure-arm" not in page.html()  # its link has no length


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_the_search_is_shown_with_the_candidate_that_is_used(report_design: Make) -> None:
    design = report_design("met")
    search = design.design_problem.search
    assert search is not None
    rows = candidate_table(search).rows
    weights, shown = sorted(c.damping_weight for c in search.candidates), [row[0] for row in rows]
    assert shown == sorted(shown)
    assert set(shown) <= set(weights)
    assert (shown[0], shown[-1]) == (weights[0], weights[-1])
    (used,) = [row for row in rows if row[-1]]
    assert (used[0], used[5]) == (search.chosen.damping_weight, search.chosen.gamma_star)
    assert f"evaluated {len(weights)} candidates" in text_of(design, "weights")


@pytest.mark.parametrize("replaced", [False, True])
def test_a_candidate_of_another_search_is_no_point_of_the_curve(
    monkeypatch: pytest.MonkeyPatch, replaced: bool
) -> None:
    found: list[Any] = []
    monkeypatch.setattr(weights, "draw_figure", lambda name, parts, *rest, **named: found.extend(parts))
    behaviour = Behaviour(np.array([3.0]), 0.2, 0.3, np.array([0.2]), [0])
    first, second, last = (
        WeightCandidate(np.array([4.0]), np.array([zeta]), cast(HJISolution, None), star, behaviour)
        for zeta, star in ((0.1, 50.0), (0.3, 52.0), (0.2, 40.0))
    )
    search = SearchResult(last, (first, second, last))
    figure, _ = list(weights._search(search, TargetBehaviour(np.array([3.0]), 0.2), replaced))[1:]
    assert callable(figure)
    figure()
    for panel in found:
        curves = [line.x.tolist() for line in panel.lines if line.style.get("linestyle") != "none"]
        apart = [line.x.tolist() for line in panel.lines if line.style.get("linestyle") == "none"]
        assert all(curve == ([0.1, 0.3] if replaced else [0.1, 0.2, 0.3]) for curve in curves)
        assert apart == (len(curves) * [[0.2]] if replaced else [])
    assert len(found) == 2


@pytest.mark.ci("designs with tolerances in the problem")
def test_the_robust_preset_says_what_its_tolerances_cost(report_design: Make) -> None:
    design = report_design("robust")
    r = design.design_problem.robustness
    assert r is not None
    (_, plain, robust, cost), (_, gain, robust_gain, _) = robust_table(r).rows
    assert (plain, robust) == (r.nominal_gamma_star, r.gamma_star)
    assert (gain, robust_gain) == (r.nominal_gain, r.robust_gain)
    text = text_of(design, "weights")
    assert cost == 100.0 * (r.gamma_star / r.nominal_gamma_star - 1.0)
    assert f"{cost:.1f}" in text
    assert f"{r.channels} channels" in text
    assert unnamed(text, number(r.gamma_star), "channels", "products") == []  # products are not claimed


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_the_limit_of_the_input_is_drawn_or_named(report_design: Make) -> None:
    assert "±60 V" in text_of(report_design("met"), "step")
    assert "±60" not in text_of(report_design("rings"), "step")


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_the_spread_is_that_of_the_samples(report_design: Make) -> None:
    design = report_design("met")
    samples = design.evaluation.step_samples
    assert samples is not None
    table = spread_table(design.evaluation, samples)
    rows: Any = [dict(zip((column.name for column in table.heads), row)) for row in table.rows]
    for row, values in zip(rows, (samples.overshoot, samples.settling, samples.peak)):
        ordered = [number(value, 3) for value in np.sort(values)]
        assert [row["median"], row["95 % are below"], row["worst"]] == [ordered[k] for k in (8, 15, -1)]
        assert "worst joint" not in row
    text = text_of(design, "draws")
    assert f"robot {samples.worst + 1} (" in text
    assert f"robot {samples.slowest + 1} (" in text


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_runs_that_diverge_are_counted_and_never_drawn(report_design: Make) -> None:
    design = report_design("met")
    samples = design.evaluation.step_samples
    assert samples is not None
    overshoot, settling, positions = (
        samples.overshoot.copy(),
        samples.settling.copy(),
        samples.positions.copy(),
    )
    overshoot[3] = settling[3] = np.inf
    positions[3, 40:] = np.nan
    gone = dataclasses.replace(samples, overshoot=overshoot, settling=settling, positions=positions)
    text = text_of(with_evaluation(design, step_samples=gone), "draws")
    assert unnamed(text, "15 of 16", "1 diverge", "1 that diverged") == []
    assert "never" in text
    assert "robot 4 (" in text


def test_margins_stand_beside_those_of_the_true_state(report_design: Make) -> None:
    design = report_design("rings")
    e = design.evaluation
    rows = {what: (ours, state) for what, ours, state in margin_table(e).rows}
    assert rows["peak sensitivity"] == (
        f"{e.margins.peak_sensitivity:.3g}", f"{e.state_margins.peak_sensitivity:.3g}",
    )  # fmt: skip
    assert rows["delay margin, ms"][0] == f"{1e3 * e.margins.delay_margin_s:.3g}"
    unstable = with_evaluation(design, margins=Margins(e.margins.linear))
    vars(unstable.evaluation.margins)["stable"] = False
    assert {ours for _, ours, _ in margin_table(unstable.evaluation).rows} == {"unstable"}
    alone = margin_table(report_design("true state").evaluation).rows
    assert {len(row) for row in alone} == {2}


@pytest.mark.ci("evaluates two designs without damping of their springs")
def test_one_line_says_how_springs_are_damped_and_how_the_loop_is_without(report_design: Make) -> None:
    """Where a file states no damping; the paper's states that there is none, and has no such line."""
    found = report_design("true state")
    (line,) = (text for text in notes(found) if "Springs" in text)
    without = found.evaluation.undamped_margins
    assert without is not None
    assert without.damping < found.evaluation.margins.damping
    assert unnamed(line, "0.5 %", "arm", f"{without.damping:.3g}", "decides nothing") == []
    paper = report_design("rings")
    assert paper.evaluation.undamped_margins is None
    assert not any("Springs" in text for text in notes(paper))


@pytest.mark.ci("draws a whole page")
def test_the_corners_are_named_with_their_form_of_process_noise(report_design: Make) -> None:
    e = report_design("rings").evaluation
    assert e.corners is not None
    assert e.corners.count == 8
    text = corners_text(e)
    assert unnamed(text, "link position", e.corners.unstable or "none", "8 corners") == []
    cells, rows = corner_table(e).rows, corner_rows(e)
    assert {len(row) for row in cells} == {1 + 2 * len(e.corners.forms)}
    assert {row["form"] for row in rows} >= {"as designed", "true state", *e.corners.forms}
    for row in rows:
        assert row["percent"] == pytest.approx(100.0 * row["unstable"] / 8)
    section = text_of(report_design("rings"), "corners")
    for form in e.corners.forms:
        assert form in section
    assert "not listed" in section


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_levels_from_below_and_from_above(report_design: Make) -> None:
    design = report_design("met")
    rows = dict(level_table(design).rows)  # type: ignore[call-overload]
    assert rows["γ of the law"] == pytest.approx(1.5 * rows["γ* of the problem, linear part"])
    assert rows["γ of the inequality checked in the region"] == pytest.approx(1.6 * design.gamma_star)
    if design.attenuation.attained is not None:
        assert rows["worst disturbance found (lower bound)"] == design.attenuation.attained.gain


def test_a_linear_law_is_not_called_nonlinear(report_design: Make) -> None:
    assert unnamed(title_of(report_design("rings")), "linear", "“paper”") == []
    assert unnamed(title_of(report_design("rings")), "nonlinear") == ["nonlinear"]


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_every_remark_stands_once_in_its_section(report_design: Make) -> None:
    for name in ("met", "rings", "true state"):
        design = report_design(name)
        page = page_of(design)
        shown = {part.id: part.html().count('class="note"') for part in page.sections}
        found = {section: len(texts) for section, texts in remarks(design).items() if texts}
        assert found == {k: n for k, n in shown.items() if n}


@pytest.mark.ci("designs for two joints, and draws its page six times")
def test_joints_that_slide_have_their_units_and_every_worst_value_its_joint(report_design: Make) -> None:
    design = report_design("cart")
    for section, units in {
        "step": (" m ", " rad ", " N ", " N·m "),
        "load": (" N ", " mm ", " N·m ", " mrad "),
        "law": (" m ", " rad ", " N ", " N·m "),
        "weights": ("1/m", "1/rad", "1/(N/s)", "1/(N·m/s)"),
        "specification": (" N ", " N·m "),
    }.items():
        text = text_of(design, section)
        assert all(unit in text for unit in units), section
        assert section == "weights" or not re.search(r"\b(m|N|mm) or ", text), section
    assert "±300 N, ±300 N·m, beyond" in text_of(design, "step")
    verdict = page_of(design).verdict
    assert "(belt)" in verdict or "(arm)" in verdict
    for line in design.requirements:
        if line.what in ("overshoot", "peak input", "bandwidth"):
            assert line.joint in ("belt", "arm"), line


@pytest.mark.ci("draws a whole page")
def test_runs_that_diverge_are_a_result_on_the_page(report_design: Make) -> None:
    design = report_design("rings")
    e = design.evaluation

    def cut(response: Response) -> Response:
        run = response.run
        signals = {kind: values[:50] for kind, values in run.signals.items()}
        gone = dataclasses.replace(run, time=run.time[:50], signals=signals, diverged_at=0.05)
        return dataclasses.replace(response, run=gone)

    load = dataclasses.replace(e.load_response, response=cut(e.load_response.response))
    move = dataclasses.replace(e.move, response=cut(e.move.response))
    gone = with_evaluation(design, step=cut(e.step), load_response=load, move=move)
    page = page_of(gone)
    assert "diverges at 0.05 s" in page.verdict.partition(". ")[0]
    before, after = ([row["what"] for row in input_rows(one)] for one in (design, gone))
    cut_short = set(after) - set(before)
    assert len(cut_short) == 3
    assert unnamed(text_of(gone, "specification"), *cut_short) == []
    found = remarks(gone)
    assert unnamed(found["step"][-1], "diverges", "0.05 s") == []
    assert unnamed(found["load"][0], "diverges", "--set load") == []
    assert unnamed(found["move"][0], "diverges", "--bandwidth") == []
    assert not re.search(r"\bnan\b", re.sub(r"<svg.*?</svg>", "", page.html(), flags=re.DOTALL))
