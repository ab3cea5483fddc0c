"""Normal numbers of a counter: the generator's published answers, the same bits in kernels, and their distribution."""

import ctypes
import math

import numpy as np
import pytest
from tests.interpreter import interpret

from flexhinf.codegen import Buffer, Normal, Program, Repeat, Slice, compile_program, machine
from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer
from flexhinf.codegen.noise import ARRAYS, normal_numbers, philox, seed_key
from flexhinf.errors import InvalidInput

#: Random123's kat_vectors, philox4x32-10: counter, key, result.
KNOWN = [
    ((0, 0, 0, 0), (0, 0), "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        "d16cfe09 94fdcceb 5001e420 24126ea1",
    ),
]
#: The last one's seed.
SEED = 0x299F31D0A4093822


def in_kernel(seed: int, samples: np.ndarray, steps: int, channels: int, lanes: int, maker=compile_program):
    """Numbers (samples, steps, channels) as a kernel makes them, `lanes` samples at a time."""
    buffers = (
        Buffer("steps", None, "in", shared=lanes > 1),
        Buffer("key", 3, "in"),
        Buffer("z", None, "out"),
    )
    step = Normal(
        Slice("steps", strides=(1,)), Slice("key", size=3), Slice("z", size=channels, strides=(channels,))
    )
    kernel = maker(Program("noise", buffers, (Repeat("turns", (step,)),), ("turns",)), lanes)
    found = []
    for some in samples.reshape(-1, lanes):
        key = np.stack([some, *(np.full(lanes, word) for word in seed_key(seed))]).astype(float)
        z = np.zeros((steps * channels, lanes))
        arrays = {"steps": np.arange(steps, dtype=float), "key": key, "z": z}
        assert kernel.run(arrays, {"turns": steps}).fine
        found += [column.reshape(steps, channels) for column in z.T]
    return np.array(found)


@pytest.mark.oracle
@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN)
def test_known_answers(counter, key, expected):
    assert " ".join(f"{int(word):08x}" for word in philox(ARRAYS, counter, key)) == expected


@pytest.mark.oracle
@pytest.mark.parametrize("lanes", [1, 8])
def test_known_answers_of_the_emitted_generator(lanes):
    module = ModuleText(Lanes(lanes))
    writer = Writer(module)
    whole, names = writer.lanes.integer, []

    def place(k: int) -> str:
        return writer.let(f"getelementptr {whole}, ptr %words, i64 {k}")

    for k in range(6):
        names.append(writer.let(f"load {whole}, ptr {place(k)}, align 8"))
    for k, word in enumerate(philox(writer, names[:4], names[4:])):
        writer.do(f"store {whole} {word}, ptr {place(k)}, align 8")
    text = "\n".join(["define void @flexhinf_known(ptr %words) {", *writer.lines, "  ret void", "}"])
    code = machine.Code(machine.assemble(text, 2), "flexhinf_known", {})
    cases = [KNOWN[k % len(KNOWN)] for k in range(max(lanes, len(KNOWN)))]
    for first in range(0, len(cases), lanes):
        some = cases[first : first + lanes]
        words = np.array([(*counter, *key) for counter, key, _ in some], dtype=np.int64).T.copy()
        ctypes.CFUNCTYPE(None, ctypes.c_void_p)(code.address)(words.ctypes.data)
        for column, (_, _, expected) in zip(words.T, some, strict=True):
            assert " ".join(f"{word:08x}" for word in column[:4]) == expected


@pytest.mark.oracle
def test_arrays_of_counters_are_the_counters_one_by_one():
    a = np.array([0, 0xFFFFFFFF, 0x243F6A88])
    words = philox(ARRAYS, (a.astype(np.uint64), 5, 7, 0), (1, 2))
    for k, first in enumerate(a):
        assert [int(w[k]) for w in words] == [int(w) for w in philox(ARRAYS, (int(first), 5, 7, 0), (1, 2))]


@pytest.mark.oracle
def test_box_and_muller_by_the_mathematical_library():
    words = philox(ARRAYS, (np.arange(20_000), 1, 2, 0), seed_key(SEED))
    first, second = (((words[k] << np.uint64(21)) ^ (words[k + 1] >> np.uint64(11))) + 1.0 for k in (0, 2))
    expected = np.sqrt(-2.0 * np.log(first * 2.0**-53)) * np.cos(2.0 * np.pi * second * 2.0**-53)
    np.testing.assert_allclose(normal_numbers(SEED, np.arange(20_000), 1, 2), expected, rtol=0, atol=4e-15)


