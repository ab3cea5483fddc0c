"""What an interface of velocities, positions or torques can damp: the best law of one vibration, over periods, delays
and drives.

    python -m benchmarks.interfaces --table          the table of docs/real_loop.md, in a minute
    python -m benchmarks.interfaces --table choice   that of docs/drives.md: with drives of 20 Hz, and what to write

One pair of link and motor, z″ = λ(w − z), w″ = −βw′ − νw + νc or βc: a drive that rejects its load; or of torques
w″ = λ(z − w + c), a motor as heavy as its link. The law is a discrete linear-quadratic regulator with the integral of
the link's error; it knows the state, and the inputs that are still on their way. Of many weights the one with the
largest damping of the link's vibration is kept, among those that one more sample of delay, and half and twice the gain,
leave stable.
"""

from __future__ import annotations

import argparse
import itertools
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from flexhinf.arrays import Matrix

#: Bandwidths of the drives and vibrations, Hz; damping of the position loop, as servo drives are tuned.
DRIVES, VIBRATIONS, DRIVE_DAMPING = (5.0, 20.0, 60.0), (5.0, 10.0, 20.0, 40.0), 0.9

#: Weights of the input and of the link's speed that are tried.
EFFORTS, SPEEDS = np.geomspace(1e-6, 1e4, 31), (0.0, 0.3, 1.0)

#: Bandwidth of a usual drive, Hz.
USUAL = 20.0

#: What damps less than this damps nothing.
NOTHING = 0.05


class Interface(NamedTuple):
    """Kind of the command, period, s, and samples from a measurement to the command that acts."""

    kind: str
    period: float
    late: int

    @property
    def name(self) -> str:
        """Kind and rate."""
        rate = 1.0 / self.period
        return f"{self.kind}, {f'{rate / 1e3:g} kHz' if rate >= 1e3 else f'{rate:g} Hz'}"


INTERFACES = (
    Interface("torque", 0.125e-3, 1), Interface("torque", 1e-3, 1),
    Interface("velocity", 1e-3, 1), Interface("velocity", 4e-3, 2), Interface("velocity", 8e-3, 2),
    Interface("position", 2e-3, 2), Interface("position", 4e-3, 2), Interface("position", 8e-3, 2),
)  # fmt: skip


def pair(kind: str, vibration: float, bandwidth: float) -> tuple[Matrix, Matrix]:
    """State matrix (4, 4) and input matrix (4, 1) of (z, z′, w, w′); vibration and bandwidth in rad/s."""
    beta, nu = (bandwidth, 0.0) if kind == "velocity" else (2.0 * DRIVE_DAMPING * bandwidth, bandwidth**2)
    a = np.zeros((4, 4))
    a[0, 1] = a[2, 3] = 1.0
    a[1, 0], a[1, 2] = -(vibration**2), vibration**2
    if kind == "torque":
        a[3, 0], a[3, 2] = vibration**2, -(vibration**2)
        return a, np.array([[0.0], [0.0], [0.0], [vibration**2]])
    a[3, 2], a[3, 3] = -nu, -beta
    return a, np.array([[0.0], [0.0], [0.0], [beta if kind == "velocity" else nu]])


def sampled(a: Matrix, b: Matrix, period: float, late: int) -> tuple[Matrix, Matrix]:
    """The same in samples, with the integral of z and the inputs that are on their way as states."""
    held = expm(np.block([[a, b], [np.zeros((1, 5))]]) * period)
    f, g = np.zeros((5 + late, 5 + late)), np.zeros((5 + late, 1))
    f[:4, :4], f[4, 4], f[4, 0] = held[:4, :4], 1.0, period
    if late:
        f[:4, 5:6], g[-1] = held[:4, 4:], 1.0
        f[5:-1, 6:] = np.eye(late - 1)
    else:
        g[:4] = held[:4, 4:]
    return f, g


def least_damping(poles: np.ndarray, period: float, vibration: float) -> float:
    """The least damping ratio of poles in samples about a vibration, rad/s; 1 where none vibrates."""
    s = np.log(poles[np.abs(poles) > 1e-9].astype(complex)) / period
    near = s[(np.abs(s.imag) > 1e-3) & (np.abs(s) > 0.3 * vibration) & (np.abs(s) < 3.0 * vibration)]
    return float(np.min(-near.real / np.abs(near), initial=1.0))


def best_damping(interface: Interface, vibration: float, bandwidth: float) -> float:
    """The largest damping ratio that a robust law gives, 0 where there is none."""
    a, b = pair(interface.kind, vibration, bandwidth)
    (f, g), (later_f, later_g) = (sampled(a, b, interface.period, interface.late + more) for more in (0, 1))
    best = 0.0
    for effort, speed in itertools.product(EFFORTS, SPEEDS):
        weights = np.zeros(len(f))
        weights[[0, 1, 4]] = 1.0, speed / vibration**2, (0.1 * vibration) ** 2
        try:
            cost = solve_discrete_are(f, g, np.diag(weights), np.array([[effort]]))
        except LinAlgError:  # no law for these weights
            continue
        gain = np.linalg.solve(g.T @ cost @ g + effort, g.T @ cost @ f)
        unaware = np.hstack([gain[:, :5], [[0.0]], gain[:, 5:]])  # of one more sample of delay
        loops = [later_f - later_g @ unaware, *(f - share * g @ gain for share in (0.5, 2.0))]
        if max(np.abs(np.linalg.eigvals(loop)).max() for loop in loops) < 1.0:
            poles = np.linalg.eigvals(f - g @ gain)
            best = max(best, least_damping(poles, interface.period, vibration))
    return best


def interface_table() -> str:
    """Largest damping ratios as Markdown: a row for each interface, a column for each vibration."""
    rows = ["| interface | " + " | ".join(f"{hertz:g} Hz" for hertz in VIBRATIONS) + " |", "|---" * 5 + "|"]
    for interface in INTERFACES:
        drives = (USUAL,) if interface.kind == "torque" else DRIVES
        cells = [_cell(interface, hertz, drives) for hertz in VIBRATIONS]
        rows.append(f"| {interface.name}, {interface.late} late | {' | '.join(cells)} |")
    return "\n".join(rows)


def choice_table() -> str:
    """The same of usual interfaces with drives of `USUAL`: a row for each vibration."""
    usual = [one for one in INTERFACES if one.kind != "velocity" or one.late == 1]
    rows = [f"| vibration | {' | '.join(one.name for one in usual)} |", "|---" * (1 + len(usual)) + "|"]
    for hertz in VIBRATIONS:
        rows.append(f"| {hertz:g} Hz | {' | '.join(_cell(one, hertz, (USUAL,)) for one in usual)} |")
    return "\n".join(rows)


def _cell(interface: Interface, hertz: float, drives: tuple[float, ...]) -> str:
    found = [best_damping(interface, 2.0 * np.pi * hertz, 2.0 * np.pi * drive) for drive in drives]
    return ", ".join(f"{ratio:.2f}" for ratio in found) if max(found) >= NOTHING else "nothing"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--table", nargs="?", const="whole", choices=["whole", "choice"], default="whole")
    print(choice_table() if parser.parse_args().table == "choice" else interface_table())


if __name__ == "__main__":
    main()
