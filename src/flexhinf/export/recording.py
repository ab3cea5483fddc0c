"""A recorded run of a controller: what every sample is given, and what it answers. The C must answer the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.loop import Controller, Loop, Samples

#: What a sample is, by the name of the code that a step in C returns for it.
MEASURED, MISSING, NOT_FINITE = "OK", "PREDICTED", "BAD_MEASUREMENT"

#: Size of the commands' swing about the operating point, in the unit of the tracked states, and its periods, samples.
SWING, PERIODS = 0.05, (97, 61)

#: Largest standard deviation of the noise in a recorded loop, in the unit of the measurement: the swing is to be seen.
LOUDEST = 0.1 * SWING


@dataclass(frozen=True, eq=False)
class Recording:
    """Samples one after the other.

    Attributes
    ----------
    y, r : (K, p), (K, max(1, k)) arrays
        Measurements and commands.
    u, estimate : (K, m), (K, n) arrays
        What the controller answered; what it held where the sample was refused.
    codes : list of str
        "OK", "PREDICTED" or "BAD_MEASUREMENT", one for each sample.
    """

    y: np.ndarray
    r: np.ndarray
    u: np.ndarray
    estimate: np.ndarray
    codes: list[str]


def record(
    controller: Controller,
    samples: int = 200,
    interrupted: bool = True,
    exact: type[np.floating] = np.float64,
) -> Recording:
    """Run a closed loop of the controller and the plant that its estimator believes in, with noise.

    The noise is what the estimator expects: without it, what is measured is what is predicted, and a gain that is wrong
    would not be seen. The plant starts where the estimator believes it, as the design's own step does: started
    elsewhere, the estimate may be so wrong that the inputs stay at their limits, and any code would answer that. The
    commands swing about the operating point; without an estimator there is no plant, and the states swing too.

    Parameters
    ----------
    controller : Controller
        Only read.
    interrupted : bool
        Replay what was measured with samples left out and samples that are not finite.
    exact : type
        Of numbers that hold the measurements and commands as they are.
    """
    time = np.arange(samples)
    rest = controller.operating_reference
    phases = [np.sin(2.0 * np.pi * time / PERIODS[j % 2] + j) - np.sin(j) for j in range(len(rest))]
    r = rest + SWING * np.stack(phases, axis=1) if len(rest) else np.zeros((samples, 0))
    if controller.mode.moving:
        r = np.tile(rest, (samples, 1))
    if controller.estimator is None:
        point = np.asarray(controller.law.operating_point)[: len(controller.states)]
        swings = [np.sin(2.0 * np.pi * time / (40 + 7 * j)) for j in range(len(point))]
        y = point + 0.01 * np.stack(swings, axis=1)
    else:
        y = _measured(controller, r)
    kinds = np.full(samples, MEASURED, dtype=object)
    if interrupted:
        kinds[samples // 3 : samples // 3 + 3] = NOT_FINITE
        if controller.estimator is not None:
            kinds[samples // 2 : samples // 2 + 5] = MISSING
    return replay(controller, y.astype(exact).astype(float), r.astype(exact).astype(float), list(kinds))


def _measured(controller: Controller, r: np.ndarray) -> np.ndarray:
    """What is measured in the loop under these commands, (K, p)."""
    assert controller.estimator is not None
    loop = Loop(controller.estimator.plant, controller)
    time = controller.period * np.arange(len(r))
    reference = {name: Samples(time, column) for name, column in zip(controller.commanded, r.T, strict=True)}
    deviation = np.sqrt(np.diag(np.atleast_2d(controller.estimator.measurement_noise)))
    run = loop.run(
        reference,
        noise=np.minimum(deviation, LOUDEST),
        duration=controller.period * (len(r) - 1),
        initial_state=np.asarray(controller.estimator.initial[0], dtype=float),
    )
    return np.asarray(run.data["output"])[: len(r)]


def replay(controller: Controller, y: np.ndarray, r: np.ndarray, kinds: list[str]) -> Recording:
    """Feed samples to a fresh controller.

    Parameters
    ----------
    controller : Controller
        Only read.
    y, r : (K, p), (K, k) arrays
    kinds : list of str
        As `Recording.codes`: a sample that is missing is predicted over, one that is not finite refused.
    """
    fresh = controller.fresh()
    held = np.asarray(fresh.input_before(), dtype=float)
    inputs, estimates = [], []
    y = np.array(y, dtype=float)
    for k, kind in enumerate(kinds):
        if kind == NOT_FINITE:
            y[k, 0] = np.nan
        try:
            held = fresh.step(None if kind == MISSING else y[k], r[k] if r.shape[1] else None)
        except NumericalFailure:
            if kind != NOT_FINITE:
                raise
        inputs.append(held)
        estimates.append(np.nan_to_num(fresh.estimate))
    r = r if r.shape[1] else np.zeros((len(y), 1))
    return Recording(y, r, np.array(inputs), np.array(estimates), kinds)
