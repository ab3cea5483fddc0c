"""Solution and controller files that were damaged, or made to mislead: refused, or what was written."""

from __future__ import annotations

import hashlib
import io
import json
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import flexhinf as fh
from fuzz.tally import Tally

ATTEMPTS = 1500

ESTIMATORS: tuple[Any, ...] = (None, fh.ExtendedKalmanFilter, fh.UnscentedKalmanFilter)

_POINTS = np.random.default_rng(5).standard_normal((5, 2))
_HOSTILE = (
    None, True, -1, 0, 1.5, 10**400, "x", "nan", "-inf", [], {}, [[]], "a\nb", "𝛼" * 300, [1] * 1000, -(2**63),
    "9" * 5000,
)  # fmt: skip


def run(attempts: int, seed: int) -> Tally:
    """Write a solution or a controller, damage the file in a drawn way, load it."""
    rng = np.random.default_rng(seed)
    tally = Tally("solution and controller files damaged, or made to mislead")
    solution = _solution()
    controllers = [_controller(solution, kind) for kind in ESTIMATORS]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        kinds = []
        for written in (solution, *controllers):
            written.save(path)
            with np.load(path) as archive:
                kinds.append((written, path.read_bytes(), {name: archive[name] for name in archive.files}))
        for attempt in range(attempts):
            written, content, arrays = kinds[0 if rng.random() < 0.5 else rng.integers(1, len(kinds))]
            damage = _DAMAGES[rng.integers(len(_DAMAGES))]
            how = f"seed {seed}, attempt {attempt}, {type(written).__name__}, {damage.__name__}"
            path.write_bytes(damage(rng, content, dict(arrays)))
            same = damage not in _OTHER_CONTENT
            try:
                with warnings.catch_warnings(), np.errstate(all="ignore"):
                    warnings.simplefilter("ignore")
                    if isinstance(written, fh.HJISolution):
                        fault = _fault(fh.load_solution(path), written, same)
                    else:
                        fault = _controller_fault(fh.load_controller(path), written, same)
                tally.answered(fault, how)
            except Exception as error:
                tally.raised(error, how)
    return tally


def _controller(solution: fh.HJISolution, estimator: Any) -> fh.Controller:
    """The solution's law, with an estimator of the plant ẋ = (x2, −x1 + u), or none."""
    if estimator is None:
        return fh.Controller(solution, None, 1e-2, 3.0)
    plant = fh.Plant(
        lambda x, u, d, p: np.array([x[1], -p.k * x[0] + u[0]]),
        lambda x, u, p: np.array([x[0]]),
        solution.state_names,
        solution.input_names,
        parameters={"k": 1.0},
    )
    return fh.Controller(
        solution, estimator(plant, 1e-2, 1e-6, 1e-4, np.zeros(2), 1e-2), 1e-2, ([-3.0], [2.0])
    )


def _controller_fault(loaded: fh.Controller, written: fh.Controller, same: bool) -> str:
    """What is wrong with a controller that was loaded; one of other content need only make finite steps, or refuse."""
    fresh = written.fresh()
    for sample in _POINTS[:, : len(written.measured)] if same else _POINTS[:2, : len(loaded.measured)]:
        made = loaded.step(sample)
        if not np.isfinite(made).all():
            return "a step that is not finite"
        if same and not np.array_equal(made, fresh.step(sample)):
            return "another controller"
    return "" if repr(loaded) else "no text"


def _solution() -> fh.HJISolution:
    plant = fh.PolynomialPlant(
        f={(1, 0): [0, -1], (0, 1): [1, 0.5], (2, 0): [0.1, 0], (3, 0): [0, -0.3]},
        g1=[[0], [1]],
        g2={(0, 0): [[0], [1]], (2, 0): [[0], [0.5]]},
        h={(1, 0): [1, 0], (0, 1): [0, 1]},
        r2=1.0,
    )
    return fh.solve_hji(plant, 2.0, 5)


def _fault(loaded: fh.HJISolution, solution: fh.HJISolution, same: bool) -> str:
    """What is wrong with a solution that was loaded; a file of other content need only hold a usable one."""
    value, law = loaded.value(_POINTS[:, : len(loaded.P)]), loaded.law(_POINTS[:, : len(loaded.P)])
    if not (np.isfinite(value).all() and np.isfinite(law).all()) or not loaded.report() or not repr(loaded):
        return "not finite"
    if same and not (np.array_equal(value, solution.value(_POINTS)) and loaded.gamma == solution.gamma):
        return "another solution"
    return ""


