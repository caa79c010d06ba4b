"""Calibrations: hash, chain of URDF frames, and files, against output of the vendor's tools."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import assume, given
from hypothesis import strategies as st
from kinematics_oracle import product_of_links

from tests.rows import each_row
from urproto.robots import DH, Calibration, CalibrationError, Joints, calibration_hash, load_model
from urproto.robots.calibration import LINKS, chain_of, dh_of

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FILES = {"ur5": GOLDEN / "calibration_ur5.yaml", "ur5e": GOLDEN / "calibration_ur5e.yaml"}

# config/*/default_kinematics.yaml of Universal_Robots_ROS2_Description 2.4.5, computed by the vendor's library
NOMINAL_HASHES = {
    "ur3": "calib_9122066269688285636",
    "ur3e": "calib_16756443741236045476",
    "ur5": "calib_209549117540498681",
    "ur5e": "calib_12788084448423163542",
    "ur10": "calib_17227329492635474227",
    "ur10e": "calib_5119701370761913513",
    "ur16e": "calib_1935737212149401527",
    "ur20": "calib_4890363623803256388",
    "ur30": "calib_12001109639981648826",
}

# deviations of a UR10 and two UR10e, in the tests of Universal_Robots_ROS2_Driver (ur_calibration): d, a, theta, alpha
MEASURED = [
    (
        "ur10",
        (0.00065609212979853, 1.4442162376284788, 0.854147723854608, -2.2989425877563705, -1.5734987e-05, 1.90724e-05),
        (4.6311376834935676e-05, -0.00012568315331862312, 0.00186216581161458, 9.918593870679266e-05, 4.21546e-06, 0),
        (-7.29007e-05, -0.01713897289704999, -0.03707159413492756, 0.054279462160583214, 1.488984e-07, 1.551499e-05),
        (0.000211987863869, -0.0072553625957652995, -0.013483226769541364, 0.00134958202273, -0.00126313616368, 0),
    ),
    (
        "ur10e",
        (-0.000144894975118, 303.469135666158195, -309.88394307789747, 6.41459904397394975, -4.4823e-05, -0.000870714),
        (0.000108651068627930392, 0.240324175250532346, 0.00180628180213493472, 2.63076e-05, 3.96638e-06, 0),
        (1.59613e-07, -0.917209621528830232, 7.12936131346499469, 0.0710299029424392298, -1.64258e-06, 9.17286e-08),
        (-0.000444781952842, -0.00160215112531214153, 0.00631917793331091861, -0.001650552473408, 0.000763682515546, 0),
    ),
    (
        "ur10e",
        (
            -0.000160188285741,
            439.140974079900957,
            -446.027059806332147,
            6.88618689642360149,
            -3.86588e-05,
            -0.000879083,
        ),
        (2.12234865571e-05, 0.632017132627700651, 0.00229833638891230319, -4.61409e-05, -6.39280e-05, 0),
        (-2.41478e-07, 1.60233952386694556, -1.68607190752171299, 0.0837331147700118711, -1.0126e-07, 3.91986e-08),
        (-0.000650246557584, 0.00139416666825590402, 0.00693818880325995126, -0.000811641562390, 0.000411120504571, 0),
    ),
]


def measured(number: int) -> tuple[str, DH]:
    name, d, a, theta, alpha = MEASURED[number]
    nominal = load_model(name).dh

    def plus(one: Joints, other: Joints) -> Joints:
        return tuple(x + y for x, y in zip(one, other, strict=True))  # type: ignore[return-value]  # six

    return name, DH(plus(nominal.a, a), plus(nominal.d, d), plus(nominal.alpha, alpha), plus(nominal.theta, theta))


def urdf_product(content: dict, q: Joints) -> np.ndarray:
    """Forward kinematics of a file with URDF's convention: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    total = np.eye(4)
    for link, angle in zip(LINKS, q, strict=True):
        row = content["kinematics"][link]
        (sr, sp, sy), (cr, cp, cy) = ([f(row[k]) for k in ("roll", "pitch", "yaw")] for f in (math.sin, math.cos))
        rx = np.array(((1, 0, 0), (0, cr, -sr), (0, sr, cr)))
        ry = np.array(((cp, 0, sp), (0, 1, 0), (-sp, 0, cp)))
        rz = np.array(((cy, -sy, 0), (sy, cy, 0), (0, 0, 1)))
        s, c = math.sin(angle), math.cos(angle)
        frame = np.eye(4)
        frame[:3, :3] = rz @ ry @ rx @ np.array(((c, -s, 0), (s, c, 0), (0, 0, 1)))
        frame[:3, 3] = row["x"], row["y"], row["z"]
        total = total @ frame
    return total


