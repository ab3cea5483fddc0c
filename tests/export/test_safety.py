"""The material for an assessor, and how sharp the tests are that an export has beside its code."""

from __future__ import annotations

import importlib.util
import math
import re
import shutil
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.export.test_rest import controller_of, robot_of
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.errors import NumericalFailure
from flexhinf.export import export_c, protected
from flexhinf.export.compiled_follower import follow_files
from flexhinf.export.contract import CODES
from flexhinf.export.controller_c import MISSING_LIMIT, code_of
from flexhinf.export.provocation import (
    NOISE_PARTS,
    ProvokedRun,
    _memories,
    _singular_memories,
    _tried,
    _with_memories,
    provoked,
)
from flexhinf.export.recording import (
    Provocation,
    history_of,
    memory_hash,
    record,
    samples_without,
)
from flexhinf.export.safety import CHECKED, SECTIONS, goals
from flexhinf.export.stop_rehearsal import stop_values
from flexhinf.loop.controller.memory import SPACING
from flexhinf.stops import Stop

pytestmark = pytest.mark.usefixtures("unoptimised")

#: What brakes, and freezes the command.
WATCH = fh.Supervision(
    workspace=(-1.0, 1.0),
    following=0.3,
    position_swing=0.02,
    reactions={"workspace": "brake", "following": "hold"},
)


#: Measurements beyond are not plausible, rad.
FAR = np.full(1, 0.05)


def watched() -> fh.Controller:
    return arm_controller(kind=fh.ExtendedKalmanFilter, start="bumpless", supervision=WATCH)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_c(watched(), tmp_path_factory.mktemp("safety") / "c", "arm", robot=fh.paper_arm())


@pytest.mark.costs("records a controller that is provoked")
def test_every_bit_that_can_be_set_is_set_by_the_test_vector() -> None:
    """The oracle of the hash is FNV-1a of eight bytes at a time by its definition, of one number."""
    code = code_of(watched(), "arm", "double")
    run = provoked(code, record(code.controller))
    assert {*run.codes[run.begun :]} == {"OK", "PREDICTED", "BAD_RESULT"}
    assert run.provocation is not None
    places, noises = code.controller.data.places, run.provocation.noises
    assert len(run.provocation.noise) == sum(places[name].stop - places[name].start for name in NOISE_PARTS)
    assert not [*noises.values()][-1].any()  # the last rows are without noise
    assert max(noises) < len(run.y) - run.begun
    codes = [run.codes[run.begun + row] for row in [*noises][:-1]]
    assert (
        codes[::4].count("BAD_RESULT") == codes.count("BAD_RESULT") == 8
    )  # a pivot below what counts as zero
    assert all(np.all(run.provocation.numbers[places[name]] != 0.0) for name in NOISE_PARTS)
    memories = np.array([*run.provocation.memories.values()])
    assert not np.signbit(memories[memories == 0.0]).any()  # the test's text has 0 for them
    ever = np.bitwise_or.reduce(run.status)
    assert ever & int(code.able) == int(code.able)
    assert run.path_rate[0] == 1.0
    assert min(run.path_rate) < 0.5
    one = int.from_bytes(np.float64(0.1).tobytes(), sys.byteorder)
    assert memory_hash(np.array([0.1])) == ((14695981039346656037 ^ one) * 1099511628211) % 2**64


@pytest.mark.costs("a controller goes on from some memories")
def test_a_controller_that_changes_slowly_goes_on_from_an_input_within_its_limits() -> None:
    """Else C and Python may differ: one keeps the limit, the other the rate."""
    own = arm_controller(kind=fh.ExtendedKalmanFilter, input_rate=20.0)
    numbers, rest = np.array(own.data_vector), np.zeros((1, len(own.measured)))
    numbers[own.data.places["lower"]] = 5.0
    one = Provocation(rest, np.array([own.operating_reference]), [1], numbers, None, np.array([6.0]), {})
    memories = _with_memories(one, own, np.array, True).memories
    assert memories
    assert own.memory.named(own.initial_memory()).u < 5.0
    assert all(own.memory.named(memory).u >= 5.0 for memory in memories.values())


