from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are
from tests.builders import LinearLaw

from flexhinf.estimation import UnscentedKalmanFilter
from flexhinf.hinf import solve_hji
from flexhinf.plant import Plant
from flexhinf.robot import load_robot, paper_arm

#: Sampling period of `plain_loop`, s.
H = 1e-2


def arm_law(pose=None):
    """LQR of the paper's weights about a pose."""
    problem = paper_arm().problem(pose=pose)
    a = np.zeros((5, 5))
    plant, point, rest = problem.plant, problem.operating_point, problem.operating_input
    a[:4, :4], b, _, _ = plant.linearise(point[:4], rest)
    a[4, 0] = 1.0
    b = np.vstack([b, [[0.0]]])
    riccati = solve_continuous_are(a, b, np.diag([3600.0, 0.0, 0.0, 0.0, 90000.0]), [[10.0]])
    return LinearLaw(problem.state_names, problem.input_names, -b.T @ riccati / 10.0, point, rest)


def arm_ukf(period=1e-3, **changes):
    settings = {"process_noise": 1e-8, "measurement_noise": 1e-6, "mean": np.zeros(4), "covariance": 1e-4}
    return UnscentedKalmanFilter(plant=paper_arm().plant(), period=period, **{**settings, **changes})


def two_inputs():
    """Two double integrators, the second without an integral, each measured."""
    plant = Plant(
        lambda x, u, d, p: np.array([x[1], u[0] + d[0], x[3], p.gain * u[1]]),
        lambda x, u, p: np.array([x[0], x[2]]),
        ("a", "da", "b", "db"), ("ua", "ub"), ("push",), {"gain": 2.0},
    )  # fmt: skip
    gain = [[-8.0, -5.0, 0.5, 0.0, -4.0], [0.0, 0.0, -3.0, -2.0, 0.0]]
    return plant, LinearLaw(("a", "da", "b", "db", "a_integral"), plant.inputs, gain)


def moving_commands(times, size=1.0):
    """(x_d, u_d) of `two_inputs`: a moves as a sine, b as another; u_d is their feedforward."""
    a, b = size * np.sin(1.3 * times), 0.5 * np.cos(2.1 * times)
    da, db = 1.3 * size * np.cos(1.3 * times), -1.05 * np.sin(2.1 * times)
    return np.stack([a, da, b, db, -1.69 * a, -4.41 * b / 2.0], axis=-1)


def exact_step(x, u, push):
    """`two_inputs` between two samples: constant accelerations."""
    rate = np.array([u[0] + push, 2.0 * u[1]])
    x = x + H * np.array([x[1], rate[0], x[3], rate[1]])
    return x + 0.5 * H**2 * np.array([rate[0], 0.0, rate[1], 0.0])


def taken_back(column, excess, limit):
    """What anti-windup takes from the one integral: a fifth of the excess of the input that it moves most."""
    own = np.argmax(np.abs(column) / (limit if np.isfinite(limit).all() else 1.0))
    return 0.2 * excess[own] / column[own]


def plain_loop(
    laws,
    commands,
    x,
    *,
    moving=False,
    limit=np.inf,
    bumpless=False,
    last=None,
    blend_time=0.5,
    hysteresis=0.1,
    push=0.0,
):
    """The sampled loop of `two_inputs` in plain NumPy: states, inputs and active laws.

    `laws` are `LinearLaw` with one integral, of the first state. At a take-over the integral is the least-squares
    solution of u* + K (x − x*, e) = u_last, and the rest of the misfit is a bias that fades.
    """
    last = np.array(laws[0].operating_input if last is None else last, dtype=float)
    integral, bias, active, before = 0.0, np.zeros(2), None, None
    states, inputs, actives = [], [], []
    for r in commands:
        goal = r[0]
        apart = np.array([abs(law.operating_point[0] - goal) for law in laws])
        nearest, taken = int(np.argmin(apart)), False
        if active is None:
            active, taken = nearest, bumpless
        elif apart[nearest] < (1.0 - hysteresis) * apart[active]:
            active, taken = nearest, nearest != active
        law = laws[active]
        point = np.append(r[:4], law.operating_point[4]) if moving else law.operating_point
        rest = r[4:] if moving else law.operating_input
        growth = 0.0
        if before is not None:
            growth = H * (0.5 * (before[0] + x[0]) - (0.5 * (before[1] + goal) if moving else before[1]))
        bias = bias * np.exp(-H / blend_time)
        if taken:
            misfit = last - rest - law.gain[:, :4] @ (x - point[:4])
            error = np.linalg.lstsq(law.gain[:, 4:], misfit, rcond=None)[0][0]
            bias = misfit - law.gain[:, 4] * error
            integral, growth = error + point[4], 0.0
        wanted = rest + law.gain @ (np.append(x, integral + growth) - point) + bias
        u = np.clip(wanted, -limit, limit)
        integral += growth - taken_back(law.gain[:, 4], wanted - u, limit)
        states.append(x)
        inputs.append(u)
        actives.append(active)
        before, last = (x[0], goal), u
        x = exact_step(x, u, push)
    return np.array(states), np.array(inputs), np.array(actives)


@pytest.fixture(scope="session")
def made():
    """What the tests of closed loops are made of."""
    return SimpleNamespace(
        exact_step=exact_step,
        LinearLaw=LinearLaw,
        law=arm_law(),
        law_about=arm_law,
        ukf=arm_ukf,
        two_inputs=two_inputs,
        plain_loop=plain_loop,
        taken_back=taken_back,
    )


@pytest.fixture(scope="session")
def seven():
    """The catalogue's arm, its law of degree 3 in 35 states, and a filter that needs one sub-step."""
    robot = load_robot("seven-link")
    plant, (point, rest) = robot.plant(), robot.operating_point()
    solution = solve_hji(robot.problem(), gamma=700.0, degree=4)

    def estimator(kind=UnscentedKalmanFilter, period=2e-4):
        return kind(plant, period, 1e-9, 1e-7, point, 1e-6)

    return solution, estimator, point, rest
