"""What is proved of the step that is asked for is said once: status, terminal, page and design.json agree."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.designs import Specification
from flexhinf.designs.certification import DesignProof, step_proof
from flexhinf.pages import design_files, design_tables, notes, verdict
from flexhinf.pages.design.region import proof_text


def _certificate(box: bool = False) -> Any:
    return SimpleNamespace(level=1.0, parameters=(SimpleNamespace(low=1.0, high=2.0 if box else 1.0),))


def _budget(kept: bool) -> Any:
    return (SimpleNamespace(budget=SimpleNamespace(kept=kept)),)


LOOKED: Any = SimpleNamespace(looked=True, level=1.1)
CASES: dict[str, tuple[DesignProof, Any, bool | None, bool, tuple[str, ...]]] = {
    "proved": (DesignProof(_certificate(), "", 0.5, _budget(True)), LOOKED, True, True, ("proved", "nominal")),
    "spends too much": (DesignProof(_certificate(), "", 0.5, _budget(False)), LOOKED, True, True, ("proved",)),
    "of a box": (DesignProof(_certificate(True), "", 0.5), LOOKED, None, True, ("every robot", "tolerances")),
    "outside the proved, inside the sampled": (
        DesignProof(_certificate(), "", 1.05), LOOKED, True, False, ("outside", "proved", "inside", "sampled")
    ),
    "outside both": (DesignProof(_certificate(), "", 2.0), LOOKED, False, False, ("outside", "proved")),
    "another V": (
        DesignProof(_certificate(), "", 2.0, box=SimpleNamespace()), LOOKED, False, True,
        ("outside", "proved", "nominal robot", "V"),
    ),
    "sampled": (DesignProof(None), LOOKED, True, False, ("inside", "sampled")),
    "outside the sampled": (DesignProof(None), LOOKED, False, False, ("outside", "sampled")),
    "no region": (
        DesignProof(None), SimpleNamespace(looked=True, level=np.nan, limit="no region: why."), False, False,
        ("no region", "why"),
    ),
    "not looked": (DesignProof(None), SimpleNamespace(looked=False, level=np.nan), None, False, ("no region",)),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_sentence_and_what_is_missing_agree(name: str) -> None:
    proof, chosen, inside, proved, words = CASES[name]
    found = step_proof(proof, chosen, inside)
    assert found.proved == proved
    assert unnamed(found.text, *words) == []
    assert (unnamed(found.text, "nothing") == []) != proved
    if proved:
        assert found.missing  # a proof of the fed-back state says nothing of the running loop
        assert ("simulated" in found.missing[0]) == proof.lasts
        assert not any("outside" in one for one in found.missing)
    elif "outside" in name:
        assert found.missing


@pytest.mark.ci("a whole design, and its proof")
@pytest.mark.parametrize(
    ("start", "degree", "seconds", "proved"),
    [
        (np.pi - 0.4, 2, 20.0, True),
        pytest.param(0.0, 4, 20.0, False, marks=pytest.mark.nightly("a proof of degree 4")),
        (np.pi - 0.4, 2, 0.0, False),
    ],
    ids=["proved", "outside", "sampled"],
)
def test_everything_that_is_shown_of_a_design_agrees(
    start: float, degree: int, seconds: float, proved: bool
) -> None:
    asked = Specification(
        pose=(np.pi,), start=(start,), penalty=fh.Penalty((75.0, 27.0, 90.0, 27.0, 330.0)), effort=10.0,
        degrees=(degree,), proof_seconds=seconds, draws=0,
    )  # fmt: skip
    made = fh.design(fh.paper_arm(), asked)
    found = made.evidence
    assert found.step_proof.proved == proved
    files = design_files(made, ())
    page, numbers = str(files["index.html"]), json.loads(str(files["design.json"]))["facts"]
    assert numbers["proof"]["step_proved"] == proved
    proof = found.proof.certificate is not None
    assert numbers["proof"].get("latency_samples") == (0 if proof else None)
    assert ("latency" in proof_text(found)) == proof
    shown = " ".join([verdict(found), *notes(found)])
    for text in (page, shown):
        assert found.step_proof.text.rstrip(".") in text
    said = verdict(found)
    assert said.count("sampled region") + said.count("proved region") <= 1 + proved
    assert not any(found.step_proof.text.rstrip(".") in note for note in notes(found))
    titles = " ".join(str(table.title) for table in design_tables(found))
    for text in (page, titles):
        assert ("sampled, not" in text) == (found.proof.certificate is None)
