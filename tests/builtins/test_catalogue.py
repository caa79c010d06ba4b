"""Every function of the controller exists in the versions that have it."""

import ast
import csv
import re
from pathlib import Path

import pytest

from emulator.builtins import LIBRARIES
from tests.rows import each_row
from urproto.versions import PolyscopeVersion
from urscript.builtins import LibrarySet

SET = LibrarySet(LIBRARIES)
# Names, first versions and signatures as in public function tables and client sources. In a version, a number
# is certain, "?" a guess, "x" any digit, "-" never. In a signature, a word as a default describes the value if omitted.
ROWS = list(csv.DictReader((Path(__file__).parent / "names.csv").read_text().splitlines()))


def words(text: str) -> frozenset[str]:
    return frozenset(text.split())


# Functions that ur_rtde 1.6's script calls on every version (its lines without a version tag and those of 3.x).
UR_RTDE = words(
    """
    enable_external_ft_sensor end_force_mode end_teach_mode force_mode force_mode_set_damping get_actual_tcp_pose
    get_actual_tool_flange_pose get_forward_kin get_inverse_kin get_inverse_kin_has_solution get_joint_torques
    get_target_tcp_speed get_tcp_offset is_steady is_within_safety_limits movej movel movep norm pose_sub
    pose_trans protective_stop read_input_float_register read_input_integer_register rtde_set_watchdog servoc
    servoj set_gravity set_payload set_tcp speedj speedl stopj stopl sync teach_mode textmsg
    write_output_float_register write_output_integer_register zero_ftsensor
    """
)
UR_RTDE_5 = words(
    """
    end_freedrive_mode force_mode_set_gain_scaling freedrive_mode ft_rtde_input_enable
    get_actual_joint_positions_history get_freedrive_status get_steptime get_target_payload get_target_payload_cog
    get_target_payload_inertia get_target_waypoint set_target_payload tool_contact
    """
)
UR_RTDE_523 = words(
    """
    get_coriolis_and_centrifugal_torques get_jacobian get_jacobian_time_derivative get_mass_matrix
    get_target_joint_accelerations direct_torque
    """
)

# Functions that the External Control program of the official client library calls; one text serves 3.14.3 to 5.9.
EXTERNAL_CONTROL = words(
    """
    socket_open socket_close socket_read_binary_integer socket_send_int servoj speedj speedl movej movel movep
    movec stopj stopl get_steptime get_joint_positions get_target_joint_positions get_target_joint_speeds
    get_actual_tcp_speed get_actual_joint_positions_history get_inverse_kin force_mode end_force_mode
    force_mode_set_damping force_mode_set_gain_scaling freedrive_mode end_freedrive_mode tool_contact set_payload
    set_target_payload set_tcp set_gravity set_tool_voltage zero_ftsensor ft_rtde_input_enable
    sleep sync textmsg popup str_cat to_str norm pow get_list_length protective_stop
    get_target_tcp_pose pose_trans
    """
)

# Functions in the preamble that PolyScope writes, documented or not (counted in public programs).
PREAMBLE = words(
    """
    set_gravity set_analog_outputdomain set_tool_voltage set_tcp set_standard_analog_input_domain
    set_tool_analog_input_domain set_input_actions_to_default set_safety_mode_transition_hardness
    set_tool_communication set_tool_output_mode set_tool_digital_output_mode set_target_payload
    set_runstate_gp_boolean_output_to_value set_runstate_standard_digital_output_to_value
    set_runstate_standard_digital_outputs set_runstate_outputs set_runstate_configurable_digital_outputs
    set_analog_inputrange close_popup varmsg tool_pose motion_version_set tool_wrench_limit_disable
    position_deviation_warning
    """
)


def available(version: str) -> set[str]:
    return set(SET.available(PolyscopeVersion.parse(version)))


