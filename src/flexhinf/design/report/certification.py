"""What is proved of a design, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from flexhinf.design.certification import CertifiedDegree
from flexhinf.design.report.formatting import law_name
from flexhinf.design.report.proof import RULES
from flexhinf.design.report.text import plain_table
from flexhinf.report import at_least, number


def certification_tables(found: Sequence[CertifiedDegree]) -> list[Table]:
    """What is proved of the law of each degree, and the runs from the largest proved steps."""
    whom = "all parameters within the tolerances" if any(one.box for one in found) else "nominal parameters"
    table = plain_table(
        f"What is proved, with the true state fed back and {whom} (* used)",
        "law", "level of V", "of the sampled", "largest step", "cells", "CPU, s",
    )  # fmt: skip
    for one in found:
        name = law_name(one.choice.degree) + (" *" if one.used else "")
        given = one.certificate
        if given is None:
            table.add_row(name, "none", "", "", "", f"{one.cpu_seconds:.1f}")
            continue
        ratio = "" if given.sampled_level is None else f"{100 * given.level / given.sampled_level:.1f} %"
        cells = given.provenance.get("cells", "")
        step = at_least(given.step_amplitude) if given.starts else "no step is stated"
        table.add_row(name, at_least(given.level), ratio, step, cells, f"{one.cpu_seconds:.1f}")
    return [table, *(_steps(one) for one in found if one.steps)]


def certification_notes(found: Sequence[CertifiedDegree]) -> list[str]:
    """Of which laws nothing is proved, and why."""
    return [f"{law_name(one.choice.degree)}: nothing is proved: {one.reason}" for one in found if one.reason]


def _steps(one: CertifiedDegree) -> Table:
    assert one.certificate is not None
    units = one.certificate.inputs[0].unit
    moved = one.certificate.states[0].unit
    table = plain_table(
        f"{law_name(one.choice.degree)}: simulated, not proved: the nominal robot from the largest proved starts",
        "integrators start", f"step, {moved}", "overshoot, %", f"first, {units}", f"peak, {units}",
    )  # fmt: skip
    for step in one.steps:
        first, peak = (", ".join(number(v) for v in values) for values in (step.first_input, step.peak_input))
        table.add_row(
            RULES.get(step.rule, step.rule),
            at_least(step.amplitude),
            number(step.overshoot_percent, decimals=1),
            first,
            peak,
        )
    return table
