"""What a campaign adds to a design: how many robots, and how they are sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexhinf.design.options import (
    ADVANCED,
    HARDWARE,
    RUN,
    SAMPLED,
    Duration,
    Real,
    Text,
    Whole,
    option,
    spaced,
)
from flexhinf.errors import InvalidInput
from flexhinf.validation import value_text


@dataclass(frozen=True)
class CampaignOptions:
    """What a campaign adds to a design; every field but `tolerances` is an option of ``flexhinf campaign``."""

    # fmt: off
    samples: Whole = option(1000, SAMPLED, "How many robots.", "1000")
    seed: Whole = option(0, ADVANCED, "Sample i depends on it and on i alone.", "0")
    batch: Whole = option(256, ADVANCED, "Samples of a file of the journal: what SIGKILL may cost.", "256")
    distribution: Text = option("uniform", SAMPLED,
        "Within the tolerances: uniform, normal (the tolerance is 3σ), truncated-normal, corners.", "normal")
    method: Text = option("random", SAMPLED,
        "How samples are spread: random (independent), latin-hypercube, sobol.", "sobol")
    #: Parameters of the robot and what they are instead: ``("stiffness", "15%")`` or ``("mass", "0.9..1.2")``.
    tolerances: tuple[tuple[str, str], ...] = ()
    payload: Text | None = option(None, HARDWARE,
        "What the true robot carries, 0..2kg; the controller stays the design's.", "0..2kg", "kg@link",
        default="that of the design")
    initial_error: Real = option(0.0, SAMPLED,
        "The robot starts up to so much beside where the estimator believes it, rad or m.", "0.01", "rad, m")
    disturbance: Real = option(0.0, SAMPLED,
        "A constant torque on each link of up to so much, N·m or N, from a tenth of the run on.", "0.1", "N·m or N")
    duration: Duration | None = option(None, RUN, "Length of a run.", "5s", "s", zero="the default",
        default="that of the design")
    # fmt: on

    def __post_init__(self) -> None:
        from flexhinf.campaign import (  # not for `flexhinf --help`
            DISTRIBUTIONS,
            METHODS,
            check_counts,
            one_of,
        )

        check_counts(self.samples, self.seed, self.batch)
        one_of("distribution", self.distribution, DISTRIBUTIONS)
        one_of("method", self.method, METHODS)
        for name in ("initial_error", "disturbance"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                found = f"expected a number >= 0, the half width of its interval, got {value_text(value)}"
                raise InvalidInput(f"The {spaced(name)} is not usable.", found, "0.01")