# Damage to the bytes --------------------------------------------------------------------------------
def _flip_bits(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    damaged = bytearray(content)
    for place in rng.integers(0, len(content), rng.integers(1, 4)):
        damaged[place] ^= 1 << rng.integers(8)
    return bytes(damaged)


def _cut(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    return content[: rng.integers(0, len(content))]


def _lengthen(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    return content + rng.bytes(int(rng.integers(1, 200)))


def _move_block(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    source, target, size = (int(number) for number in rng.integers(0, len(content), 3))
    block = content[source : source + size % 300]
    return content[:target] + block + content[target + len(block) :]


# Other content with a digest that fits ---------------------------------------------------------------
def _packed(members: dict[str, bytes], sealed: bool = True) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(f"{name}.npy", member)
        archive.comment = b"0" * 64
    whole = buffer.getvalue()
    return whole[:-64] + (hashlib.sha256(whole[:-64]).hexdigest().encode() if sealed else whole[-64:])


def _npy(array: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def _repacked(arrays: dict[str, Any], **members: bytes) -> bytes:
    return _packed({name: _npy(array) for name, array in arrays.items()} | members)


def _without_digest(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    name = _drawn(rng, arrays)
    arrays[name] = arrays[name] * 2 if arrays[name].dtype == float else arrays[name]
    return _packed({key: _npy(array) for key, array in arrays.items()}, sealed=False)


def _swap(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    """Two arrays under each other's names, of different shapes."""
    for _ in range(20):
        one, other = _drawn(rng, arrays), _drawn(rng, arrays)
        if arrays[one].shape != arrays[other].shape:
            arrays[one], arrays[other] = arrays[other], arrays[one]
            break
    return _repacked(arrays)


def _other_type(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    name = _drawn(rng, arrays)
    kinds: tuple[Any, ...] = (
        complex,
        np.float32,
        np.int64,
        str,
        object,
        bool,
        "S8",
        ">f8",
        "M8[s]",
        np.float16,
    )
    kind = kinds[rng.integers(len(kinds))]
    arrays[name] = np.zeros(arrays[name].shape, kind)
    return _repacked(arrays)


def _other_shape(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    name = _drawn(rng, arrays)
    shapes = ((), (0,), (1,), (3, 0), (1,) * 20, (7, 7), (2, 1, 3), (10, 11, 12))
    arrays[name] = np.ones(shapes[rng.integers(len(shapes))])
    return _repacked(arrays)


def _other_numbers(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    name = _drawn(rng, arrays)
    if arrays[name].dtype == float and arrays[name].size:
        arrays[name] = arrays[name].copy()
        arrays[name].flat[rng.integers(arrays[name].size)] = rng.choice([np.nan, np.inf, -np.inf])
    else:
        arrays[name] = np.full(3, np.nan)
    return _repacked(arrays)


def _other_names(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    names = (
        "V_01",
        "V_-3",
        "V_",
        "V_1e1",
        "V_99999999999",
        "f_x",
        "../x",
        "",
        "V_1",
        "h_0",
        "extra",
        "q" * 1000,
    )
    arrays[names[rng.integers(len(names))]] = arrays.pop(_drawn(rng, arrays))
    return _repacked(arrays)


def _pickle(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    arrays[_drawn(rng, arrays)] = np.array([{"a": 1}, print], dtype=object)
    return _repacked(arrays)


def _huge_claim(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    """A header of an array that claims far more numbers than follow, or is far too long itself."""
    shapes = (
        "(1000000000000,)",
        "(2,)" + " " * 20_000,
        "(99999999999999999999,)",
        "(-5,)",
        "(" * 3000,
        "(2, 'x')",
    )
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shapes[rng.integers(len(shapes))]}, }}\n".encode()
    member = b"\x93NUMPY\x02\x00" + len(text).to_bytes(4, "little") + text + b"\0" * 64
    return _repacked(arrays, **{_drawn(rng, arrays): member})


def _bomb(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    return _repacked(arrays, **{_drawn(rng, arrays): b"\0" * 3_000_000})


def _header(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    """One value of the JSON header, or of something in it at any depth, is something else, or missing."""
    header = place = json.loads(str(arrays["header"]))
    while rng.random() < 0.7:
        below = place.values() if isinstance(place, dict) else place
        below = [part for part in below if part and isinstance(part, (dict, list))]
        if not below:
            break
        place = below[rng.integers(len(below))]
    if isinstance(place, list):
        place[rng.integers(len(place))] = _HOSTILE[rng.integers(len(_HOSTILE))]
        arrays["header"] = np.array(json.dumps(header))
        return _repacked(arrays)
    key = list(place)[rng.integers(len(place))]
    if rng.random() < 0.15:
        del place[key]
    else:
        place[key] = _HOSTILE[rng.integers(len(_HOSTILE))]
    arrays["header"] = np.array(json.dumps(header))
    return _repacked(arrays)


def _no_json(rng: np.random.Generator, content: bytes, arrays: dict[str, Any]) -> bytes:
    texts = (
        "[" * 100_000,
        "",
        "null",
        "[]",
        "{}",
        "NaN",
        '{"format": "flexhinf solution"}',
        "1" * 6000,
        "\x00",
    )
    arrays["header"] = np.array(texts[rng.integers(len(texts))])
    return _repacked(arrays)


def _drawn(rng: np.random.Generator, arrays: dict[str, Any]) -> str:
    return sorted(arrays)[rng.integers(len(arrays))]


_OTHER_CONTENT: tuple[Callable[..., bytes], ...] = (
    _swap, _other_type, _other_shape, _other_numbers, _other_names, _pickle, _huge_claim, _bomb, _header, _no_json,
)  # fmt: skip
_DAMAGES: tuple[Callable[..., bytes], ...] = (
    _flip_bits, _flip_bits, _flip_bits, _cut, _lengthen, _move_block, _without_digest, *_OTHER_CONTENT,
)  # fmt: skip
