"""Kernels are linked in a process whose address space is full of large arrays and small holes.

A linker that takes memory wherever there is some puts code and constants more than 2 GB apart there, and aborts the
process.
"""

import os
import subprocess
import sys

import pytest

SCRIPT = """
import mmap
import numpy as np
import flexhinf as fh

arm = fh.paper_arm()
problem = arm.problem()
gamma = 2 * fh.smallest_gamma(problem)
law = fh.solve_hji(problem, gamma, 4)
fh.Loop(arm.plant(), fh.Controller(law, None)).run(fh.Step(1.0), duration=0.01)
pages = [mmap.mmap(-1, 4096) for _ in range(400)]
for page in pages[::2]:
    page.close()
arrays = [np.empty(100_000_000) for _ in range(8)]  # 6.4 GB that are never touched
ukf = fh.UnscentedKalmanFilter(arm.plant(), 1e-3, 1e-6, 1e-6, np.zeros(4), 1e-4)
for degree in (4, 6):
    law = fh.solve_hji(problem, gamma, degree)
    loop = fh.Loop(arm.plant(inductance=True), fh.Controller(law, ukf))
    loop.run(fh.Step(1.0), duration=0.05)
print("fine")
"""


@pytest.mark.ci("compiles two loops in a process of its own")
def test_kernels_are_linked_in_a_process_with_large_arrays(tmp_path):
    environment = {**os.environ, "FLEXHINF_CACHE": str(tmp_path)}
    outcome = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=environment, check=False
    )
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.strip() == "fine"
