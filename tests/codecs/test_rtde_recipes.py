"""The field table and the packing of recipes, against construct and written-out bytes."""

from types import SimpleNamespace

import construct
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rows import each_row
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.modes import JointMode, RobotMode
from urproto.rtde.codec import OutputData, output_packer
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS, FieldType, available_fields
from urproto.rtde.recipes import Recipe, type_names
from urproto.versions import PolyscopeVersion

CB3 = PolyscopeVersion(3, 15, 8)
E_5_22 = PolyscopeVersion(5, 22)

SCALARS = {
    "BOOL": construct.Flag,
    "UINT8": construct.Int8ub,
    "UINT32": construct.Int32ub,
    "UINT64": construct.Int64ub,
    "INT32": construct.Int32sb,
    "DOUBLE": construct.Float64b,
    "VECTOR3D": construct.Array(3, construct.Float64b),
    "VECTOR6D": construct.Array(6, construct.Float64b),
    "VECTOR6INT32": construct.Array(6, construct.Int32sb),
    "VECTOR6UINT32": construct.Array(6, construct.Int32ub),
}
# the default recipe that RTDEReceiveInterface of ur_rtde requests from a 5.22 controller
UR_RTDE_DEFAULT = """
    timestamp target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current
    joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed
    actual_digital_input_bits joint_temperatures actual_execution_time robot_mode joint_mode safety_mode
    actual_tool_accelerometer speed_scaling target_speed_fraction actual_momentum actual_main_voltage
    actual_robot_voltage actual_robot_current actual_joint_voltage actual_digital_output_bits runtime_state
    standard_analog_input0 standard_analog_input1 standard_analog_output0 standard_analog_output1
    robot_status_bits safety_status_bits ft_raw_wrench payload payload_cog payload_inertia
    output_int_register_2"""
INTEGERS = {
    "UINT8": st.integers(0, 2**8 - 1),
    "UINT32": st.integers(0, 2**32 - 1),
    "UINT64": st.integers(0, 2**64 - 1),
    "INT32": st.integers(-(2**31), 2**31 - 1),
}


def values_of(field_type):
    doubles = st.floats(allow_nan=False, width=64)
    if field_type.wire_name == "BOOL":
        return st.booleans()
    scalar = INTEGERS.get(field_type.wire_name.removeprefix("VECTOR6"), doubles)
    return scalar if field_type.count == 1 else st.tuples(*[scalar] * field_type.count)


def snapshot(**changes):
    """An object with every output attribute, with consecutive numbers so that no two are the same."""
    attributes = {}
    for number, field in enumerate(OUTPUT_FIELDS.values()):
        if field.is_bits:
            attributes[field.attribute] = 0x0123456789ABCDEF_0F1E2D3C4B5A6978
        elif field.index is not None:
            attributes[field.attribute] = tuple(range(1000, 1048))
        elif field.type.count > 1:
            attributes[field.attribute] = tuple(number + part for part in range(field.type.count))
        else:
            attributes[field.attribute] = number % 200
    return SimpleNamespace(**{**attributes, **changes})


def test_the_table_has_every_variable_of_the_guide():
    assert (len(OUTPUT_FIELDS), len(INPUT_FIELDS)) == (408, 175)


@each_row(
    ("name", "version", "offered"),
    [
        ("actual_q", "3.3", True),
        ("safety_status", "3.9", False),
        ("safety_status", "3.10", True),
        ("safety_status", "5.3", False),
        ("ft_raw_wrench", "3.15.8", False),
        ("ft_raw_wrench", "5.9", True),
        ("output_int_register_23", "5.0", True),
        ("output_int_register_24", "5.0", False),
        ("output_bit_register_127", "3.9", True),
        ("payload_inertia", "3.14", False),
        ("payload_inertia", "3.15", True),
        ("actual_current_as_torque", "5.22", False),
        ("control_step", "10.13", True),
    ],
)
def test_first_versions(name, version, offered):
    assert (name in available_fields(OUTPUT_FIELDS, PolyscopeVersion.parse(version))) is offered