@each_row("name", NOMINAL_HASHES)
def test_hash_of_nominal_arms(name: str) -> None:
    assert calibration_hash(load_model(name).dh) == NOMINAL_HASHES[name]


@pytest.mark.parametrize("name", FILES)
def test_parameters_of_a_public_file_reproduce_its_hash(name: str) -> None:
    """The file does not contain them; only the correct ones have the hash computed by the vendor's library."""
    content = yaml.safe_load(FILES[name].read_text())
    calibration = Calibration.from_mapping(content, "file")
    assert calibration.hash == content["kinematics"]["hash"] == calibration_hash(calibration.dh)
    assert calibration.is_whole
    calibration.check_model(load_model(name))


def test_ur_descriptions_own_file_of_a_nominal_arm() -> None:
    """Its UR5e, with the half turns by which ur_calibration writes a negative alpha."""
    rows = (
        (0.0, 0.0, 0.1625, 0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0, 1.570796327, 0.0, 0.0),
        (-0.425, 0.0, 0.0, 0.0, 0.0, 0.0),
        (-0.3922, 0.0, 0.1333, 0.0, 0.0, 0.0),
        (0.0, -0.0997, -2.044881182297852e-11, 1.570796327, 0.0, 0.0),
        (0.0, 0.09959999999999999, -2.042830148012698e-11, 1.570796326589793, 3.141592653589793, 3.141592653589793),
    )
    keys = ("x", "y", "z", "roll", "pitch", "yaw")
    content = {link: dict(zip(keys, row, strict=True)) for link, row in zip(LINKS, rows, strict=True)}
    calibration = Calibration.from_mapping({"kinematics": {**content, "hash": NOMINAL_HASHES["ur5e"]}}, "file")
    assert calibration.is_whole


@pytest.mark.parametrize("name", FILES)
def test_parameters_of_a_public_file_reproduce_its_frames(name: str) -> None:
    """Positions are the same regardless of the notation of angles."""
    content = yaml.safe_load(FILES[name].read_text())
    ours = Calibration.from_mapping(content, "file").to_mapping()
    for link in LINKS:
        for key in "xyz":
            assert ours["kinematics"][link][key] == pytest.approx(content["kinematics"][link][key], abs=1e-12), link


@each_row("number", range(len(MEASURED)))
def test_measured_arms(number: int) -> None:
    name, dh = measured(number)
    calibration = Calibration.of(dh)
    calibration.check_model(load_model(name))
    content = yaml.safe_load(yaml.safe_dump(calibration.to_mapping()))
    for link in LINKS:
        assert abs(content["kinematics"][link]["z"]) < 1.0, "back where the arm is"
    again = Calibration.from_mapping(content, "file")
    assert again.is_whole
    assert again.hash == calibration.hash
    for q in ((0.0,) * 6, (0.3, -1.2, 1.4, -0.7, 2.0, -3.0)):
        np.testing.assert_allclose(urdf_product(content, q), product_of_links(dh, q), rtol=0, atol=1e-9)
        np.testing.assert_allclose(product_of_links(again.dh, q), product_of_links(dh, q), rtol=0, atol=1e-9)


small = st.floats(-0.02, 0.02)
angles = st.tuples(*[st.floats(-math.pi, math.pi)] * 6)