def test_what_a_trial_left_is_taken_back_in_the_arrays_of_the_compiled_step() -> None:
    """After good samples and two that failed, which leave an earlier memory: the next samples have the same bits."""
    own, rest = watched(), np.full(1, 0.01)
    start, memory = own.operating_reference, history_of(own).memory
    for _ in range(3):
        own.step(rest, start)
    copied = deepcopy(history_of(own))
    after = [own.step(rest, start) for _ in range(SPACING)]
    for _ in range(2):
        memory[:] = np.nan
        with pytest.raises(NumericalFailure):
            own.step(rest, start)
    history_of(own).go_on_from(copied)
    assert history_of(own).memory is memory
    for name, value in vars(copied).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(history_of(own), name), value, name)
        else:
            assert getattr(history_of(own), name) == value, name
    assert np.array_equal([own.step(rest, start) for _ in range(SPACING)], after)


def test_trials_are_kept_up_to_the_watchdogs_limit_and_refused_ones_count_for_nothing() -> None:
    """Of 11, 6, 2, 4 and 2 samples whose measurements are implausible; the third has a memory of no number."""
    own = arm_controller(kind=fh.ExtendedKalmanFilter, limit=48.0, measurement_limits=(-FAR, FAR, 1e3 * FAR))
    start, memory = np.array([own.operating_reference]), own.initial_memory()
    one = Provocation(np.zeros((1, 1)), start, [1], np.array(own.data_vector), None, None, {})

    def trial(count: int, before: np.ndarray) -> ProvokedRun:
        return ProvokedRun(before, np.full((count, 1), 1.0), np.repeat(start, count, axis=0))

    none = np.array(memory)
    none[own.memory.places["belief"].start] = np.nan
    trials = [trial(11, memory), trial(6, memory), trial(2, none), trial(4, 0.5 * memory), trial(2, memory)]
    kept = _tried(one, own, np.array, trials, False)
    assert list(kept.memories) == [1, 7]
    assert np.array_equal(kept.memories[7], 0.5 * memory)
    assert kept.answered(own).codes == ["OK"] + ["PREDICTED"] * MISSING_LIMIT  # 10


def test_a_row_that_fails_where_noise_ends_holds_the_input_before_it() -> None:
    own = watched()
    rest, start = np.zeros((3, len(own.measured))), own.operating_reference
    none = np.array(own.initial_memory())
    none[own.memory.places["belief"].start] = np.nan
    one = Provocation(
        rest + 0.01, np.tile(start, (3, 1)), [1] * 3, np.array(own.data_vector), None, None, {2: none}, (), 2
    )
    found = one.answered(own)
    assert found.codes == ["OK", "OK", "BAD_RESULT"]
    assert np.any(found.u[1] != own.input_before())
    assert np.array_equal(found.u[2], found.u[1])


@pytest.mark.ci("records one more controller")
def test_what_provokes_has_a_measurement_before_the_watchdog_stops() -> None:
    """C stops where more samples in a row are without one, and Python has no watchdog: a documented export failed its
    own test, whose memories took one measurement after the other for implausible."""
    own = arm_controller(kind=fh.ExtendedKalmanFilter, limit=48.0, measurement_limits=(-FAR, FAR, 1e3 * FAR))
    code = code_of(own, "arm", "double")
    run = provoked(code, record(own))
    assert run.provocation is not None
    begun, longest, count = run.begun, 0, 0
    for kind, times in zip(run.codes[begun:], run.repeats[begun:], strict=True):
        count = 0 if kind == "OK" else count + times
        longest = max(longest, count)
    assert 0 < longest <= MISSING_LIMIT


@pytest.mark.ci("an export")
def test_safety_has_every_code_and_bit_with_who_must_act(folder: Path) -> None:
    text = (folder / "safety.md").read_text(encoding="utf-8")
    codes = [f"ARM_{name}" for name in CODES if name != "BAD_MEASUREMENT"]
    assert unnamed(text, *codes, *(f"ARM_{bit.name}" for bit in fh.Status)) == []
    assert unnamed(text, "11 ms", "First power-on", "Safe state", "No claim", "commit ") == []
    assert "| 8 `ARM_REACTING` |" in text
    functions = set(re.findall(r"`arm_contract.c`: `(\w+)`", text))
    rehearsal = (folder / "arm_contract.c").read_text(encoding="utf-8")
    assert functions
    assert [name for name in functions if f"static void {name}(" not in rehearsal] == []


