"""The report of a design: one page, and the same numbers as JSON.

The page answers from the top down: is what was asked for met, and at what cost; where do the weights come from; what
does the nonlinear loop do, nominal and within the tolerances; how far is it from the edge; where can the solution be
trusted; what is it exactly.
"""

from __future__ import annotations

from collections.abc import Sequence

from flexhinf.design.page.asked import asked_section
from flexhinf.design.page.corners import corners_section
from flexhinf.design.page.drawn import drawn_section
from flexhinf.design.page.guarantee import attained_section, budget_section
from flexhinf.design.page.headline import asked_words, key_numbers, title_of
from flexhinf.design.page.law import law_section
from flexhinf.design.page.load import load_section
from flexhinf.design.page.margins import margins_section
from flexhinf.design.page.modes import modes_section
from flexhinf.design.page.move import move_section
from flexhinf.design.page.mujoco import mujoco_section
from flexhinf.design.page.numbers import numbers_of
from flexhinf.design.page.region import region_section
from flexhinf.design.page.rest import rest_section
from flexhinf.design.page.rigid import rigid_section
from flexhinf.design.page.settings import setting_groups
from flexhinf.design.page.step import step_section
from flexhinf.design.page.weights import weights_section
from flexhinf.design.page.words import headline
from flexhinf.design.result import Design
from flexhinf.report import Page, Provenance, Settings, to_json

__all__ = ["design_files", "design_page"]

#: In the order of the questions; one that is None was not asked.
SECTIONS = (
    weights_section,
    step_section,
    drawn_section,
    load_section,
    move_section,
    mujoco_section,
    modes_section,
    margins_section,
    corners_section,
    attained_section,
    budget_section,
    region_section,
    rigid_section,
    rest_section,
    law_section,
)


def design_files(design: Design, command: Sequence[str], warnings: Sequence[str] = ()) -> dict[str, str]:
    """index.html and design.json."""
    return {
        "index.html": design_page(design, command, warnings).html(),
        "design.json": to_json(numbers_of(design)),
    }


def design_page(design: Design, command: Sequence[str], warnings: Sequence[str] = ()) -> Page:
    """Everything on one page."""
    sections = [asked_section(design, warnings), *(section(design) for section in SECTIONS)]
    return Page(
        title_of(design),
        asked_words(design),
        headline(design),
        tuple(section for section in sections if section is not None),
        Settings(setting_groups(design)),
        Provenance(tuple(command), design.specification.seed),
        key_numbers(design),
    )
