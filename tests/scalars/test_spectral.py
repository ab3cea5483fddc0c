"""Jacobi's eigensystem against LAPACK's: on numbers, batches, symbols, and as a loop of a compiled program."""

import numpy as np
import pytest

from flexhinf.codegen import DIRECT, Block, Buffer, Composer, Program, Slice, compile_program
from flexhinf.scalars import apply, trace
from flexhinf.scalars.spectral import damping_ratio, eigensystem


def matrices(n, count, kind, rng):
    """Random symmetric matrices (count, n, n) with eigenvalues spread, over four decades, in pairs, or in a cluster."""
    spectra = {
        "near": rng.uniform(1.0, 2.0, (count, n)),
        "decades": 10.0 ** rng.uniform(2.6, 6.6, (count, n)),
        "pairs": np.repeat(rng.uniform(1.0, 1e4, (count, (n + 1) // 2)), 2, axis=1)[:, :n]
        * (1.0 + 1e-9 * rng.normal(size=(count, n)) * (np.arange(count) % 2)[:, None]),
        "cluster": 1.0 + 1e-6 * rng.normal(size=(count, n)),
        "signs": rng.normal(size=(count, n)),
    }[kind]
    q = np.linalg.qr(rng.normal(size=(count, n, n)))[0]
    made = q * spectra[:, None] @ q.transpose(0, 2, 1)
    return (made + made.transpose(0, 2, 1)) / 2.0


@pytest.mark.quick_cases(13)
@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["near", "decades", "pairs", "cluster", "signs"])
@pytest.mark.parametrize("n", range(1, 9))
def test_it_is_that_of_lapack(n, kind):
    given = matrices(n, 500, kind, np.random.default_rng(n))
    v, values = eigensystem(given, DIRECT)
    expected = np.linalg.eigvalsh(given)
    size = np.abs(expected).max(axis=1)
    np.testing.assert_allclose(np.sort(values) / size[:, None], expected / size[:, None], atol=1e-14)
    np.testing.assert_allclose(v.transpose(0, 2, 1) @ v, np.broadcast_to(np.eye(n), v.shape), atol=1e-14)
    again = v * values[:, None] @ v.transpose(0, 2, 1)
    np.testing.assert_allclose(again / size[:, None, None], given / size[:, None, None], atol=1e-9)


@pytest.mark.parametrize("given", [np.zeros((3, 3)), np.eye(4), np.diag([3.0, 1.0, 2.0, 2.0, 1e-300])])
def test_what_is_diagonal_stays(given):
    v, values = eigensystem(given, DIRECT)
    np.testing.assert_array_equal(v, np.eye(len(given)))
    np.testing.assert_array_equal(values, np.diag(given))


@pytest.mark.parametrize("n", [2, 5])
def test_symbols_are_numbers(n):
    given = matrices(n, 1, "decades", np.random.default_rng(0))[0]
    function = trace(lambda m: eigensystem(m, DIRECT), (n, n))
    v, values = eigensystem(given, DIRECT)
    found = apply(function, given)
    np.testing.assert_allclose(found[0].reshape(n, n), v, atol=1e-12)
    np.testing.assert_allclose(found[1], values, rtol=1e-12)


@pytest.mark.parametrize("n", [3, 7])
def test_a_program_runs_one_round_in_a_loop(n):
    run = Composer()
    v, values = eigensystem(Block(Slice("m", 0, n * n), (n, n)), run)
    for result, name in ((v, "v"), (values, "l")):
        run.copy(result, Block(Slice(name, 0, result.size), result.shape))
    buffers = (Buffer("m", n * n, "in"), Buffer("v", n * n, "out"), Buffer("l", n, "out"), *run.buffers)
    program = Program("spectral", buffers, tuple(run.body))
    given = matrices(n, 1, "decades", np.random.default_rng(1))[0]
    arrays = {"m": given.reshape(-1, 1).copy(), "v": np.zeros((n * n, 1)), "l": np.zeros((n, 1))}
    assert compile_program(program, 1).run(arrays).fine
    expected_v, expected = eigensystem(given, DIRECT)
    np.testing.assert_allclose(arrays["v"].reshape(n, n), expected_v, atol=1e-12)
    np.testing.assert_allclose(arrays["l"][:, 0], expected, rtol=1e-12)
    functions = [step.function for step in run.body if hasattr(step, "function")]
    loop = next(step for step in run.body if hasattr(step, "body"))
    operations = sum(
        f.n_instructions() for f in (*functions, *(s.function for s in loop.body if hasattr(s, "function")))
    )
    assert operations < 110 * n  # one round of n // 2 rotations, not all of them


@pytest.mark.parametrize("place", [(0, 0), (0, 1), (1, 2)])
def test_where_the_matrix_is_nan_all_eigenvalues_are(place):
    given = np.diag([3.0, 1.0, 2.0])
    given[place] = given[place[::-1]] = np.nan
    assert np.isnan(eigensystem(given, DIRECT)[1]).all()
    assert np.isnan(apply(trace(lambda m: eigensystem(m, DIRECT)[1], (3, 3)), given)[0]).all()


def test_the_damping_ratio_of_nan_is_nan():
    np.testing.assert_array_equal(damping_ratio(np.array([np.nan, 0.0, -1.0])), [np.nan, 0.0, 1.0])
