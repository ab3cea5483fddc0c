"""Tables that others have published, to every digit that they print: plants that are maps.

The numbers are those of the sources [nag2019; hipparchus2024; labbe2015]; no code is.
"""

from __future__ import annotations

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.scalars import where

# A robot that sees a wall -----------------------------------------------------------------------------------
#: Wheel radius and distance of the wheels; distance and direction of the wall.
WHEEL, AXLE, WALL, DIRECTION = 3.0, 4.0, 5.814, 0.464

#: Distance to the wall, and direction relative to it in [0, 2π), rad.
SEEN = np.array([
    [5.262, 5.923], [4.347, 5.783], [3.818, 6.181], [2.706, 0.085], [1.878, 0.442], [0.684, 0.836], [0.752, 1.300],
    [0.464, 1.700], [0.597, 1.781], [0.842, 2.040], [1.412, 2.286], [1.527, 2.820], [2.399, 3.147], [2.661, 3.569],
    [3.327, 3.659],
])  # fmt: skip

#: Printed estimates of place and direction.
PRINTED = np.array([
    [0.664, -0.092, 0.104], [1.598, 0.081, 0.314], [2.128, 0.213, 0.378], [3.134, 0.674, 0.660], [3.809, 1.181, 0.906],
    [4.730, 2.000, 1.298], [4.429, 2.474, 1.762], [4.357, 3.246, 2.162], [3.907, 3.852, 2.246], [3.360, 4.398, 2.504],
    [2.552, 4.741, 2.750], [2.191, 5.193, 3.281], [1.309, 5.018, 3.610], [1.071, 4.894, 4.031], [0.618, 4.322, 4.124],
])  # fmt: skip

#: Printed Cholesky factor of the last covariance.
FACTOR = np.array([[1.92e-01, 0.0, 0.0], [-3.82e-01, 2.22e-02, 0.0], [1.58e-06, 2.23e-07, 9.95e-03]])


def rolled(x, u, d, p):
    step = 0.5 * WHEEL * (u[0] + u[1])
    return np.array([
        x[0] + step * np.cos(x[2]), x[1] + step * np.sin(x[2]), x[2] + WHEEL / AXLE * (u[0] - u[1]),
    ])  # fmt: skip


def wall(x):
    return WALL - x[0] * np.cos(DIRECTION) - x[1] * np.sin(DIRECTION)


def wrapped(x, u, p):
    """With the angle of each sigma point in [0, 2π), as the source has it: points on both sides of 0 are 2π apart."""
    angle = x[2] - DIRECTION
    return np.array([wall(x), where(angle < 0.0, angle + 2.0 * np.pi, angle)])


def rolling(angles=(), **options):
    plant = fh.Plant(
        rolled, wrapped, ("x", "y", "heading"), ("right", "left"), outputs=("distance", "angle"), sampled=True,
        angles=angles,
    )  # fmt: skip
    return fh.UnscentedKalmanFilter(plant, 1.0, 0.1**2, 0.01**2, np.zeros(3), 0.1**2, **options)


@pytest.mark.oracle
def test_the_robot_of_the_nag_library():
    """Unscented filter with α = 1, β = 2, κ = 0, points redrawn: half a unit of the last printed digit."""
    estimator, found = rolling(), []
    for y in SEEN:
        estimator.predict([0.4, 0.1])
        estimator.correct(y)
        found.append(estimator.mean)
    np.testing.assert_allclose(found, PRINTED, rtol=0.0, atol=0.5e-3)
    factor = np.linalg.cholesky(estimator.covariance)
    digit = 10.0 ** np.floor(np.log10(np.where(FACTOR, np.abs(FACTOR), 1.0)) - 2)
    assert np.all(np.abs(factor - FACTOR) <= np.where(FACTOR, 0.5 * digit + 1e-15, 1e-12))


@pytest.mark.parametrize("form", ["covariance", "square_root"])
def test_the_same_robot_with_an_angle_that_is_declared(form):
    """In samples 2 to 4 the points stand on both sides of 0. The table then makes almost nothing of the angle, which is
    measured to 0.01 rad; taken round, it is used, and from sample 6 on the headings are the table's."""
    estimator, found = rolling(("angle",), form=form), []
    for y in SEEN:
        estimator.predict([0.4, 0.1])
        estimator.correct(y)
        found.append(estimator.mean)
    headings = np.array(found)[:, 2]
    taken = SEEN[:, 1] + DIRECTION
    taken = np.where(taken > headings + np.pi, taken - 2.0 * np.pi, taken)
    assert np.abs(headings - taken).max() < 0.005
    np.testing.assert_allclose(headings[5:], PRINTED[5:, 2], atol=0.6e-3)
    assert np.abs(PRINTED[1:4, 2] - taken[1:4]).max() > 0.3


# A radar -----------------------------------------------------------------------------------------------------
#: Range, then estimates of distance, speed and altitude, and their variances, every 0.05 s.
RADAR_TEXT = """
    1019.2851403143188 4.198880013117499 89.984981541555 1026.5764510059782
        100.2584710543232 100.0099961966309 9.105865858725991
    1003.6445644566753 8.117491918356489 89.90532419962135 1015.6132309630719
        101.00632768285901 100.01976731979332 4.780492945058362
    1004.3751289594502 12.102292492831165 89.80063635761768 1011.9441757838554
        102.23643332825336 100.02851314849345 3.2499533560697795
    1002.2116390787031 15.933756987066364 89.62569050936868 1009.5224345352507
        103.9374460652571 100.03439047789192 2.4699538550079883
    1012.8449495874852 20.685119483881703 89.71261768899848 1010.1236408863986
        106.09852553124091 100.03434604711784 1.9994897548996944
    1017.2857822715997 25.984222380054124 90.0100254664188 1011.2367281963682
        108.68150166369708 100.02134028927115 1.6872416516736968
    1000.980682694816 28.783612645918154 89.32450842179114 1009.7267046691713
        111.63854936240512 99.98393905513517 1.467245507098981
    989.4957584332219 29.63179609395399 87.6943606333458 1007.1726488596605
        115.02961623949834 99.9236747833634 1.304764465535238
    988.6824893110849 30.716307624932632 86.02833914181528 1005.0854542572146
        118.91426737777074 99.84786515684641 1.180085232549437
    999.4492618626533 33.89676526725081 85.41142494222974 1004.4653487786428
        123.26512019968442 99.75096687211195 1.0820781356739677
"""
RADAR = np.array(RADAR_TEXT.split(), dtype=float).reshape(-1, 7)


@pytest.mark.oracle
@pytest.mark.filterwarnings("ignore:The central covariance weight")
def test_the_radar_of_filterpy_and_hipparchus():
    """Points that are not redrawn, and α = 1e-3. Weights of 1e6 then leave the source ten digits of a range of 1000."""
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[0] + 0.05 * x[1], x[1], x[2]]),
        lambda x, u, p: np.array([np.sqrt(x[0] ** 2 + x[2] ** 2)]),
        ("distance", "speed", "altitude"), ("none",), outputs=("range",), sampled=True,
    )  # fmt: skip
    estimator = fh.UnscentedKalmanFilter(
        plant, 0.05, 0.01, 10.0, [0.0, 90.0, 1100.0], 100.0, alpha=1e-3, beta=2.0, kappa=0.0, redraw=False
    )
    for y, *expected in RADAR:
        estimator.predict([0.0])
        estimator.correct([y])
        np.testing.assert_allclose(estimator.mean, expected[:3], rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(np.diag(estimator.covariance), expected[3:], rtol=1e-7)