@pytest.mark.ci("codes a controller for the workspace")
def test_safety_has_every_result_of_a_trajectory_with_who_must_act() -> None:
    """Where trajectories are followed; an export of one pose follows none."""
    code = code_of(arm_controller(), "arm", "double", fh.paper_arm())
    assert goals(code) == []
    code = code_of(controller_of("planar-two-link"), "arm", "double", robot_of("planar-two-link"))
    rows = goals(code)
    assert all(len(row) == 5 and all(row) for row in rows)
    stated = re.findall(r"^    ARM_(FOLLOW_\w+) = (-\d)", follow_files(code)["arm_follow.h"], re.MULTILINE)
    assert {row[0] for row in rows[:-1]} == {f"{number} `ARM_{name}`" for name, number in stated}
    assert "arm_follow_row" in rows[-1][0]


def test_a_row_without_a_number_counts_as_the_watchdog_of_the_c_counts() -> None:
    """A failed row has its measurement, unless that may have been refused; each time of a row counts."""
    kinds = ["OK", "PREDICTED", "PREDICTED", "OK", "OK", "PREDICTED"]
    codes = ["OK", "PREDICTED", "BAD_RESULT", "BAD_RESULT", "PREDICTED", "PREDICTED"]
    repeats = [1, 3, 1, 1, 2, 5]
    assert samples_without(kinds, codes, repeats, False, 2) == [0, 3, 4, 0, 2, 7]
    assert samples_without(kinds, codes, repeats, True, 2) == [0, 3, 4, 5, 7, 12]


def test_a_rule_is_checked_or_has_a_word() -> None:
    """143 rules of MISRA C:2012, 13 of amendment 1 and 2 of amendment 2."""
    assert sum(SECTIONS.values()) == 158
    assert all(0 < rule <= SECTIONS[section] for section, rules in CHECKED.items() for rule in rules)
    assert all(list(rules) == sorted({*rules}) for rules in CHECKED.values())  # each of them once


