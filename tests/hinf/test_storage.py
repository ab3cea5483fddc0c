"""Solutions in files."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.hinf import load_solution, smallest_gamma, solve_hji

X = np.random.default_rng(0).standard_normal((4, 5))


@pytest.fixture(scope="module")
def solved(arm):
    return solve_hji(arm, 2 * smallest_gamma(arm), 4)


def test_polynomial_plant_comes_back_whole(arm, tmp_path):
    solution = solve_hji(arm.expand(7), math.inf, 4)
    path = tmp_path / "law.solution"
    solution.save(path)
    loaded = load_solution(path)
    assert [p.name for p in tmp_path.iterdir()] == ["law.solution"]
    for function in ("value", "gradient", "law", "worst_disturbance", "residual"):
        assert np.array_equal(getattr(loaded, function)(X), getattr(solution, function)(X))
    assert (loaded.gamma, loaded.degree, loaded.state_names) == (math.inf, 4, solution.state_names)
    assert loaded.report() == solution.report()


def test_exact_plant_is_asked_for_when_the_file_cannot_hold_it(arm, solved, tmp_path):
    solved.save(tmp_path / "s.npz")
    loaded = load_solution(tmp_path / "s.npz")
    assert np.array_equal(loaded.law(X), solved.law(X))
    with pytest.raises(InvalidInput, match="problem="):
        loaded.residual(X)
    again = load_solution(tmp_path / "s.npz", problem=arm)
    assert np.array_equal(again.residual(X), solved.residual(X))


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "text", "other archive", "newer"])
def test_damage_is_reported_in_three_parts(solved, tmp_path, damage):
    path = tmp_path / "s.npz"
    solved.save(path)
    content = bytearray(path.read_bytes())
    if damage == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "flipped":
        content[len(content) // 3] ^= 0xFF
        path.write_bytes(content)
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "text":
        path.write_text("gamma = 2")
    elif damage == "other archive":
        np.savez(path, x=np.ones(3))
    else:
        with np.load(path) as archive:
            arrays = {name: archive[name] for name in archive.files}
        arrays["header"] = np.array(str(arrays["header"]).replace('"version": 1', '"version": 99'))
        np.savez(path, **arrays)
    with pytest.raises(InvalidInput) as caught:
        load_solution(path)
    assert caught.value.found
    assert caught.value.advice


def test_every_changed_bit_is_refused(solved, tmp_path):
    """Of 150 bits all over the file; without the digest, some pass, and some raise what is not ours."""
    path = tmp_path / "s.npz"
    solved.save(path)
    content = path.read_bytes()
    for bit in np.linspace(0, 8 * len(content) - 1, 150).astype(int):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        with pytest.raises(InvalidInput):
            load_solution(path)


def test_a_file_of_before_the_digest_is_read(solved, tmp_path):
    path = tmp_path / "s.npz"
    solved.save(path)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays["header"] = np.array(str(arrays["header"]).replace('"digest": "sha256", ', ""))
    np.savez(path, **arrays)
    assert np.array_equal(load_solution(path).law(X), solved.law(X))


def test_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with refused_with(InvalidInput, "/pipe", "device"):
        load_solution(tmp_path / "pipe")


def test_missing_file_and_unwritable_place(solved, tmp_path):
    with refused_with(InvalidInput, "read", "none.npz"):
        load_solution(tmp_path / "none.npz")
    with refused_with(InvalidInput, "written", "s.npz"):
        solved.save(tmp_path / "no folder" / "s.npz")
