"""A page with every kind of block on it, made of made-up signals."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from flexhinf import report


def step_figure() -> str:
    """A step response over its control, measured and estimated, with the band of settling."""
    time = np.linspace(0.0, 8.0, 801)
    noise = np.random.default_rng(0).normal(size=time.size)
    figure, (upper, lower) = report.new_figure(2)
    for index, damping in enumerate((1.4, 0.7)):
        angle = 180.0 * (1.0 - np.exp(-damping * time) * (np.cos(2.0 * time) + 0.3 * np.sin(14.0 * time)))
        name = ("NL-H∞", "linear H∞")[index]
        colour = report.SERIES[index]
        report.time_response(upper, time, angle, angle + 0.4 * noise, name=name, colour=colour)
        report.time_response(
            lower, time, 40.0 * np.exp(-damping * time) + 0.2 * noise, name=name, colour=colour
        )
    report.reference_line(upper, time, np.full(time.size, 180.0))
    report.settling_band(upper, target=180.0, step=180.0)
    report.label(upper, "link position", "°")
    report.label(lower, "motor voltage", "V")
    report.legend(upper)
    return report.figure_to_svg(figure)


def band_figure() -> str:
    """A hundred runs as a band."""
    time = np.linspace(0.0, 30.0, 301)
    rng = np.random.default_rng(1)
    damping, frequency = rng.uniform(0.1, 1.2, (100, 1)), rng.uniform(1.5, 3.0, (100, 1))
    runs = 90.0 * (1.0 - np.exp(-damping * time) * np.cos(frequency * time))
    figure, (panel,) = report.new_figure(1, width=5.2)
    report.quantile_band(panel, time, runs)
    report.label(panel, "link position", "°")
    report.legend(panel)
    return report.figure_to_svg(figure)


def sample_page(title: str = "The paper, end to end") -> report.Page:
    """Every element of a page."""
    claims = report.Claims(
        [
            report.JudgedClaim(
                "tracks-180",
                "NL-H∞ tracks a step to 180°.",
                "holds",
                "error 0.02° at 8 s",
                ("figure-03",),
                "both are smaller on the 180° step",
            ),
            report.JudgedClaim(
                "tolerances",
                "The loop withstands the tolerances of Tables 1–2.",
                "fails",
                "12 of 400 corners are unstable at R^v = 0.01; the slowest doubles its vibration every 11 s",
                ("figure-09",),
            ),
            report.JudgedClaim(
                "ukf-ekf", "The UKF is better than the EKF.", "ties", "difference 3e-6 ± 2e-5 rad"
            ),
            report.JudgedClaim(
                "bounded", "The UKF is bounded.", "not judged", "the paper does not define it"
            ),
        ]
    )
    columns = [
        "law",
        report.Column("overshoot", "%", 2),
        report.Column("settling time", "s", 3),
        report.Column("peak voltage", "V"),
        "settled",
    ]
    rows = [("NL-H∞", 1.18, 2.004, 37.2, True), ("linear H∞", 31.456, None, 112.0, False)]
    sections = (
        report.Section(
            "What was reproduced",
            (
                report.Paragraph(
                    "Each claim of the paper is judged from the runs of this report, not by hand."
                ),
                claims,
                *report.by_verdict(claims.claims),
                report.Note("An 8 s run hides the slow growth that 30 s show."),
                report.Bullets(("first", "second: `x < 1 & y > 2`")),
            ),
            "claims",
        ),
        report.Section(
            "Step to 180°",
            (
                report.Figure(
                    "figure-03", step_figure(), "Step to 180° & its control <solid: measured>.", "Figure 3"
                ),
                report.Table(columns, rows, "Step to 180°", "table-03"),
                report.Figure("figure-09", band_figure(), "A hundred plants, as measured.", "Figure 9"),
                report.Figure("figure-10", band_figure(), "The same runs, as estimated.", "Figure 10"),
                report.Listing("solution = fh.solve_hji(problem, gamma=2 * gamma, degree=4)"),
            ),
            "steps",
        ),
    )
    settings = {
        "Arm": [
            report.Fact("mass", 1.0, "kg", "Table 1"),
            report.Fact("joint stiffness", 100.0, "N·m/rad"),
        ],
        "Choices": [
            report.Fact("γ", math.inf, "", "ours"),
            report.Fact("weights", [60, 0, 0, 0, 300], "", "Eq. (11)"),
            report.Fact("saturation", None, "V", "none in the paper"),
            report.Fact("sub-steps", 4, "", "from the fastest mode, 100 rad/s"),
        ],
    }
    facts = (
        report.Fact("γ*", 123.0307, "", "smallest feasible"),
        report.Fact("overshoot at 180°", 1.18, "%", "linear law: 31.5 %"),
        report.Fact("settling time", 2.004, "s"),
        report.Fact("peak voltage", 37.2, "V"),
        report.Fact("unstable corners", "12 of 400", "", "R^v = 0.01"),
    )
    return report.Page(
        title=title,
        request="Reproduce Figures 3–12 of Elsa & Akbari (2014) with γ = 2 γ*, degree 4, a UKF at 1 ms.",
        verdict=report.summary(claims.claims),
        sections=sections,
        settings=settings,
        command=("flexhinf", "paper", "--out", "my report"),
        seed=0,
        facts=facts,
    )


@pytest.fixture(scope="session")
def make_page() -> Callable[..., report.Page]:
    """The maker of the sample page."""
    return sample_page


@pytest.fixture(scope="session")
def page_html() -> str:
    """The sample page as text."""
    return sample_page().html()