@pytest.mark.oracle
def test_kernels_of_any_lanes_and_the_array_have_the_same_bits():
    samples = np.array([0, 1, 7, 99, 2**31, 2**32 - 1, 5, 6])
    expected = normal_numbers(SEED, np.arange(500)[:, None], np.arange(3), samples[:, None, None])
    for lanes in (1, 2, 8):
        np.testing.assert_array_equal(in_kernel(SEED, samples, 500, 3, lanes), expected)
    np.testing.assert_array_equal(in_kernel(SEED, samples[:2], 20, 3, 2, interpret), expected[:2, :20])


def test_ends_of_the_uniform_numbers(monkeypatch):
    """The largest and the smallest uniform numbers: nothing that is not finite."""
    ones, zero = np.array([0xFFFFFFFF], dtype=np.uint64), np.array([0], dtype=np.uint64)
    for words, expected in (
        ((ones, ones, ones, ones), 0.0),
        ((zero, zero, ones, ones), math.sqrt(2.0 * 53 * math.log(2.0))),
        ((zero, zero, zero, zero), math.sqrt(2.0 * 53 * math.log(2.0))),
    ):
        monkeypatch.setattr("flexhinf.codegen.noise.philox", lambda *_, words=words: words)
        assert normal_numbers(0, 0, 0, 0)[0] == pytest.approx(expected, rel=1e-15, abs=1e-300)


def test_any_number_can_be_asked_for_alone():
    z = normal_numbers(9, np.arange(100)[:, None], np.arange(4), 3)
    assert z[17, 2] == normal_numbers(9, 17, 2, 3)
    assert (
        abs(np.corrcoef(z.ravel(), normal_numbers(9, np.arange(100)[:, None], np.arange(4), 4).ravel())[0, 1])
        < 0.2
    )


def test_all_64_bits_of_the_seed_count():
    seeds = (0, 1, 2**32, 2**63)
    assert len({float(normal_numbers(seed, 0, 0, 0)) for seed in seeds}) == len(seeds)


def test_a_counter_of_another_size_is_refused():
    with pytest.raises(InvalidInput, match="counter"):
        Normal(Slice("a"), Slice("b", size=2), Slice("z"))


def test_distribution_of_few():
    from scipy import stats

    z = normal_numbers(0, np.arange(40_000)[:, None], np.arange(3), 0)
    assert stats.kstest(z.ravel(), "norm").pvalue > 0.01
    assert np.abs(np.corrcoef(z.T) - np.eye(3)).max() < 0.02
    assert np.abs([np.corrcoef(c[:-1], c[1:])[0, 1] for c in z.T]).max() < 0.02


@pytest.mark.nightly("ten million normal numbers; the test above has 120,000")
@pytest.mark.oracle
def test_distribution_of_ten_million():
    """1e7 draws of the kernel: moments, tails and correlations within four sigma, and the distribution."""
    from scipy import stats

    samples, steps, channels = 400, 5_000, 5
    z = in_kernel(1, np.arange(samples), steps, channels, 8)
    count, flat = z.size, z.ravel()
    assert count == 10_000_000
    moments = {
        1: (0.0, 1.0),
        2: (1.0, 2.0),
        3: (0.0, 15.0),
        4: (3.0, 96.0),
        6: (15.0, 10_170.0),
    }  # mean, variance
    for power, (mean, variance) in moments.items():
        assert abs(np.mean(flat**power) - mean) < 4.0 * math.sqrt(variance / count), power
    assert stats.kstest(flat, "norm").pvalue > 1e-4
    for size in (3.0, 4.0, 5.0):
        expected = count * 2.0 * stats.norm.sf(size)
        assert abs(np.sum(np.abs(flat) > size) - expected) < 4.0 * math.sqrt(expected) + 1.0
    pairs = {
        "next sample": (z[:-1], z[1:]), "next step": (z[:, :-1], z[:, 1:]), "next channel": (z[..., :-1], z[..., 1:]),
        "over seven steps": (z[:, :-7], z[:, 7:]), "next channel, next step": (z[:, :-1, :-1], z[:, 1:, 1:]),
    }  # fmt: skip
    for what, (one, other) in pairs.items():
        for a, b in ((one, other), (one**2 - 1.0, other**2 - 1.0), (one, other**2 - 1.0)):
            limit = 4.0 * math.sqrt(float(np.mean(a * a)) * float(np.mean(b * b)) / a.size)
            assert abs(np.mean(a * b)) < limit, what
