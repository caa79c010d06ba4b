"""Scripts that use and configure signals and registers."""

import pytest


@pytest.mark.parametrize(
    ("group", "bit"), [("standard", 0), ("standard", 7), ("configurable", 8), ("configurable", 15), ("tool", 17)]
)
def test_digital_outputs_and_inputs(rig, group, bit):
    first = {"standard": 0, "configurable": 8, "tool": 16}[group]
    rig.controller.signals.digital_inputs = 1 << bit
    n = bit - first
    rig.run(
        f"""
        set_{group}_digital_out({n}, True)
        textmsg(get_{group}_digital_out({n}))
        textmsg(get_{group}_digital_in({n}))
        """
    )
    assert rig.texts == ["True", "True"]
    rig.tick()
    assert rig.controller.snapshot.actual_digital_output_bits == 1 << bit
    rig.run(f"set_{group}_digital_out({n}, False)")
    assert rig.controller.signals.digital_outputs == 0


@pytest.mark.parametrize(("n", "bit"), [(3, 3), (8, 16), (9, 17)])
def test_old_functions_number_tool_signals_after_standard_signals(rig, n, bit):
    rig.controller.signals.digital_inputs = 1 << bit
    rig.run(f"set_digital_out({n}, True)\ntextmsg(get_digital_out({n}))\ntextmsg(get_digital_in({n}))")
    assert rig.texts == ["True", "True"]
    assert rig.controller.signals.digital_outputs == 1 << bit


@pytest.mark.parametrize(
    ("call", "bits"),
    [
        ("set_runstate_outputs([1])", 1 << 1),
        ("set_runstate_standard_digital_outputs([0, 3])", 1 << 0 | 1 << 3),
        ("set_runstate_configurable_digital_outputs([2])", 1 << 10),
    ],
)
def test_outputs_in_a_list_are_high_while_a_program_runs(rig, call, bits):
    rig.start(f"{call}\nsleep(0.5)")
    rig.seconds(0.2)
    assert rig.controller.snapshot.actual_digital_output_bits == bits
    rig.seconds(0.6)
    assert rig.controller.snapshot.actual_digital_output_bits == 0


def test_an_element_of_digital_out_is_an_output(rig):
    # python-urx sends this old form as a separate line
    rig.run("digital_out[2]=True\ntextmsg(get_digital_out(2))\ndigital_out[2] = False\ntextmsg(get_digital_out(2))")
    assert rig.texts == ["True", "False"]


def test_digital_out_may_also_be_a_variable(rig):
    rig.run("digital_out = [1, 2, 3]\ndigital_out[2] = 7\ntextmsg(digital_out)\ntextmsg(get_digital_out(2))")
    assert rig.texts == ["[1,2,7]", "False"]


def test_analog_signals(rig):
    signals = rig.controller.signals
    signals.analog_inputs[1], signals.tool_analog_inputs[0] = 2.5, 1.25
    rig.run(
        """
        set_analog_outputdomain(0, 1)
        set_standard_analog_out(0, 0.25)
        set_analog_out(1, 2)
        textmsg([get_standard_analog_in(1), get_tool_analog_in(0), get_analog_in(1), get_analog_in(2)])
        textmsg([get_standard_analog_out(0), get_analog_out(1)])
        """
    )
    assert rig.texts == ["[2.5,1.25,2.5,1.25]", "[0.25,1]"]
    assert signals.analog_output(0) == pytest.approx(2.5)
    assert signals.analog_output(1) == pytest.approx(0.020)


@pytest.mark.parametrize("number", ["0", "8", "47"])
def test_registers(rig, number):
    registers = rig.controller.registers
    registers.input.set_int(int(number), -5)
    registers.input.set_double(int(number), 0.5)
    registers.input.set_bit(int(number), True)
    rig.run(
        f"""
        textmsg([read_input_integer_register({number}), read_input_float_register({number})])
        textmsg(read_input_boolean_register({number}))
        write_output_integer_register({number}, 2147483647)
        write_output_float_register({number}, 1)
        write_output_boolean_register({number}, True)
        textmsg([read_output_integer_register({number}), read_output_float_register({number})])
        textmsg(read_output_boolean_register({number}))
        """
    )
    assert rig.texts == ["[-5,0.5]", "True", "[2147483647,1]", "True"]
    rig.tick()
    assert rig.controller.snapshot.output_int_registers[int(number)] == 2147483647


@pytest.mark.parametrize(
    "call",
    [
        "read_input_integer_register(48)",
        "write_output_float_register(-1, 0.0)",
        "read_output_boolean_register(128)",
        "write_output_integer_register(0, 3000000000.0)",
        "write_output_integer_register(0, 1.5)",
        'write_output_float_register(0, "1")',
        "write_output_boolean_register(0, 1)",
        "set_standard_digital_out(8, True)",
        "get_tool_digital_in(2)",
        "get_standard_analog_in(2)",
        "set_standard_analog_out(2, 0.5)",
        "set_tool_voltage(5)",
        "set_analog_outputdomain(0, 2)",
        "set_tool_output_mode(2)",
        'set_standard_digital_input_action(0, "dance")',
        'set_configurable_digital_input_action(9, "default")',
        "set_runstate_standard_digital_output_to_value(0, 8)",
        "set_runstate_standard_analog_output_to_value(0, -1)",
        "set_runstate_tool_digital_output_to_value(0, 6)",
        "set_tool_communication(True, 1234, 0, 1, 1.5, 3.5)",
    ],
)
def test_values_out_of_range_stop_the_program(rig, call):
    assert rig.fault(call)
    assert (rig.exceptions[-1].line, rig.exceptions[-1].column) == (2, 3)


# The head that PolyScope 5 writes, as counted in public programs.
PREAMBLE = """
global _hidden_verificationVariable=0
set_standard_analog_input_domain(0, 1)
set_standard_analog_input_domain(1, 1)
set_tool_analog_input_domain(0, 1)
set_tool_analog_input_domain(1, 1)
set_analog_outputdomain(0, 0)
set_analog_outputdomain(1, 0)
set_input_actions_to_default()
set_runstate_standard_digital_output_to_value(0, 0)
set_runstate_configurable_digital_output_to_value(0, 0)
set_runstate_gp_boolean_output_to_value(0, 0)
set_runstate_standard_analog_output_to_value(0, 0)
set_safety_mode_transition_hardness(1)
set_tcp(p[0.0,0.0,0.15,0.0,0.0,0.0])
set_gravity([0.0, 0.0, 9.82])
set_tool_communication(False, 115200, 0, 1, 1.5, 3.5)
set_tool_output_mode(0)
set_tool_digital_output_mode(0, 1)
set_tool_digital_output_mode(1, 1)
set_tool_voltage(24)
set_target_payload(1.2, [0.0, 0.0, 0.05], [0.002, 0.002, 0.002, 0.0, 0.0, 0.0])
set_runstate_outputs([])
position_deviation_warning(True, 0.8)
motion_version_set(1)
tool_wrench_limit_disable()
"""


def test_a_polyscope_preamble_takes_effect_without_messages(rig):
    took = rig.run(PREAMBLE)
    assert took < 0.05
    assert rig.texts == []
    rig.tick()
    snapshot = rig.controller.snapshot
    assert snapshot.analog_io_types == 0b0011
    assert snapshot.tool_output_voltage == 24
    assert snapshot.payload == 1.2
    assert snapshot.tcp_offset[2] == 0.15
