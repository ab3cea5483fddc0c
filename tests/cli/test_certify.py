"""``flexhinf certify --check``: the theorem in words, and exit codes that a script can read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from flexhinf.certify import Certificate, Parameter, Signal, Start, Term
from flexhinf.cli.commands import run

#: ẋ = p x³ + u + d, u = −x, V = x²/2: r = −x²/2 + x²/(2γ²) + h²/2 + p x⁴ < 0 for x² < (1 − 1/γ² − h²)/(2p).
CUBIC = Certificate(
    about="a cubic",
    states=(Signal("position", "m"),),
    inputs=(Signal("pull", "N"),),
    disturbances=(Signal("gust", "N"),),
    drift=((Term(1.0, (3,), (("softening", 1),)),),),
    g1=(((Term(1.0, (0,)),),),),
    g2=(((Term(1.0, (0,)),),),),
    penalty=((((1,), 0.5),),),
    r2=((1.0,),),
    value=(((2,), 0.5),),
    law=((((1,), -1.0),),),
    gamma=2.0,
    level=0.1249,  # x² < 0.25 at p = 1
    coordinates=((1.0,),),
    reach=2.0,
    parameters=(Parameter("softening", 0.5, 1.0, "N/m3"),),
    starts=(Start("released at rest", 0.499, ((Term(-1.0, (1,)),),)),),
)


def test_the_theorem_is_said_with_its_hypotheses_and_what_is_not_proved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    CUBIC.save(tmp_path / "certificate.json")
    assert run(["certify", "--check", str(tmp_path / "certificate.json")]) == 0
    out = capsys.readouterr().out
    for text in (
        "softening in [0.5, 1] N/m3", "gust [N]", "released at rest; steps from rest to rest of up to 0.499",
        "is fed the true state, in continuous time", "gamma = 2", "V <= 0.1249", "Not proved", "saturation",
        "Disturbances that last for ever: no decay", "PROVED again from the certificate's data alone",
    ):  # fmt: skip
        assert text in out


@pytest.mark.parametrize(
    "changed",
    [
        replace(CUBIC, level=0.1251, starts=()),
        replace(CUBIC, decay=0.01),
        replace(CUBIC, starts=(replace(CUBIC.starts[0], amplitude=0.5),)),
    ],
)
def test_what_is_not_proved_has_exit_code_1(
    changed: Certificate, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed.save(tmp_path / "certificate.json")
    assert run(["certify", "--check", str(tmp_path / "certificate.json")]) == 1
    assert "NOT PROVED: " in capsys.readouterr().out


def test_a_decay_bounds_persistent_disturbances(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace(CUBIC, decay=0.25, level=0.06, starts=()).save(tmp_path / "certificate.json")
    assert run(["certify", "--check", str(tmp_path / "certificate.json")]) == 0
    out = capsys.readouterr().out
    assert "|d(t)| <= 0.0866025 at all times" in out
    assert "the certificate states no starts" in out


def test_a_file_that_is_no_certificate_is_a_mistake(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "c.json").write_text('{"format": "flexhinf certificate", "version": 1, "gamma": NaN}')
    assert run(["certify", "--check", str(tmp_path / "c.json")]) == 2
    assert "NaN is no number" in capsys.readouterr().err