@pytest.mark.ci("compiles an export some sixty times")
def test_changes_of_the_source_are_noticed(folder: Path, compiler: str) -> None:
    """Forty of some two thousand changes; the page has the share of more."""
    words = [sys.executable, "mutants.py", "--most", "40", "--seed", "7"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    found = re.search(r"arm.c: (\d+) of (\d+) changes noticed", done.stdout)
    assert found is not None, done.stdout + done.stderr
    assert int(found[1]) >= 0.92 * int(found[2]) > 10
    assert (folder / "mutants.txt").exists()


@pytest.mark.ci("an export with gcov")
def test_the_programs_reach_the_lines_of_the_source(folder: Path) -> None:
    if shutil.which("gcov") is None:
        pytest.skip("missing: gcov")
    done = subprocess.run(
        ["make", "-s", "coverage", "CC=gcc"], cwd=folder, capture_output=True, text=True, check=True
    )
    shares = re.findall(r"^(Lines|Branches) executed:([\d.]+)%", done.stdout, flags=re.MULTILINE)
    assert min(float(share) for _, share in shares) > 98.0


@pytest.mark.ci("exports of a controller with a protection, with gcov")
@pytest.mark.parametrize("real", ["double", "float"])
def test_a_controller_with_a_protection_passes_its_own_tests(real: str, tmp_path: Path) -> None:
    """Its swings begin at the input of the start, in C as in Python; and every line is reached."""
    if shutil.which("gcov") is None:
        pytest.skip("missing: gcov")
    own, _ = protected(watched().fresh(saturation=48.0), fh.paper_arm())
    folder = export_c(own, tmp_path / "c", "arm", real, robot=fh.paper_arm())
    done = subprocess.run(
        ["make", "-s", "coverage", "CC=gcc"], cwd=folder, capture_output=True, text=True, check=True
    )
    shares = re.findall(r"^(?:Lines|Branches) executed:([\d.]+)%", done.stdout, flags=re.MULTILINE)
    assert min(map(float, shares)) > 98.0


@pytest.mark.ci("writes the code of a controller with a protection")
def test_stops_that_are_drawn_have_every_reason_category_and_end() -> None:
    robot = robot_of("planar-two-link")
    plain = controller_of("planar-two-link").fresh(saturation=48.0, supervision=fh.Supervision())
    own, _ = protected(plain, robot)
    every = stop_values(code_of(own, "arm", "double", robot))
    decisions, bits = every["decisions"], len(Stop)
    begun = [one for one in decisions if not one.before[:bits].any() and one.reasons]
    assert {one.category for one in begun} == {0, 1, 2}
    assert all(np.array([one.after[:bits] for one in begun]).any(axis=0))
    assert all(np.array([one.before[:bits] for one in decisions]).any(axis=0))
    lost = [one for one in decisions if one.before[bits] > 0.0 and not one.power]
    assert {one.category for one in lost} == {0, 1, 2}
    assert {one.power for one in decisions} == {0, 1}
    assert np.bitwise_or.reduce([one.why for one in every["beginnings"]]) == 2 | 4 | 8
    assert every["beginnings"][0].why == 0


def test_covariances_stay_semidefinite_where_float_decides() -> None:
    """Whether another one is refused is a matter of rounding there; a documented export failed its own test by it."""
    own = arm_controller(kind=fh.UnscentedKalmanFilter)

    def is_one(memory: np.ndarray) -> bool:
        parts = [np.asarray(part) for part in own.memory.named(memory).belief if np.ndim(part) == 2]
        values = [(np.array_equal(part, part.T), np.linalg.eigvalsh(part)) for part in parts]
        return bool(parts) and all(even and found[0] >= -1e-12 * found[-1] for even, found in values)

    kept = list(_memories(own, False))
    assert len(kept) > 2
    assert all(map(is_one, kept))
    assert not all(map(is_one, _memories(own, True)))


def test_memories_turn_the_arm_into_every_quarter_of_a_turn_and_beyond() -> None:
    own = arm_controller(kind=fh.ExtendedKalmanFilter)
    turned = [float(own.memory.named(memory).belief[0][0]) for memory in _singular_memories(own)]
    assert {math.floor(angle / (0.5 * math.pi)) % 4 for angle in turned} == {0, 1, 2, 3}
    assert min(turned) < 0.0
    assert max(turned) > 2.0 * math.pi


@pytest.mark.ci("compiles an export three times")
def test_two_exports_may_be_compiled_as_one_file(folder: Path, compiler: str, tmp_path: Path) -> None:
    """And nothing of it compares numbers by ==."""
    warnings = (
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Wshadow",
        "-Wundef",
        "-Wfloat-equal",
        "-Werror",
        "-c",
    )
    for other in ("arm", "leg"):
        for file in ("arm.h", "arm.c"):
            text = (
                (folder / file)
                .read_text(encoding="utf-8")
                .replace("arm", other)
                .replace("ARM", other.upper())
            )
            (tmp_path / file.replace("arm", other)).write_text(text, encoding="utf-8")
    (tmp_path / "both.c").write_text('#include "arm.c"\n#include "leg.c"\n', encoding="utf-8")
    for file in ("arm.c", "both.c"):
        subprocess.run([compiler, *warnings, file], cwd=tmp_path, check=True)
    assert "AT_U" in (tmp_path / "arm.c").read_text(encoding="utf-8")


@pytest.mark.ci("an export")
def test_survivors_that_are_no_change_have_a_rule(folder: Path) -> None:
    """Each of its own; the same change elsewhere is one."""
    found = importlib.util.spec_from_file_location("mutants", folder / "mutants.py")
    assert found is not None
    assert found.loader is not None
    mutants = importlib.util.module_from_spec(found)
    found.loader.exec_module(mutants)
    source = """static int arm_exact(void)
{
    wrong += (tiny > 0.0) ? 0 : 1;
}

static void arm_sum(const real *data)
{
    const real v4 = v2 + data[3];
    const real v5 = (v2 <= data[3]) ? data[3] : v4;
    const real v6 = v2 + data[3];
    const real v7 = (m > 0.5) ? v6 : v5;
    real *const gram = &scratch[27];
}

static real arm_sin(real x)
{
    return (m > 0.5 && m < 2.5) ? -cv : cv;
    const real reach = 1000000.0;
    const real r = FMA(-k, 1.5707963267341256, size);
    return ((m > 1.5) ? -sv : sv) * copysign(1.0, x);
}

static void arm_seen(const real *seen)
{
    const bool c1 = 0.5 < seen[2];
    const real v1 = c1 ? 3.0 : 1.0;
    const real v2 = (c2 && c3) ? 4.0 : v1;
    const bool c4 = (v2 <= 3.0) && (v2 >= 3.0);
    const bool c6 = (v2 <= 4.0) && (v2 >= 4.0);
    const real v3 = c4 ? seen[1] : v2;
    const bool c5 = (v3 <= 3.0) && (v3 >= 3.0);
}

static void arm_rows(const real *commands, real *rows)
{
    rows[0] = commands[0];
    rows[1] = commands[1];
}

static void arm_first(const real *rows, const real *last, real *first)
{
    const real v1 = rows[1] + rows[0];
    first[0] = rows[0];
    first[1] = v1;
    (void)last;
}

static void arm_gain(const real *first, real *gain)
{
    gain[0] = first[0];
}

static void arm_sample(const real *commands, real *after)
{
    real *const rows = scratch;
    real *const first = &scratch[2];
    arm_rows(commands, rows);
    arm_first(rows, commands + 2, first);
    arm_gain(first, after + ARM_AT_U);
    arm_copy(first, after + ARM_AT_U, 1);
    arm_copy(rows, after + ARM_AT_SEEN, 1);
}

enum {
    ARM_AT_U = 0, /* */
    ARM_AT_SEEN = 1, /* */
};

static void arm_copy(const real *source, real *target)
{
    target[0] = source[0];
}""".splitlines()

    def is_none(number: int, kind: str, old: str, new: str) -> bool:
        line = source[number - 1]
        assert old in line
        return bool(mutants.reason(source, number, kind, line.replace(old, new, 1)))

    assert is_none(3, "step", "+=", "-=")
    assert is_none(8, "sign", "+", "-")
    assert not is_none(10, "sign", "+", "-")  # it is chosen elsewhere too
    assert not is_none(11, "number", "0.5", "0.625")  # nothing says that this is a whole number
    assert is_none(12, "number", "27", "28")
    assert is_none(17, "number", "0.5", "0.625")
    assert not is_none(17, "number", "0.5", "1.5")
    assert is_none(18, "number", "1000000.0", "1250000.0")
    assert not is_none(18, "number", "1000000.0", "2000000.0")  # these are too many quarter turns
    assert not is_none(19, "number", "1.5707963267341256", "1.963495408417657")
    assert is_none(20, "product", "*", "/")
    assert not is_none(20, "number", "1.0", "0.0")
    assert is_none(25, "number", "0.5", "0.625")
    assert not is_none(25, "number", "2", "3")
    places = {line.strip(): number for number, line in enumerate(source, 1)}
    assert is_none(places["const bool c4 = (v2 <= 3.0) && (v2 >= 3.0);"], "number", "<= 3.0", "<= 3.75")
    assert not is_none(places["const bool c4 = (v2 <= 3.0) && (v2 >= 3.0);"], "number", ">= 3.0", ">= 3.75")
    assert not is_none(places["const bool c4 = (v2 <= 3.0) && (v2 >= 3.0);"], "number", "<= 3.0", "<= 4.0")
    assert is_none(places["const bool c6 = (v2 <= 4.0) && (v2 >= 4.0);"], "number", "<= 4.0", "<= 5.0")
    assert not is_none(places["const bool c6 = (v2 <= 4.0) && (v2 >= 4.0);"], "number", ">= 4.0", ">= 5.0")
    assert not is_none(places["const bool c5 = (v3 <= 3.0) && (v3 >= 3.0);"], "number", "<= 3.0", "<= 3.75")
    assert is_none(places["rows[1] = commands[1];"], "number", "commands[1]", "commands[2]")
    assert not is_none(places["rows[0] = commands[0];"], "number", "commands[0]", "commands[1]")
    assert not is_none(places["const real v1 = rows[1] + rows[0];"], "product", "+", "-")
    assert is_none(places["first[1] = v1;"], "left out", "first[1] = v1", "")
    assert is_none(places["arm_first(rows, commands + 2, first);"], "number", "2", "3")
    assert not is_none(places["arm_gain(first, after + ARM_AT_U);"], "number", "U", "SEEN")
    assert is_none(places["arm_copy(first, after + ARM_AT_U, 1);"], "number", "1", "2")
    assert not is_none(places["arm_copy(rows, after + ARM_AT_SEEN, 1);"], "number", "1", "2")
