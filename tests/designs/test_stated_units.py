"""A unit is refused where its joint or its sensor has another kind: no length is taken for an angle."""

from __future__ import annotations

import copy
import math
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.refusals import refused_with, unnamed

from flexhinf.cli.messages import error_text
from flexhinf.designs import Specification, compare, design
from flexhinf.designs.design_file import request_document
from flexhinf.designs.loop_setup import LoopPlants
from flexhinf.designs.noise_levels import other_quantisation
from flexhinf.designs.request import read_request
from flexhinf.designs.specification import SpecificationError
from flexhinf.designs.stated_units import check_stated_units
from flexhinf.options import Stated
from flexhinf.pages.terminal import noise_text

Named = Callable[[str], Any]


@pytest.mark.parametrize(
    ("fields", "found", "advice"),
    [
        ({"pose": "0.1,30mm"}, ("rad", "deg", "'30mm'"), "--pose 0.1,30deg"),
        ({"pose": "30deg,30°"}, ("m", "mm", "'30deg'"), "--pose 30mm,30°"),
        ({"pose": ["5mm", "0.3 m"]}, ("rad", "deg", "'0.3m'"), "--pose 5mm,0.3rad"),
        ({"start": "0.1rad,0.1"}, ("m", "mm", "'0.1rad'"), "--start 0.1m,0.1"),
        ({"via": ["1mm,2deg", "1mm,2mm"]}, ("'2mm'",), "--via 1mm,2deg"),
        ({"tracking_error": "1deg"}, ("m", "mm", "'1deg'"), "--tracking-error 1mm,1deg"),
        ({"integral_dead_zone": "0.5mm"}, ("'0.5mm'",), "--set integral_dead_zone=0.5mm,0.5deg"),
        ({"remaining_error": "1mm"}, ("rad", "mrad", "'1mm'"), "--remaining-error 1mm,1mrad"),
        ({"path_distance": "2mm,2mm"}, ("rad", "mrad"), "--set path_distance=2mm,2mrad"),
        ({"peak_speed": "2,0.5m/s"}, ("rad/s", "deg/s"), "--peak-speed 2,0.5rad/s"),
        ({"peak_speed": "100rpm,100rpm"}, ("m/s", "mm/s"), "--peak-speed 100mm/s,100rpm"),
        ({"quantisation": "0.1mm"}, ("'0.1mm'",), "--quantisation 0.1mm,0.1deg"),
        (
            {"quantisation": "1Nm,0.1rad", "measured": ("joint_torque", "link_position_arm")},
            ("N", "'1Nm'"), "--quantisation 1N,1Nm,0.1rad",
        ),
    ],
)  # fmt: skip
def test_a_unit_of_the_other_kind_of_joint_is_refused(
    robot_of: Named, fields: dict[str, Any], found: tuple[str, ...], advice: str
) -> None:
    robot, s = robot_of("cart"), Specification(**fields)
    with refused_with(SpecificationError, "unit") as refused:
        check_stated_units(robot, s)
    assert re.search(r"'\w+_(belt|arm)'", refused.value.what)
    assert unnamed(refused.value.found, *found) == []
    assert error_text(refused.value).endswith(advice)


def test_units_that_fit_and_numbers_without_one_are_taken(robot_of: Named) -> None:
    robot = robot_of("cart")
    fields: dict[str, Any] = {
        "pose": "30mm,30deg", "start": (0.03, 0.3), "via": [["1mm", "2deg"]], "tracking_error": 0.01,
        "integral_dead_zone": "1e-3", "peak_speed": "0.5m/s,inf", "quantisation": "1mm,0.1deg,0.1Nm",
        "measured": ("link_position", "joint_torque_arm"), "bandwidth": "1Hz",
    }  # fmt: skip
    check_stated_units(robot, Specification(**fields))
    turning = Specification(pose="30deg", tracking_error="1deg", quantisation="1deg", peak_speed="1rpm")  # type: ignore[arg-type]
    check_stated_units(robot_of("paper"), turning)
    check_stated_units(robot_of("planar-two-link"), replace(turning, pose=(0.1, 0.2)))
    check_stated_units(robot, Specification(pose="1mm,1deg,1mm"))  # type: ignore[arg-type]  a count is refused elsewhere