@pytest.mark.parametrize(("column", "newest"), [("cb3", "3.15.8"), ("e", "5.29")])
def test_newest_version_has_every_name_of_its_series(column, newest):
    expected = {row["name"] for row in ROWS if row[column] != "-"}
    assert expected - available(newest) == set()


def _sure(text: str) -> PolyscopeVersion | None:
    return PolyscopeVersion.parse(text) if text.replace(".", "").isdigit() else None


@each_row("row", ROWS, ids=lambda row: row["name"])
def test_each_name_exists_from_its_first_version_on(row):
    builtin = SET.builtins[row["name"]]
    for first in (_sure(row["cb3"]), _sure(row["e"])):
        assert first is None or builtin.availability.covers(first) or row["name"] in {"set_target_payload"}


# Earlier, or on another series, than in the tables: the official control script is one text for both series.
EARLIER = {
    "force_mode_set_gain_scaling": "cb3",
    "set_target_payload": "cb3",
    "tool_contact": "cb3",
    "zero_ftsensor": "cb3",
    # guesses of the tables that ur_rtde's script, or the manual's change notes, contradict
    "force_mode_set_damping": "cb3",
    "get_freedrive_status": "cb3",
    "get_target_payload": "e",
    "get_target_payload_cog": "e",
    "get_target_payload_inertia": "e",
}


def test_direct_torque_is_in_polyscope_x_since_10_10():
    """Script Manual 5.25.1: its first form was released in 5.23 and 10.10; ur_rtde sends it to every PolyScope X."""
    availability = SET.builtins["direct_torque"].availability
    assert [availability.covers(PolyscopeVersion.parse(text)) for text in ("10.9", "10.10", "5.22", "5.23")] == [
        False, True, False, True,
    ]  # fmt: skip


@each_row("row", ROWS, ids=lambda row: row["name"])
def test_first_versions_match_the_tables(row):
    availability = SET.builtins[row["name"]].availability
    for series, first in (("cb3", availability.cb3), ("e", availability.e)):
        if EARLIER.get(row["name"]) == series:
            assert first is not None
        elif row[series] == "-":
            assert first is None
        else:
            minor = row[series].removesuffix("?").split(".")[1].replace("x", r"\d") or r"\d+"
            assert first is not None
            assert re.fullmatch(minor, str(first.minor)), f"{first}, not {row[series]}"


# (parameter, default of the tables): default here
OTHER_DEFAULTS = {
    ("servoj", "t"): None,  # one control period, which is 0.008 s on CB3 only
    ("reset_revolution_counter", "qNear"): None,  # the same: angles near 0
    ("get_pose", "ref_name"): None,  # MotionPlus manual: that of rel_name
}


def _listed_parameters(signature: str) -> list[tuple[str, str | None]]:
    """Names and defaults of a signature of the tables."""
    inside = signature.partition("(")[2].rstrip(")")
    parts = re.split(r",(?![^\[]*\])", inside) if inside else []
    pairs = (part.strip().partition("=") for part in parts)
    return [(name, default if equals else None) for name, equals, default in pairs]


@each_row("row", [row for row in ROWS if SET.builtins[row["name"]].status != "refused"], ids=lambda row: row["name"])
def test_parameter_names_and_defaults_match_the_tables(row):
    parameters = SET.builtins[row["name"]].parameters
    listed = _listed_parameters(row["signature"])
    assert [p.names[0] for p in parameters][: len(listed)] == [name for name, _ in listed]
    assert all(not p.required for p in parameters[len(listed) :])
    for parameter, (name, default) in zip(parameters, listed, strict=False):
        if (row["name"], name) in OTHER_DEFAULTS:
            assert parameter.default == OTHER_DEFAULTS[row["name"], name]
        elif default is not None:
            assert not parameter.required
            assert parameter.default == _value(default), name


def _value(default: str) -> object:
    """A default of the tables; None for a word that describes it."""
    try:
        value = ast.literal_eval(default.removeprefix("p"))
    except (ValueError, SyntaxError):
        return None
    if value == "a":  # speedl, stopl: the default of another parameter
        return None
    return tuple(value) if isinstance(value, list) else value


