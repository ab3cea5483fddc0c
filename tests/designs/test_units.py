"""Values as people write them: text with units, lists between commas, numbers of NumPy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import BeforeValidator

from flexhinf import options as units
from flexhinf.designs.specification import Specification, SpecificationError


def reader(annotation: Any) -> Any:
    """What reads the value of a field, before its range is checked."""
    markers = (
        marker for part in annotation.__metadata__ if isinstance(part, units.Marker) for marker in part
    )
    return next(marker.func for marker in markers if isinstance(marker, BeforeValidator))


seconds, frequencies, speeds, quanta, angles = map(
    reader, (units.Seconds, units.Frequencies, units.PerJointSpeed, units.Quanta, units.Pose)
)


@pytest.mark.parametrize(
    ("value", "meant"),
    [
        ("4", 4.0),
        ("4rad/s", 4.0),
        (" 4 rad/s ", 4.0),
        ("0.6Hz", 1.2 * math.pi),
        ("1 hz", 2 * math.pi),
        ("4,6", (4.0, 6.0)),
        ("4rad/s, 1Hz", (4.0, 2 * math.pi)),
        (3, 3.0),
        (np.float64(3.0), 3.0),
        (np.array([3.0]), (3.0,)),
    ],
)
def test_a_bandwidth_is_in_rad_per_second_unless_it_says_hertz(value: Any, meant: object) -> None:
    assert frequencies(value) == meant


#: How many of a unit are one of the SI unit, or one turn of 2π rad (a second).
TURN = 2.0 * math.pi
WHOLE = {
    "s": (1, 1.0), "ms": (1000, 1.0), "us": (1_000_000, 1.0), "µs": (1_000_000, 1.0), "μs": (1_000_000, 1.0),
    "ns": (1_000_000_000, 1.0),
    "rad": (1, 1.0), "mrad": (1000, 1.0), "deg": (360, TURN), "°": (360, TURN),
    "arcmin": (21_600, TURN), "arcsec": (1_296_000, TURN), "m": (1, 1.0), "mm": (1000, 1.0),
    "rad/s": (1, 1.0), "deg/s": (360, TURN), "°/s": (360, TURN), "rpm": (60, TURN), "Hz": (1, TURN),
    "m/s": (1, 1.0), "mm/s": (1000, 1.0), "N·m": (1, 1.0), "Nm": (1, 1.0), "N*m": (1, 1.0), "N": (1, 1.0),
    "mN·m": (1000, 1.0), "mNm": (1000, 1.0),
}  # fmt: skip
TABLES = {
    seconds: (units.SECONDS,),
    frequencies: (units._FREQUENCIES,),
    speeds: units._SPEEDS,
    quanta: units._QUANTITIES,
    lambda text: angles(text)[0]: units._POSITIONS,
}


@pytest.mark.oracle
@pytest.mark.parametrize(("read", "tables"), TABLES.items())
def test_every_unit_is_as_much_as_it_is(read: Any, tables: tuple[dict[str, float], ...]) -> None:
    """A turn a minute is 2π/60 rad/s; each unit of every table is compared with whole ones."""
    for unit in {name for table in tables for name in table}:
        count, meant = WHOLE[unit]
        assert read(f"{count}{unit}") == pytest.approx(meant, rel=1e-15), unit
        assert read(f"{7 * count} {unit}") == pytest.approx(7 * meant, rel=1e-15), unit


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (seconds, "5 MS"), (seconds, "5 S"), (units.lengths, "420 MM"), (units.lengths, "2 M"),
        (quanta, "5 nm"), (quanta, "5 NM"), (quanta, "5 n"), (angles, "7 Mrad"),
        (speeds, "3 M/S"), (frequencies, "3 RAD/S"),
    ],
)  # fmt: skip
def test_letters_of_prefixes_and_symbols_are_those_of_the_si(read: Any, text: str) -> None:
    """M is mega and m milli, S is siemens, nm a nanometre: in other letters a unit is another one."""
    with pytest.raises(ValueError):  # noqa: PT011
        read(text)


@pytest.mark.parametrize(
    ("field", "text", "advice"),
    [
        ("period", "5 MS", "period='5ms'"), ("peak_speed", "3 MM/S", "peak_speed=0.003"),
        ("pose", "2 M", "pose=(2.0,)"), ("unknown_delay", "5 MM", "unknown_delay="),
    ],
)  # fmt: skip
def test_a_unit_of_a_specification_in_other_letters_is_told_the_right_ones(
    field: str, text: str, advice: str
) -> None:
    with pytest.raises(SpecificationError) as caught:
        Specification(**{field: text})
    assert text in caught.value.found
    assert advice in caught.value.advice


@pytest.mark.parametrize(
    ("read", "text", "same"),
    [
        (angles, "90 DEG", "90deg"), (angles, "7 mRAD", "7mrad"), (speeds, "30 RPM", "30rpm"),
        (speeds, "30 Deg/s", "30deg/s"), (frequencies, "3 HZ", "3Hz"),
    ],
)  # fmt: skip
def test_words_that_mean_nothing_else_may_be_in_any_letters(read: Any, text: str, same: str) -> None:
    assert read(text) == read(same)


@pytest.mark.parametrize("text", ["4xyz", "Hz", "4,", ",", "", "fast", "4 6", "4deg", [], True, None])
def test_what_is_no_bandwidth_is_refused(text: Any) -> None:
    with pytest.raises(ValueError):  # noqa: PT011
        frequencies(text)


@pytest.mark.parametrize("value", [b"1", bytearray(b"12"), memoryview(b"1"), "1e400", "1" * 3000])
def test_bytes_are_no_numbers_and_what_is_beyond_all_floats_is_no_absent_limit(value: Any) -> None:
    for field in ("pose", "saturation", "peak_speed", "integral_dead_zone"):
        with pytest.raises(SpecificationError):
            Specification(**{field: value})
    assert Specification(saturation="inf").saturation == math.inf


@pytest.mark.parametrize("text", ["1" * 100_000 + " x y", " " * 100_000 + "x", "1" + " " * 100_000 + "x y"])
def test_a_long_text_is_refused_at_once(text: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011  (one that looks at a character again for each took minutes)
        angles(text)


def test_angles_are_in_radians_unless_they_say_degrees() -> None:
    assert angles("0.5,-90deg, 180 deg,180°") == (0.5, -math.pi / 2, math.pi, math.pi)
    assert angles(["30deg", 0.25]) == (math.radians(30), 0.25)
    assert angles(0.5) == angles(np.array([0.5])) == (0.5,)
    assert units._poses(["0.1,90°", [0.2, 0.3]]) == ((0.1, math.pi / 2), (0.2, 0.3))
    with pytest.raises(ValueError, match="90grad"):
        angles("90grad")


def test_the_unit_of_angles_is_that_of_their_texts() -> None:
    assert units.angle_unit_of("90deg", None, ["0.3,0.4"]) == "deg"
    assert units.angle_unit_of("0.3rad", (0.1, 0.2)) == "rad"
    assert units.angle_unit_of((0.1, 0.2), None, ()) is None


@pytest.mark.parametrize(("text", "meant"), [("5ms", 5e-3), ("0.5 s", 0.5), ("20µs", 2e-5), ("1e-3", 1e-3)])
def test_a_time_may_have_a_unit(text: str, meant: float) -> None:
    assert seconds(text) == pytest.approx(meant, rel=1e-15)


def test_names_integers_and_weights_stand_between_commas() -> None:
    assert units.names(" a, b ,,") == ("a", "b")
    assert units._integers("4,2,2") == (2, 4)
    assert units._weights("60,0,300") == (60.0, 0.0, 300.0)
    assert units._weights("link_position=60, motor_velocity = 3") == {
        "link_position": 60.0,
        "motor_velocity": 3.0,
    }
    for wrong in ("link_position=a", "", [[1.0, 2.0], [3.0]], {}, 3.0):
        with pytest.raises(ValueError):  # noqa: PT011
            units._weights(wrong)


@pytest.mark.filterwarnings("ignore:the matrix subclass")
def test_values_that_are_matrices_huge_or_contain_themselves_are_refused() -> None:
    inside: list[Any] = []
    inside.append(inside)
    for wrong in (np.matrix([[1.0]]), inside, range(10**12)):
        assert units.angle_unit_of(wrong) is None
        with pytest.raises(SpecificationError, match="pose"):
            Specification(pose=wrong)


@pytest.mark.parametrize("text", ["1Nm", "1deg/s", "2N", "1m/s"])
def test_a_dead_zone_is_a_distance(text: str) -> None:
    assert Specification(integral_dead_zone="0.5mm").integral_dead_zone == 5e-4  # type: ignore[arg-type]
    with pytest.raises(SpecificationError, match=f"dead zone(?s:.)*'{text}'"):
        Specification(integral_dead_zone=text)  # type: ignore[arg-type]
