"""Numbers with units as text in robot files: read in SI units, checked against what they measure."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tests.refusals import refused_with, unnamed

from flexhinf.errors import InvalidInput
from flexhinf.robot import load_robot
from flexhinf.robot.parameters import QUANTITIES, measured, respelled
from flexhinf.robot.signals import UNITS

PLAIN = """
gravity = 9.81
home = [0.5]
[[joint]]
name = "a"
limits = [-3.141592653589793, 3.141592653589793]
speed_limit = 3.141592653589793
effort_limit = 0.6
[joint.link]
axis_inertia = { value = 0.5, tolerance = 5 }
mass = 2.0
length = 0.3
[joint.spring]
stiffness = 10000.0
backlash = 1e-3
[joint.motor]
rotor_inertia = 1e-5
gear_ratio = 100.0
gear_efficiency = 0.8
friction = 0.3
torque_constant = 0.05
[joint.tolerances]
stiffness = 12
[[payload]]
mass = { value = 0.0, range = [0.0, 3.0] }
sphere = 0.05
"""
WRITTEN = {
    "gravity = 9.81": "gravity = '9.81 m/s^2'", "home = [0.5]": "home = ['500 mrad']",
    "[-3.141592653589793, 3.141592653589793]": "['-180deg', '180°']",
    "speed_limit = 3.141592653589793": "speed_limit = '30 rpm'", "effort_limit = 0.6": "effort_limit = '600mA'",
    "{ value = 0.5, tolerance = 5 }": "{ value = '5000 kg cm²', tolerance = '5 %' }",
    "mass = 2.0": "mass = '2000 g'", "length = 0.3": "length = '30 cm'", "10000.0": "'10 kNm/rad'",
    "backlash = 1e-3": "backlash = '1 mrad'", "rotor_inertia = 1e-5": "rotor_inertia = '100 g·cm²'",
    "gear_efficiency = 0.8": "gear_efficiency = '80%'", "friction = 0.3": "friction = '0.3 N·m·s/rad'",
    "torque_constant = 0.05": "torque_constant = '50 mNm/A'", "stiffness = 12": "stiffness = '12%'",
    "{ value = 0.0, range = [0.0, 3.0] }": "{ value = '0 kg', range = ['0 kg', '3000 g'] }",
    "sphere = 0.05": "sphere = '5cm'",
}  # fmt: skip


@pytest.fixture
def load(tmp_path):
    def read(text: str):
        path = tmp_path / "arm.toml"
        path.write_text(text, encoding="utf-8")
        return load_robot(path)

    return read


def test_every_number_of_a_file_may_be_text_with_a_unit(load):
    text, plain = PLAIN, load(PLAIN)
    for number, words in WRITTEN.items():
        assert text.count(number) == 1
        text = text.replace(number, words)
    robot = load(text)
    assert [p.name for p in robot.parameters] == [p.name for p in plain.parameters]
    for one, other in zip(robot.parameters, plain.parameters):
        numbers = [(p.value, p.tolerance, *p.interval) for p in (one, other)]
        np.testing.assert_allclose(*numbers, rtol=1e-12, err_msg=one.name)
    np.testing.assert_allclose(robot.speed_limits, plain.speed_limits, rtol=1e-15)
    assert robot.effort_limits == plain.effort_limits
    np.testing.assert_array_equal(robot.home, plain.home)


@pytest.mark.parametrize(
    ("number", "words", "expected"),
    [
        ("10000.0", "'10 kNm'", ["stiffness", "N·m/rad", "10 kNm"]),
        ("10000.0", "'10 kN/m'", ["stiffness", "N·m/rad", "10 kN/m"]),  # of a joint that slides
        ("10000.0", "'10'", ["stiffness", "N·m/rad"]),
        ("10000.0", "'stiff'", ["stiffness", "N·m/rad"]),
        ("10000.0", "'nan N·m/rad'", ["stiffness"]),
        ("10000.0", "'1e400 N·m/rad'", ["stiffness"]),
        ("backlash = 1e-3", "backlash = '1 mm'", ["backlash", "rad"]),
        ("effort_limit = 0.6", "effort_limit = '6 V'", ["effort_limit", " in A,", "6 V"]),
        ("home = [0.5]", "home = ['5 mm']", ["home", "rad"]),
        ("length = 0.3", "length = '3 s'", ["link", "length", "m"]),
        ("stiffness = 12", "stiffness = '12'", ["tolerances", "%"]),
        ("sphere = 0.05", "sphere = '5 kg'", ["payload 1", "sphere", "m"]),
        ("gravity = 9.81", "gravity = '9.81 N'", ["gravity", "m/s²"]),
    ],
)
def test_a_unit_that_measures_something_else_is_refused(load, number, words, expected):
    with pytest.raises(InvalidInput) as caught:
        load(PLAIN.replace(number, words))
    error = caught.value
    assert all((error.what, error.found, error.advice))
    assert [word for word in expected if word not in str(error)] == []


def test_a_belts_stiffness_in_newtons_per_metre_is_explained(load):
    with refused_with(InvalidInput, "stiffness", "N·m/rad", 900, "r²", "belt", "prismatic"):
        load(PLAIN.replace("10000.0", "'900 N/m'"))


@pytest.mark.parametrize(
    "unit", sorted({u for q in QUANTITIES.values() for u in q[:2]} | {u for p in UNITS.values() for u in p})
)
def test_every_si_unit_reads_itself_and_no_other(unit):
    assert measured(f"2.5 {unit}", unit) == 2.5
    with pytest.raises(ValueError, match="kat"):
        measured("2.5 kat", unit)
    with pytest.raises(ValueError, match="kg"):
        measured(f"2.5 kg·kg·{unit.lstrip('1') or 'm'}", unit)


@pytest.mark.parametrize(
    ("text", "si", "value"),
    [
        ("5 V/krpm", "V·s/rad", 0.005 * 30.0 / math.pi), ("3 Nm/deg", "N·m/rad", 540.0 / math.pi),
        ("2 Nms/rad", "N·m·s/rad", 2.0), ("2e3 N*mm", "N·m", 2.0), ("7 kg·m^2", "kg·m²", 7.0), ("0.8 Ohm", "Ω", 0.8),
        ("1 MN/m", "N/m", 1e6), ("1 mN", "N", 1e-3), ("90 DEG", "rad", math.pi / 2), ("4 kgm2", "kg·m²", 4.0),
        ("2 m/s/s", "m/s²", 2.0), ("8 m s^-2", "m/s²", 8.0), ("3 µH", "H", 3e-6), ("1 N·m·s²", "kg·m²", 1.0),
    ],
)  # fmt: skip
def test_units_as_people_write_them(text, si, value):
    assert measured(text, si) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "si", "meant"),
    [
        ("650 G", "kg", ["650 g"]), ("2 KG", "kg", ["2 kg"]), ("420 MM", "m", ["420 mm"]), ("2 M", "m", ["2 m"]),
        ("45 KNm/rad", "N·m/rad", ["45 kNm/rad"]), ("45 knm/rad", "N·m/rad", ["45 kNm/rad"]),
        ("5 nm", "N·m", ["5 Nm"]), ("5 n", "N", ["5 N"]), ("45 MNM", "N·m", ["45 mNm", "45 MNm"]),
        ("5 v", "V", ["5 V"]),
        ("3 S", "s", ["3 s"]), ("5 kat", "kg", []), ("x", "kg", []),
    ],
)  # fmt: skip
def test_a_unit_in_other_letters_is_refused_and_spelled(text, si, meant):
    """M is mega and m milli, G is gauss and K is kelvin."""
    with pytest.raises(ValueError, match=text):
        measured(text, si)
    assert respelled(text, si) == meant
    for one in meant:
        assert measured(one, si) > 0.0


@pytest.mark.parametrize(
    ("old", "new", "advice"),
    [
        ("mass = 2.0", "mass = '650 G'", "mass = '650 g'"),
        ("length = 0.3", "length = '420 MM'", "length = '420 mm'"),
        ("10000.0", "'45 KNm/rad'", "stiffness = '45 kNm/rad'"),
    ],
)
def test_a_robot_file_with_a_unit_in_other_letters_is_told_the_right_ones(load, old, new, advice):
    with pytest.raises(InvalidInput) as caught:
        load(PLAIN.replace(old, new))
    assert advice in caught.value.advice


@pytest.mark.parametrize(
    ("old", "new", "found", "advice"),
    [
        ("home = [0.5]", "home = '35deg'", "'35deg'", 'home = ["35deg"]'),
        ("home = [0.5]", "home = '35°'", "'35°'", 'home = ["35°"]'),
        ("limits = [-3.141592653589793, 3.141592653589793]", "limits = '90deg'", "2 numbers, got '90deg'", '"90deg"]'),
        ("range = [0.0, 3.0]", "range = '3 kg'", "2 numbers, got '3 kg'", 'range = ["3 kg", "3 kg"]'),
        (
            "sphere = 0.05", "centre_of_mass = { value = '5cm' }", "3 numbers, got '5cm'",
            'centre_of_mass = ["5cm", "5cm", "5cm"]',
        ),
        ("sphere = 0.05", "box = '5cm'", "3 numbers, got '5cm'", 'box = ["5cm", "5cm", "5cm"]'),
    ],
)  # fmt: skip
def test_text_where_a_list_belongs_is_shown_as_it_was_written(load, old, new, found, advice):
    with pytest.raises(InvalidInput) as caught:
        load(PLAIN.replace(old, new))
    assert "list" in caught.value.found
    assert found in caught.value.found
    assert advice in caught.value.advice


#: What numbers and units are made of, and look-alikes: digits of other scripts, fractions, signs, control.
LETTERS = "0123456789.,eE+-_*/^·×()[]%°²³⁻¹½٣３∞−µμΩℵınaifxradgcmkNsJHzVApprm \t\n\x00\x7f\u200b\ufeff😀"


@given(st.text(LETTERS, max_size=60), st.sampled_from(["rad", "N·m/rad", "kg·m²", "1"]))
def test_any_text_is_a_finite_number_or_refused(text, si):
    for words in (text, f"3 {text}", f"3 m{text}", f"{text} {si}"):
        try:
            found = measured(words, si)
        except ValueError:
            continue
        assert math.isfinite(found)


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ("[joint.spring]", "[joint.a.spring]", "'a'"),
        ("[joint.spring]", "[joint.yaw.spring]", "'yaw'"),
        ("[joint.spring]", "[[joint.a.spring]]", "'a'"),
        ("[joint.spring]", "[[joint.spring]]", "'a'"),
        ("[joint.spring]", "[a.spring]", "'a'"),
        ("[joint.spring]", "[yaw.spring]", "'yaw'"),
        ("[joint.spring]", "[spring]", ""),
        ("[joint.spring]", "[joints.spring]", ""),
        ("[[joint]]", "[joint]", "'a'"),
        ("[[joint]]", "[[joints]]", ""),
        ('[[joint]]\nname = "a"', "[joint.a]", "'a'"),
        ("[joint.spring]", "[joint]", ""),
        ("[[joint]]", "[joint.link]\n[[joint]]", ""),
    ],
)
def test_a_table_that_is_not_where_a_joint_has_it_is_told_how_to_write(load, old, new, name):
    assert PLAIN.count(old) == 1
    with pytest.raises(InvalidInput) as caught:
        load(PLAIN.replace(old, new))
    assert "[[joint]]" in caught.value.advice
    assert "[joint.spring]" in caught.value.advice
    assert name in str(caught.value)


def test_arc_minutes_and_seconds_are_angles(load):
    turn = math.pi / 180.0
    assert measured("4.7 Nm/arcmin", "N·m/rad") == pytest.approx(4.7 * 60.0 / turn, rel=1e-14)
    assert measured("90 ARCSEC", "rad") == pytest.approx(turn / 40.0, rel=1e-14)
    robot = load(PLAIN.replace("10000.0", "'2.5 N·m/arcmin'").replace("1e-3", "'3 arcmin'"))
    assert robot.nominal["stiffness"] == pytest.approx(2.5 * 3437.746770784939)
    assert robot.nominal["backlash"] == pytest.approx(turn / 20.0)


def test_a_number_is_not_repeated_with_a_unit_that_makes_it_another(load):
    with refused_with(InvalidInput, "stiffness", "N·m/rad") as refused:
        load(PLAIN.replace("10000.0", "'4.7 Nm/gon'"))
    assert unnamed(refused.value.advice, 4.7) == [4.7]


@pytest.mark.parametrize(
    ("old", "new", "home"),
    [
        ("[joint.motor]\n", "[joint.motor]\neffort_limit = 2\n", "[[joint]]"),
        ("[joint.motor]\n", "[joint.motor]\nstiffness = 2\n", "[joint.spring]"),
        ("[joint.link]\n", "[joint.link]\ngear_ratio = 2\n", "[joint.motor]"),
    ],
)
def test_a_key_of_another_table_is_told_where_it_belongs(load, old, new, home):
    with refused_with(InvalidInput, new.split()[1]) as refused:
        load(PLAIN.replace(old, new))
    assert home in refused.value.advice