@each_row("version", ["3.14.3", "3.15.8", "5.9.4", "5.12.8", "5.22", "5.25.1"])
def test_names_used_by_clients_exist(version):
    names = available(version)
    wanted = {*EXTERNAL_CONTROL}
    if version not in ("3.14.3", "5.9.4"):
        wanted |= {*UR_RTDE}
    parsed = PolyscopeVersion.parse(version)
    if parsed >= PolyscopeVersion(5, 10):
        wanted |= {*UR_RTDE_5}
    if parsed >= PolyscopeVersion(5, 23):
        wanted |= {*UR_RTDE_523}
    missing = wanted - names
    if parsed < PolyscopeVersion(5, 10) and parsed.major == 5:
        missing -= {"set_target_payload"}  # the script chooses set_payload there
    assert missing == set()


def test_no_name_used_by_clients_or_preambles_is_refused():
    needed = {*UR_RTDE, *UR_RTDE_5, *UR_RTDE_523, *EXTERNAL_CONTROL, *PREAMBLE}
    assert {name for name in needed if SET.builtins[name].status == "refused"} == set()


def test_every_partial_built_in_says_what_is_missing():
    assert [b.name for b in SET.builtins.values() if b.status != "supported" and not b.note] == []


def test_every_supported_built_in_is_called_by_a_test():
    """Scripts in tests are text: a name occurs in it, or a test composes it (`get_{group}_digital_out`)."""
    files = (path for path in Path(__file__).parents[1].rglob("*.py") if path != Path(__file__))
    tokens = {token for path in files for token in re.findall(r"[\w{}]+", path.read_text())}
    templates = [
        re.compile(re.sub(r"{\w+}", r"[a-z]+", token)) for token in tokens if re.fullmatch(r"\w+_{\w+}_\w+", token)
    ]
    called = {name for name in SET.builtins if name in tokens or any(form.fullmatch(name) for form in templates)}
    assert {b.name for b in SET.builtins.values() if b.status != "refused"} - called == set()


def test_every_supported_built_in_is_documented():
    assert [b.name for b in SET.builtins.values() if b.status != "refused" and not b.doc] == []


def test_a_refused_name_compiles_and_stops_the_program_only_when_called(rig):
    e_series = PolyscopeVersion.parse("5.9")
    refused = next(b for b in SET.builtins.values() if b.status == "refused" and b.availability.covers(e_series))
    rig.run(f'if False:\n  {refused.name}(1)\nend\ntextmsg("fine")')
    assert rig.texts == ["fine"]
    assert rig.fault(f"{refused.name}(1)") == f"{refused.name} is not emulated: {refused.note}"
    assert (rig.exceptions[-1].line, rig.exceptions[-1].column) == (2, 3)


# Script Manuals of CB3: the first that documents a function, among those of 3.3.4, 3.10 and 3.15.4.
DOCUMENTED = {
    "3.3.4": "rtde_set_watchdog read_input_float_register socket_read_line",
    "3.10": "wrench_trans normalize get_target_payload get_target_payload_cog str_sub",
    "3.15.4": "assert freedrive_mode_no_incorrect_payload_check set_runstate_gp_integer_output_to_value "
    "set_runstate_gp_float_output_to_value get_target_tcp_pose_along_path pause_on_error_code",
}


@each_row("manual", DOCUMENTED)
def test_a_function_exists_from_the_first_manual_that_documents_it_on(manual):
    assert words(DOCUMENTED[manual]) - available(manual) == set()


def test_motionplus_is_known_by_name(make_rig):
    rig = make_rig("ur5e", "5.12")
    rig.run('if False:\n  mc_initialize(0, p[0, 0, 0, 0, 0, 0])\nend\ntextmsg("fine")')
    assert rig.texts == ["fine"]
    assert rig.fault("mc_run_motion()").startswith("mc_run_motion is not emulated: MotionPlus")
