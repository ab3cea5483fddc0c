"""The runs behind Figs. 3–12, each made once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.loop import Sine, Step
from flexhinf.paper.bench import Outcome, PaperBench
from flexhinf.paper.growth import in_two_threads

__all__ = ["Experiments", "UncertainRun"]

#: Length of a step response, s.
STEP_DURATION = 8.0
#: Length of the tracking run: two periods of sin(πt/10), s.
TRACKING_DURATION = 40.0
#: Tracking is judged after the start from rest has died out, s.
TRACKING_FROM = 10.0
#: Length of the runs under tolerances, s; slow growth does not show in 8 s.
UNCERTAIN_DURATION = 30.0
PLANTS = 100
#: Samples kept of each of these runs.
SAMPLES = 1500
#: The command of Figs. 11 and 12 comes after 2 s (Sec. 6); the disturbance once the step has settled.
COMMAND_AT, DISTURBED_FROM, DISTURBED_DURATION = 2.0, 6.0, 14.0
#: Size of the disturbance torque, N·m: a fifth of the largest gravity torque. The paper gives none.
TORQUE = 2.0
#: Frequency of the sinusoidal disturbance, Hz. The paper gives none.
FREQUENCY = 0.5


@dataclass(frozen=True)
class UncertainRun:
    """A plant drawn within the tolerances, and what is kept of its run: figures of merit, and some samples.

    Attributes
    ----------
    values : dict of str to float
        Parameters.
    metrics : dict
    diverged_at : float or None
        s.
    time, output, estimate : ndarray
        About `SAMPLES` samples of the link position as measured and as estimated, degrees.
    command : float
        Degrees.
    """

    values: dict[str, float]
    metrics: dict[str, Any]
    diverged_at: float | None
    time: np.ndarray
    output: np.ndarray
    estimate: np.ndarray
    command: float

    @staticmethod
    def of(values: dict[str, float], outcome: Outcome) -> UncertainRun:
        """Keep what is needed of a run."""
        run = outcome.run
        stride = max(1, round(UNCERTAIN_DURATION / run.settings["period"] / SAMPLES))
        kept = [
            np.degrees(run.signal(kind, "link_position")[::stride])
            for kind in ("output", "estimate", "reference")
        ]
        return UncertainRun(
            values,
            outcome.metrics,
            outcome.diverged_at,
            run.time[::stride],
            kept[0],
            kept[1],
            float(kept[2][-1]),
        )


class Experiments:
    """Runs of the laws by name: "nonlinear" (the paper's) and "linear"."""

    #: The command of Figs. 7 and 8, π + sin(πt/10).
    reference_sine = Sine(1.0, 1.0 / 20.0, offset=math.pi)
    tracking_duration = TRACKING_DURATION

    def __init__(self, bench: PaperBench) -> None:
        self.bench = bench
        self.laws: dict[str, Any] = {"nonlinear": bench.nonlinear, "linear": bench.linear}

    def _both(self, reference: Any, duration: float, **options: Any) -> dict[str, Outcome]:
        return {name: self.bench.run(law, reference, duration, **options) for name, law in self.laws.items()}

    @cached_property
    def step_180(self) -> dict[str, Outcome]:
        """Figs. 3 and 4."""
        return self._both(Step(math.pi), STEP_DURATION)

    @cached_property
    def step_90(self) -> dict[str, Outcome]:
        """Figs. 5 and 6."""
        return self._both(Step(math.pi / 2), STEP_DURATION)

    @cached_property
    def tracking(self) -> dict[str, Outcome]:
        """Figs. 7 and 8: π + sin(πt/10)."""
        return self._both(self.reference_sine, TRACKING_DURATION)

    @cached_property
    def uncertain(self) -> list[UncertainRun]:
        """Figs. 9 and 10: plants drawn uniformly within Tables 1 and 2, coil included, 90° step."""
        rng = np.random.default_rng(self.bench.settings.seed)
        drawn = [self.bench.arm.draw(rng) for _ in range(PLANTS)]

        def one(k: int) -> UncertainRun:
            outcome = self.bench.run(
                self.bench.nonlinear,
                Step(math.pi / 2),
                UNCERTAIN_DURATION,
                true_values=drawn[k],
                inductance=True,
                seed=self.bench.seed(k),
            )
            return UncertainRun.of(drawn[k], outcome)

        return in_two_threads(one, range(PLANTS))

    def disturbed(
        self, law: Any, signal: Any, channel: str = "link_torque", estimator: Any = "settings"
    ) -> Outcome:
        """90° commanded after 2 s, then a disturbance torque."""
        command = Step(math.pi / 2, at=COMMAND_AT)
        disturbance = {channel: signal}
        return self.bench.run(law, command, DISTURBED_DURATION, disturbance=disturbance, estimator=estimator)

    @cached_property
    def step_disturbance(self) -> dict[str, Outcome]:
        """Fig. 11, by channel."""
        return {c: self.disturbed(self.bench.nonlinear, Step(TORQUE, at=DISTURBED_FROM), c) for c in CHANNELS}

    @cached_property
    def sine_disturbance(self) -> dict[str, Outcome]:
        """Fig. 12, by channel."""
        wave = Sine(TORQUE, FREQUENCY, at=DISTURBED_FROM)
        return {c: self.disturbed(self.bench.nonlinear, wave, c) for c in CHANNELS}


#: Where a torque can act; the paper does not say.
CHANNELS = ("link_torque", "motor_torque")
