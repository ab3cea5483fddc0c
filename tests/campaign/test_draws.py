"""Which sample is the i-th: intervals, distributions, and that nothing but the seed and i has a part in it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from tests.refusals import refused_with

from flexhinf.campaign import DISTRIBUTIONS, METHODS, FunctionDraw, Sample, Tolerances, Variable, sample_seed
from flexhinf.errors import InvalidInput, NumericalFailure


def numbers(draw, indices, count=64, seed=3):
    return [tuple(one.row().values()) for one in draw.samples(indices, count, seed)]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_a_sample_is_the_same_in_any_company(method, distribution):
    draw = Tolerances([Variable("a", 1.0, 1.2, distribution), Variable("b", -1.0, 3.0, distribution)], method)
    whole = numbers(draw, range(64))
    shuffled = np.random.default_rng(0).permutation(64).tolist()
    assert numbers(draw, shuffled) == [whole[k] for k in shuffled]
    assert [numbers(draw, [k])[0] for k in (0, 1, 63)] == [whole[k] for k in (0, 1, 63)]
    assert len(set(whole)) == (4 if distribution == "corners" else 64)
    assert whole != numbers(draw, range(64), seed=4)


@pytest.mark.parametrize("method", METHODS)
def test_samples_are_distributed_as_stated(method):
    low, high, middle, deviation = 0.9, 1.1, 1.0, 0.1 / 3.0
    laws = {
        "uniform": stats.uniform(low, high - low),
        "normal": stats.norm(middle, deviation),
        "truncated-normal": stats.truncnorm(-3.0, 3.0, middle, deviation),
    }
    draw = Tolerances([Variable(name, low, high, name) for name in laws], method)
    found = np.array(numbers(draw, range(4096), 4096))
    for column, (name, law) in zip(found.T, laws.items()):
        assert stats.kstest(column, law.cdf).pvalue > 1e-4, name
    assert low <= found[:, 2].min() < low + 0.02
    assert found[:, 1].max() > high


def test_corners_are_the_ends_themselves_each_as_often():
    variable = Variable("a", 0.3, 1.7, "corners")
    u = (np.arange(1000) + 0.5) / 1000.0
    found = variable.values(u)
    assert set(found.tolist()) == {0.3, 1.7}
    assert (found == np.where(np.arange(1000) < 500, 0.3, 1.7)).all()
    assert variable.values(np.array([2.0**-54, np.nextafter(0.5, 0.0), 0.5, 1.0 - 2.0**-53])).tolist() == [
        0.3, 0.3, 1.7, 1.7,
    ]  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
def test_every_corner_of_a_box_is_drawn_as_often(method):
    """Exactly for sequences that are evenly spread in two numbers, and within their scatter for independent ones."""
    box = [Variable("a", -1.0, 2.0, "corners"), Variable("b", 5.0, 7.0, "corners")]
    found = numbers(Tolerances(box, method), range(4096), 4096)
    counts = [found.count((a, b)) for a in (-1.0, 2.0) for b in (5.0, 7.0)]
    assert sum(counts) == 4096
    if method == "sobol":
        assert counts == [1024] * 4
    elif method == "latin-hypercube":
        assert counts[0] + counts[1] == counts[0] + counts[2] == 2048
    assert stats.chisquare(counts).pvalue > 1e-4


def test_latin_hypercubes_and_sobol_sequences_are_evenly_spread():
    variables = [Variable("a", 0.0, 1.0), Variable("b", 0.0, 1.0)]
    latin = np.array(numbers(Tolerances(variables, "latin-hypercube"), range(64)))
    assert all(sorted((column * 64).astype(int)) == list(range(64)) for column in latin.T)
    sobol = np.array(numbers(Tolerances(variables, "sobol"), range(64)))
    cells = {tuple(cell) for cell in (sobol * 8).astype(int)}
    assert len(cells) == 64  # one in each square of 8 × 8
    first = numbers(Tolerances(variables, "sobol"), range(64), count=64)
    assert first == numbers(Tolerances(variables, "sobol"), range(64), count=10_000)


def test_a_function_has_a_generator_for_each_sample():
    draw = FunctionDraw(lambda rng: {"mass": rng.uniform(), "gains": rng.normal(size=2)})
    (seventh,) = numbers(draw, [7])
    assert numbers(draw, range(10))[7] == seventh
    assert len(seventh) == 3
    assert [*draw.samples([0], 1, 0)[0].row()] == ["mass", "gains_1", "gains_2"]
    with refused_with(InvalidInput, "parameters", 3.0):
        FunctionDraw(lambda rng: 3.0).samples([0], 1, 0)


def test_seeds_of_the_noise_differ():
    found = {sample_seed(seed, k) for seed in (0, 1, 2**40) for k in range(1000)}
    assert len(found) == 3000
    assert sample_seed(0, 5) == sample_seed(0, 5) < 2**64


def test_a_robot_that_cannot_be_built_is_a_failure_of_its_sample():
    def build(values):
        if values["a"] > 0.5:
            raise NumericalFailure("It falls.", "a", "b")
        return Sample({}, numbers=values)

    found = Tolerances([Variable("a", 0.0, 1.0)], "sobol", build).samples(range(16), 16, 0)
    assert sum("It falls." in one.failure for one in found) == 8


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Variable("a", 1.0, 0.0), "interval"),
        (lambda: Variable("a", 0.0, np.inf), "interval"),
        (lambda: Variable("a", 0.0, 1.0, "gaussian"), "(?s)distribution.*'gaussian'"),
        (lambda: Variable("a", 0.5, 1.5, "normal"), r"(?s)sign.*36\.1 %"),
        (lambda: Tolerances([]), "Nothing differs"),
        (lambda: Tolerances([Variable("a", 0.0, 1.0)] * 2), "variables"),
        (lambda: Tolerances([Variable("a", 0.0, 1.0)], "halton"), "(?s)method.*'halton'"),
        (
            lambda: Tolerances([Variable("a", 0.0, 1.0)], "latin-hypercube").samples([0], 10**9, 0),
            "(?s)memory.*50000000 numbers",
        ),
    ],
)
def test_mistakes_are_told(make, what):
    with pytest.raises(InvalidInput, match=what):
        make()
