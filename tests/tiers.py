"""Cases of one test in two tiers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest


def ci_and_night(why: str, ci: Sequence[Any], night: Sequence[Any]) -> list[Any]:
    """For `parametrize`: cases of `make ci`, and others or larger ones of `make nightly`, each with why it costs so."""
    tiers = ((pytest.mark.ci(why), ci), (pytest.mark.nightly(why), night))
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=mark)
        for mark, cases in tiers
        for case in cases
    ]
