"""Settings, versions and the command."""

from __future__ import annotations

import shlex

import flexhinf
from flexhinf import report


def test_every_setting_is_listed_with_value_unit_and_source() -> None:
    html = report.Settings(
        {"Arm": [report.Fact("mass", 1.0, "kg", "Table 1"), report.Fact("limit", None)]}
    ).html()
    assert '<td>1 <span class="unit">kg</span></td><td>Table 1</td>' in html
    assert "<td>–</td>" in html


def test_the_command_can_be_pasted_into_a_shell() -> None:
    words = ["flexhinf", "paper", "--out", "my report's folder"]
    html = report.Provenance(shlex.join(words), 3, {}).html()
    shown = html.split("<code>")[1].split("</code>")[0].replace("&#x27;", "'").replace("&quot;", '"')
    assert shlex.split(shown) == words
    assert "seed 3" in html


def test_versions_name_the_project_and_what_it_runs_on() -> None:
    found = report.versions()
    assert {"flexhinf", "numpy", "scipy", "casadi", "Python"} <= set(found)
    assert found["flexhinf"] == flexhinf.__version__
    assert "pytest" not in found