def test_every_way_to_a_design_refuses_them(robot_of: Named, tmp_path: Path) -> None:
    robot, wrong = robot_of("planar-two-link"), Specification(pose="30mm,0.1")  # type: ignore[arg-type]
    file = tmp_path / "design.toml"
    file.write_text("[design]\nrobot = 'planar-two-link'\npose = ['30mm', 0.1]\n", encoding="utf-8")
    for call in (
        lambda: design(robot, wrong),
        lambda: compare(robot, wrong, ["lqg"]),
        lambda: read_request("planar-two-link", settings={"pose": "30mm,0.1"}),
        lambda: read_request(file),
        lambda: read_request(file, settings={"pose": "1,1", "tracking_error": "1mm"}),
    ):
        with refused_with(SpecificationError, "unit", "'link_position_shoulder'"):
            call()
    assert read_request(file, settings={"pose": "30deg,0.1"}).specification.pose == (math.radians(30), 0.1)


def test_a_stated_number_keeps_its_unit_through_copies_and_is_a_float_in_every_sum() -> None:
    s = Specification(pose="30mm,0.1", quantisation="1mm")  # type: ignore[arg-type]
    for one in (s, replace(s, load=1.0), copy.deepcopy(s), pickle.loads(pickle.dumps(s))):
        first: Any = (one.pose or (None,))[0]
        assert one.pose == (0.03, 0.1)
        assert (type(first), first.number, first.unit, first.si) == (Stated, "30", "mm", "m")
        assert isinstance(one.quantisation, Stated)
        assert type(2.0 * one.quantisation) is float
    assert repr(s.pose) == "(0.03, 0.1)"


def test_other_sensors_of_a_rival_law_take_the_number_without_its_unit(robot_of: Named) -> None:
    s = Specification(quantisation="0.01deg")  # type: ignore[arg-type]
    robot, sensors = robot_of("planar-two-link"), ("joint_torque",)
    steps = other_quantisation(robot, s.measured, s.quantisation, s.estimator, sensors)
    assert type(steps) is float
    assert replace(s, measured=sensors, quantisation=steps).quantisation == steps


def test_noise_with_a_unit_is_an_rms_value_of_every_signal(robot_of: Named) -> None:
    """Of a number the variance is scaled by the kind of signal; a text holds for each; a design file keeps the text."""
    robot = robot_of("cart")

    def variances(stated: Any) -> list[float]:
        s = Specification(measured=("link_position", "joint_torque_arm"), measurement_noise=stated)
        check_stated_units(robot, s)
        document = request_document(s, "cart")
        again = Specification(
            measured=s.measured, measurement_noise=document["design"].get("measurement_noise", 1e-8)
        )  # type: ignore[union-attr]
        found = LoopPlants(robot, s).noise_variances
        assert LoopPlants(robot, again).noise_variances.tolist() == found.tolist()
        assert LoopPlants(robot, replace(s, seed=1)).noise_variances.tolist() == found.tolist()
        return found.tolist()

    assert variances("0.2mm,0.1mrad,0.5Nm") == pytest.approx([4e-8, 1e-8, 0.25], rel=1e-12)
    assert variances(1e-8)[:2] == pytest.approx([1e-10, 1e-8], rel=1e-12)
    one = Specification(measured="motor_position", measurement_noise="0.1mrad")  # type: ignore[arg-type]
    assert LoopPlants(robot_of("planar-two-link"), one).noise_variances == pytest.approx([1e-8, 1e-8])
    assert unnamed(noise_text(LoopPlants(robot_of("paper"), one)), "0.1 mrad rms", "stated") == []
    for wrong in ("-0.1mrad", "0.1kg", "0mrad"):
        with refused_with(SpecificationError, "noise"):
            Specification(measurement_noise=wrong)  # type: ignore[arg-type]
    mixed = Specification(measured=("link_position", "joint_torque"), measurement_noise="0.1mrad")  # type: ignore[arg-type]
    with refused_with(SpecificationError, "unit") as refused:
        check_stated_units(robot_of("planar-two-link"), mixed)
    assert unnamed(refused.value.advice, "0.1mrad,0.1mrad,0.1Nm,0.1Nm") == []
