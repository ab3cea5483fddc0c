"""The filter of the controller for a workspace: its gains, where it is stable, what it cannot estimate."""

from __future__ import annotations

import ast
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are
from tests.designs.test_workspace_controller import AWAY, BOTH, UNLIKE, arm, made
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.designs.workspace.design import check_loop
from flexhinf.designs.workspace.setup import WorkspaceSetup
from flexhinf.errors import InvalidInput
from flexhinf.robot.workspace import workspace_of


def test_the_filter_has_the_same_gains_wherever_it_starts() -> None:
    setup, x = made(), arm().operating_point(AWAY)[0]
    gains = [setup.estimator(np.array(at)).gain(x) for at in ((0.0, 0.0), AWAY, (0.3, 2.0))]
    assert gains[1] == pytest.approx(gains[0], rel=1e-12)
    assert gains[2] == pytest.approx(gains[0], rel=1e-12)


@pytest.mark.quick_cases(3)
@pytest.mark.parametrize(("name", "periods"), [("planar-two-link", (5e-4, 2e-3, 5e-3)), ("scara", (2e-3,))])
@pytest.mark.parametrize("measured", [BOTH, ("link_position",), ("motor_position", "joint_torque")])
def test_the_filter_is_stable_at_any_period(
    name: str, periods: tuple[float, ...], measured: tuple[str, ...]
) -> None:
    """(1 − L H) F by SciPy's exponential: also where the sampling would fold the fastest λ that gains are made for."""
    law = made(name).law
    for period in periods:
        s = fh.Specification(workspace="limits", measured=measured, period=period)
        setup = WorkspaceSetup(arm(name), s, workspace_of(arm(name), "limits"), law)
        estimator = setup.estimator(np.array(arm(name).home))
        for pose in setup.workspace.sample(8, 2):
            x, u = arm(name).operating_point(pose)
            a, _, _, c = setup.model.linearise(x, u)
            error = expm(a * period) @ (np.eye(len(a)) - estimator.gain(x) @ c)
            assert np.abs(np.linalg.eigvals(error)).max() < 0.9995


def test_what_cannot_be_estimated_is_refused() -> None:
    for sensors in ("joint_torque", "link_velocity"):
        with refused_with(InvalidInput, "link_position", "motor_position"):
            made(measured=(sensors,)).estimator(np.zeros(2))
    s = fh.Specification(measured=("joint_torque", "link_position_shoulder"))
    with refused_with(InvalidInput, "elbow") as refusal:
        check_loop(arm(), s)
    measured = ast.literal_eval(str(refusal.value).split("try:")[1].strip().removeprefix("measured="))
    check_loop(arm(), replace(s, measured=measured))


@pytest.mark.ci("steps of a filter in Python")
@pytest.mark.oracle
@pytest.mark.parametrize(
    "measured", [UNLIKE, ("joint_torque", "link_position_shoulder", "motor_position_elbow")]
)
def test_the_filter_of_joints_with_different_sensors_is_the_kalman_filter_of_each_pose(
    measured: tuple[str, ...],
) -> None:
    """SciPy's Riccati equation at home and away; the filter that runs comes to its gain from that of home."""
    setup = made(measured=measured)
    estimator, period = setup.estimator(np.array(AWAY)), setup.specification.period
    q, r = estimator.process_noise, estimator.measurement_noise
    noises = q if q.ndim == 2 else np.diag(q), r if r.ndim == 2 else np.diag(r)
    covariances = []
    for pose in (arm().home, AWAY):
        x, u = arm().operating_point(pose)
        a, _, _, c = setup.model.linearise(x, u)
        covariances.append(solve_discrete_are(expm(a * period).T, c.T, *noises))
    home, away = covariances
    assert np.allclose(estimator.initial.covariance, home, rtol=1e-6, atol=1e-6 * np.abs(home).max())
    gain = away @ c.T @ np.linalg.inv(c @ away @ c.T + noises[1])
    assert np.allclose(setup._filter_gain(x, u), gain, rtol=1e-6, atol=1e-9)
    y = np.asarray(setup.model.traced_output(x, u, setup.model.parameters.vector()), dtype=float).ravel()
    for _ in range(2000):
        estimator.correct(y)
        estimator.predict(u)
    error = np.abs(estimator.covariance - away).max(axis=1) / np.abs(away).max(axis=1)
    assert error.max() < 1e-3 < (np.abs(home - away).max(axis=1) / np.abs(away).max(axis=1)).max()