@each_row("name", ["output_bit_register_63", "input_bit_register_0", "output_int_register_48", "Actual_q"])
def test_names_that_do_not_exist(name):
    assert name not in OUTPUT_FIELDS
    assert type_names([name], OUTPUT_FIELDS) == ("NOT_FOUND",)


def test_reply_types_are_spelled_as_documented():
    names = ["timestamp", "target_q", "robot_mode", "joint_mode", "actual_digital_input_bits", "elbow_position", "nope"]
    expected = ("DOUBLE", "VECTOR6D", "INT32", "VECTOR6INT32", "UINT64", "VECTOR3D", "NOT_FOUND")
    assert type_names(names, available_fields(OUTPUT_FIELDS, CB3)) == expected


def test_default_receive_recipe_of_ur_rtde_has_1180_bytes():
    """Measured by others on a connection: 58 variables at 5.22, the package has 1180 bytes."""
    names = UR_RTDE_DEFAULT.split()
    names += [f"output_{kind}_register_{number}" for kind in ("int", "double") for number in range(12, 20)]
    recipe = Recipe.of(names, available_fields(OUTPUT_FIELDS, E_5_22))
    assert len(recipe.fields) == 58
    assert len(output_packer(recipe, 2)(snapshot())) == 1180


def test_unknown_names_are_refused_by_name():
    with pytest.raises(LocalProtocolError, match="nonsense"):
        Recipe.of(["timestamp", "nonsense"], OUTPUT_FIELDS)


@given(st.data())
def test_pack_agrees_with_construct(data):
    fields = data.draw(st.lists(st.sampled_from(list(OUTPUT_FIELDS.values())), min_size=1, max_size=20))
    values = tuple(data.draw(values_of(field.type)) for field in fields)
    packed = Recipe(fields).pack(values)
    oracle = construct.Sequence(*(SCALARS[field.type.wire_name] for field in fields))
    assert packed == oracle.build(values)
    assert Recipe(fields).unpack(packed) == values


def test_the_packer_reads_the_same_values_as_the_fields():
    recipe = Recipe(OUTPUT_FIELDS.values())
    source = snapshot(tool_output_voltage_2=24, tool_output_current_2=0.5)
    assert recipe.packer()(source) == recipe.pack([field.read(source) for field in recipe.fields])


@each_row(
    ("name", "expected"),
    [
        ("output_bit_registers0_to_31", 0x4B5A6978),
        ("output_bit_registers32_to_63", 0x0F1E2D3C),
        ("output_bit_register_64", True),
        ("output_bit_register_68", False),
        ("input_bit_register_120", True),
        ("output_int_register_0", 1000),
        ("input_double_register_47", 1047),
    ],
)
def test_registers_are_read_from_their_arrays(name, expected):
    assert OUTPUT_FIELDS[name].read(snapshot()) == expected


@pytest.mark.parametrize("protocol", [1, 2])
def test_the_output_packer_creates_complete_packages(protocol):
    recipe = Recipe.of(["robot_mode", "joint_mode"], OUTPUT_FIELDS)
    source = snapshot(robot_mode=RobotMode.NO_CONTROLLER, joint_mode=(JointMode.IDLE,) * 6)
    package = OutputData(recipe.pack((-1, (255,) * 6)), 7).encode(protocol)
    assert output_packer(recipe, protocol, 7)(source) == package


@each_row("values", [(), (1.0, 2.0), ("x",), (None,)])
def test_values_that_do_not_fit(values):
    with pytest.raises(LocalProtocolError):
        Recipe.of(["timestamp"], OUTPUT_FIELDS).pack(values)


@each_row("size", [0, 7, 9])
def test_wrong_size_is_a_remote_error(size):
    with pytest.raises(RemoteProtocolError, match="8 bytes"):
        Recipe.of(["timestamp"], OUTPUT_FIELDS).unpack(bytes(size))


def test_sizes_of_types():
    sizes = {kind.wire_name: kind.size for kind in FieldType}
    assert sizes == {name: oracle.sizeof() for name, oracle in SCALARS.items()}
