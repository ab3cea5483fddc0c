"""γ* against python-control's `hinfsyn`, which wants a noisy measurement: y = x + ε n, in the limit ε → 0.

Run in a process of its own with one thread: the library below it brings a linear algebra that loses a factor
of two hundred on matrices of this size when it starts threads on a busy machine.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from flexhinf.hinf.gamma import linear_smallest_gamma
from flexhinf.hinf.linear_part import LinearPart

pytest.importorskip("slycot", reason="slycot, which control's hinfsyn needs, has no wheel for this machine")
pytest.importorskip("control")

_SCRIPT = """
import json, sys
import control, numpy as np
a, b1, b2, c, levels = (np.array(part) for part in json.load(sys.stdin))
n, (md, m), s = len(a), (b1.shape[1], b2.shape[1]), len(c)
found = []
for level in levels:
    inputs = np.hstack([b1, np.zeros((n, n)), b2])  # d, noise, u
    outputs = np.vstack([c, np.zeros((m, n)), np.eye(n)])  # h, u, y
    direct = np.zeros((s + m + n, md + n + m))
    direct[s : s + m, md + n :], direct[s + m :, md : md + n] = np.eye(m), level * np.eye(n)
    found.append(control.hinfsyn(control.ss(a, inputs, outputs, direct), n, m)[2])
print(json.dumps(found))
"""


def _hinfsyn(linear: LinearPart, levels: list[float]) -> np.ndarray:
    data = [part.tolist() for part in (linear.a, linear.b1, linear.b2, linear.c)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT],
        input=json.dumps([*data, levels]), env=environment, check=True, capture_output=True, text=True,
    )  # fmt: skip
    return np.array(json.loads(done.stdout))


@pytest.mark.oracle
@pytest.mark.parametrize("pose", ["hanging", "upright"])
def test_limit_of_vanishing_noise_is_our_level(arm, pose):
    """The excess is proportional to ε; extrapolated from two levels it agrees to 1e-7."""
    linear = LinearPart.of(arm.expand(1))
    if pose == "upright":
        a = linear.a.copy()
        a[1, 0] += 2 * 9.8
        linear = LinearPart(a, linear.b1, linear.b2, linear.c, linear.state_names)
    expected = linear_smallest_gamma(linear)
    coarse, fine = _hinfsyn(linear, [1e-3, 1e-4])
    assert coarse / expected - 1 == pytest.approx(1.4e-3, rel=0.5)
    assert fine / expected - 1 == pytest.approx((coarse / expected - 1) / 10, rel=1e-2)
    assert (10 * fine - coarse) / 9 == pytest.approx(expected, rel=1e-7)