@st.composite
def parameters(draw: st.DrawFn) -> DH:
    """Random parameters close to those of an arm; d2 and d3 as large as the nearly parallel axes of real arms
    require."""
    dh = load_model(draw(st.sampled_from(sorted(NOMINAL_HASHES)))).dh
    add = [[draw(small) for _ in range(6)] for _ in range(4)]
    d = [value + more for value, more in zip(dh.d, add[0], strict=True)]
    d[1], d[2] = draw(st.floats(-500, 500)), draw(st.floats(-500, 500))
    a = [value + more for value, more in zip(dh.a, add[1], strict=True)]
    alpha = [value + more for value, more in zip(dh.alpha, add[2], strict=True)]
    theta = [more * 100 for more in add[3]]
    return DH((*a[:5], 0.0), tuple(d), (*alpha[:5], 0.0), tuple(theta))  # type: ignore[arg-type]  # six each


@given(parameters(), angles)
def test_the_chain_describes_the_same_arm(dh: DH, q: Joints) -> None:
    content = Calibration.of(dh).to_mapping()
    np.testing.assert_allclose(urdf_product(content, q), product_of_links(dh, q), rtol=0, atol=1e-9)


@given(parameters(), angles)
def test_parameters_of_a_chain_describe_the_same_arm(dh: DH, q: Joints) -> None:
    assume(all(tilt == 0.0 or abs(tilt) > 1e-4 for tilt in dh.alpha[1:3]))  # otherwise precision is insufficient
    again = dh_of(chain_of(dh))
    np.testing.assert_allclose(product_of_links(again, q), product_of_links(dh, q), rtol=0, atol=1e-8)


def test_lists_of_parameters() -> None:
    _, dh = measured(1)
    lists = {"dh_theta": dh.theta, "dh_a": dh.a, "dh_d": dh.d, "dh_alpha": dh.alpha}
    content = yaml.safe_load(yaml.safe_dump({key: list(values) for key, values in lists.items()}))
    assert Calibration.from_mapping(content, "file").dh == dh


def test_a_modified_file_is_detected() -> None:
    content = Calibration.of(measured(1)[1]).to_mapping()
    content["kinematics"]["forearm"]["x"] += 1e-5
    assert not Calibration.from_mapping(content, "file").is_whole


def _without(key: str) -> dict:
    content = Calibration.of(measured(1)[1]).to_mapping()
    del content["kinematics"][key]
    return content


def _with(link: str, key: str, value: object) -> dict:
    content = Calibration.of(measured(1)[1]).to_mapping()
    content["kinematics"][link][key] = value
    return content


@each_row(
    ("content", "problem"),
    [
        (None, "neither `kinematics:` nor `dh_theta:`"),
        ({"kinematics": 3}, "neither"),
        (_without("wrist_1"), "wrist_1 is missing"),
        (_with("wrist_2", "roll", "much"), "roll of wrist_2 must be a number, not 'much'"),
        (_with("wrist_2", "roll", math.nan), "roll of wrist_2 must be a number"),
        (_with("forearm", "y", 0.01), "no Denavit-Hartenberg parameters"),
        ({"kinematics": {"hash": 7}}, "hash must be text"),
        ({"dh_theta": [0.0] * 6, "dh_a": [0.0] * 5}, "dh_a must be six numbers"),
    ],
)
def test_invalid_calibrations(content: object, problem: str) -> None:
    with pytest.raises(CalibrationError, match=problem):
        Calibration.from_mapping(content, "file")


def test_a_calibration_of_another_arm() -> None:
    _, dh = measured(0)
    with pytest.raises(CalibrationError, match=r"not a calibration of UR5: its shoulder is \d+ mm"):
        Calibration.of(dh).check_model(load_model("ur5"))
    with pytest.raises(CalibrationError, match="a6 and alpha6"):
        Calibration.of(replace(dh, alpha=(*dh.alpha[:5], 0.1)))
    with pytest.raises(CalibrationError, match="parallel"):
        Calibration.of(replace(dh, alpha=(dh.alpha[0], 1.5, *dh.alpha[2:])))
