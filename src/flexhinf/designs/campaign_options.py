"""Options of a campaign, which command line and Python take, beside those of its design."""

from __future__ import annotations

from dataclasses import dataclass

from flexhinf.options import (
    ADVANCED,
    RUN,
    SEARCH,
    UNCERTAIN,
    Duration,
    NotNegative,
    Text,
    Whole,
    declared,
    option,
)  # fmt: skip
from flexhinf.validation import one_of


@dataclass(frozen=True)
class CampaignOptions:
    """Options that a campaign adds to a design; every field but `tolerances` is an option of ``flexhinf campaign``."""

    # fmt: off
    samples: Whole = option(1000, SEARCH, "Number of robots.", "1000")
    seed: Whole = option(0, ADVANCED, "Seed of the samples; sample i depends on it and on i alone.", "0")
    batch: Whole | None = option(None, ADVANCED,
        "Samples in one file of the journal. A kill loses at most so many.", "256",
        default="256, up to 4,096 of short runs")
    distribution: Text = option("uniform", UNCERTAIN,
        "How parameters vary within their tolerances: uniform, normal (the tolerance is 3σ), truncated-normal, "
        "corners.", "normal")
    method: Text = option("random", ADVANCED,
        "How samples are spread: random (independent), latin-hypercube, sobol.", "sobol")
    #: Parameters of the robot and what they are instead: ``("stiffness", "15%")`` or ``("mass", "0.9..1.2")``.
    tolerances: tuple[tuple[str, str], ...] = ()
    payload: Text | None = option(None, UNCERTAIN,
        "What the true robot carries, such as 0..2kg. The controller stays that of the design.", "0..2kg", "kg@link",
        default="that of the design")
    initial_error: NotNegative = option(0.0, UNCERTAIN,
        "Largest error of the estimator's position at the start.", "0.01", "rad, m")
    disturbance: NotNegative = option(0.0, UNCERTAIN,
        "Largest constant torque on each link. It begins after a tenth of the run.", "0.1", "N·m or N")
    encoder_offset: NotNegative = option(0.0, UNCERTAIN,
        "Largest offset of each position sensor. Of a design for a workspace.", "0.0005", "rad, m")
    extra_delay: Whole = option(0, UNCERTAIN,
        "Largest delay of the inputs that the controller does not know, in samples. Of a design for a workspace.", "1")
    duration: Duration | None = option(None, RUN, "Length of a run. Of a design of one pose.", "5s", "s",
        zero="the default", default="that of the design")
    # fmt: on

    def __post_init__(self) -> None:
        from flexhinf.campaign import DISTRIBUTIONS, METHODS, check_counts  # not for `flexhinf --help`

        check_counts(self.samples, self.seed, 1 if self.batch is None else self.batch)
        one_of("There is no such distribution.", self.distribution, DISTRIBUTIONS)
        one_of("There is no such method.", self.method, METHODS)
        for name in ("initial_error", "disturbance", "encoder_offset", "extra_delay"):
            object.__setattr__(self, name, declared(CampaignOptions)[name].read(getattr(self, name)))
