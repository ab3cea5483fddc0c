"""The search for the proved step."""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.design.proved_step import search_proved_step
from flexhinf.errors import InvalidInput

ARM = fh.paper_arm()


@pytest.mark.slow
def test_the_smaller_gain_of_two_laws_is_proved_for_a_wanted_step() -> None:
    one = {"tolerances": 0.0, "bandwidths": (1.0,), "dampings": (None,), "step": 1.0, "most_cells": 300_000}
    alone = search_proved_step(ARM, (np.pi,), degrees=(2,), ratios=(2.0,), **one)
    both = search_proved_step(ARM, (np.pi,), degrees=(2, 4), ratios=(1.5, 2.0), **one)
    assert alone.candidates == 2  # of the presets robust and damped
    assert both.candidates > 2
    assert both.gamma < alone.gamma
    for found in (alone, both):
        assert found.certificate is not None
        assert found.certificate.gamma == found.gamma
        assert found.certificate.step_amplitude == found.step == 1.0
        assert found.peak_effort > 5.0


@pytest.mark.slow
def test_the_largest_step_is_the_one_that_the_limit_leaves() -> None:
    few = {"tolerances": 0.0, "bandwidths": (1.0,), "dampings": (None,), "ratios": (1.5,)}
    found = search_proved_step(ARM, (np.pi,), effort_limit=20.0, **few)
    assert 0.3 < found.step < np.pi
    assert 18.0 < found.peak_effort <= 20.0


def test_a_limit_that_no_law_keeps_is_said() -> None:
    with pytest.raises(InvalidInput, match="No step could be proved"):
        search_proved_step(
            ARM, (np.pi,), 3.0, effort_limit=1.0, bandwidths=(1.0,), dampings=(0.4,), ratios=(1.5,)
        )


@pytest.mark.slow
def test_half_a_turn_within_forty_volts_is_proved_for_all_tolerances() -> None:
    found = search_proved_step(
        ARM, (np.pi,), np.pi, effort_limit=40.0, bandwidths=(1.0,), dampings=(0.4,), ratios=(1.5,)
    )
    assert found.peak_effort < 40.0
    assert found.gamma < 550.0
    assert found.certificate is not None
    assert {p.name for p in found.certificate.parameters if p.low < p.high} >= {
        "mass",
        "stiffness",
        "resistance",
    }
