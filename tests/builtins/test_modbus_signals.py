"""Modbus signals of programs, on simulated units."""

import errno

import pytest

from emulator.lifecycle.safety import SafetyEvent
from emulator.services.modbus import ModbusUnit
from tests.networks import MemoryModbus, MemoryUnit
from tests.rows import each_row
from urproto.modbus import ExceptionCode, Function
from urproto.modes import ControlMode

UNIT = ModbusUnit("10.0.0.5", 255)
ADD = 'modbus_add_signal("10.0.0.5", 255, {address}, {type}, "s"{more})\n'


@pytest.fixture
def modbus(rig) -> MemoryModbus:
    backend = MemoryModbus()
    backend.units[UNIT] = MemoryUnit({0: 1, 1: 0, 2: 1}, {0: 40000, 1: 7, 2: 8, 3: 9})
    rig.controller.programs.modbus.backend = backend
    return backend


def add(type_: int, address: int = 0, more: str = "") -> str:
    return ADD.format(type=type_, address=address, more=more)


def sent(modbus: MemoryModbus, function: Function) -> list[tuple[int, ...]]:
    return [request.values for request in modbus.units[UNIT].requests if request.function == function]


@pytest.mark.parametrize(
    ("type_", "address", "more", "expected_text", "function"),
    [
        (0, 0, "", "True", Function.READ_DISCRETE_INPUTS),
        (1, 1, "", "False", Function.READ_COILS),
        (2, 0, "", "40000", Function.READ_INPUT_REGISTERS),
        (3, 1, "", "7", Function.READ_HOLDING_REGISTERS),
        (15, 0, ", False, 3", "[True,False,True]", Function.READ_COILS),
        (16, 1, ", register_count=3", "[7,8,9]", Function.READ_HOLDING_REGISTERS),
        (16, 1, "", "7", Function.READ_HOLDING_REGISTERS),
    ],
)
def test_each_signal_type_reads_its_table(rig, modbus, type_, address, more, expected_text, function):
    rig.run(add(type_, address, more) + 'sleep(0.01)\ntextmsg(modbus_get_signal_status("s"))')
    assert rig.texts == [expected_text]
    assert {request.function for request in modbus.units[UNIT].requests} == {function}


@pytest.mark.parametrize(
    ("type_", "more", "call", "function", "values"),
    [
        (1, "", 'signal("s", False)', Function.WRITE_COILS, (0,)),
        (3, "", 'register("s", 65535)', Function.WRITE_REGISTER, (65535,)),
        (3, "", 'register("s", 300.0)', Function.WRITE_REGISTER, (300,)),
        (15, ", False, 3", 'signal("s", [False, True])', Function.WRITE_COILS, (0, 1, 1)),
        (16, ", False, 3", 'register("s", [1, 2])', Function.WRITE_REGISTERS, (1, 2, 8)),
        (16, "", 'register("s", 5, False)', Function.WRITE_REGISTERS, (5,)),
    ],
)
def test_an_output_is_read_until_it_is_set_and_written_afterwards(rig, modbus, type_, more, call, function, values):
    rig.run(add(type_, 0, more) + f"sleep(0.15)\nmodbus_set_output_{call}\nsleep(0.25)")
    functions = [request.function for request in modbus.units[UNIT].requests]
    reads = functions.index(function)
    assert reads == 2, "two turns at 10 Hz before it was set"
    assert set(functions[reads:]) == {function}
    assert set(sent(modbus, function)) == {values}


def test_digital_outputs_on_cb3_are_written_individually(cb3):
    backend = MemoryModbus()
    backend.units[UNIT] = MemoryUnit({0: 0})
    cb3.controller.programs.modbus.backend = backend
    cb3.run(add(1) + 'modbus_set_output_signal("s", True)\nsleep(0.1)')
    assert {request.function for request in backend.units[UNIT].requests} == {Function.WRITE_COIL}


def test_the_update_frequency_is_in_robot_time(rig, modbus):
    rig.run(add(0) + 'modbus_set_signal_update_frequency("s", 20)\nsleep(1)')
    assert len(modbus.units[UNIT].requests) == pytest.approx(20, abs=1)


def test_signals_of_a_unit_take_turns(rig, modbus):
    signals = "".join(f'modbus_add_signal("10.0.0.5", 255, {i}, 2, "s{i}")\n' for i in range(4))
    fast = "".join(f'modbus_set_signal_update_frequency("s{i}", 500)\n' for i in range(4))
    rig.run(signals + fast + "sleep(0.4)")
    addresses = [request.address for request in modbus.units[UNIT].requests]
    assert len(addresses) == pytest.approx(200, abs=3), "one in each control period"
    assert all(addresses.count(i) == pytest.approx(50, abs=2) for i in range(4))


def test_a_signal_without_frequency_is_read_on_request(rig, modbus):
    rig.run(
        add(3)
        + """
        modbus_set_signal_update_frequency("s", 0)
        sleep(1)
        textmsg(modbus_get_signal_status("s"))
        modbus_set_output_register("s", 3)
        sleep(1)
        """
    )
    functions = [request.function for request in modbus.units[UNIT].requests]
    assert functions == [Function.READ_HOLDING_REGISTERS] * 2 + [Function.WRITE_REGISTER]
    assert rig.texts == ["40000"]


def test_a_requested_update_does_not_wait_for_the_frequency(rig, modbus):
    rig.run(add(2) + 'modbus_set_signal_update_frequency("s", -1)\nsleep(0.5)')
    before = len(modbus.units[UNIT].requests)
    rig.run('modbus_request_update_signal_value("s")\nsleep(0.5)')
    assert len(modbus.units[UNIT].requests) == before + 1
    assert "no Modbus signal" in rig.fault('modbus_request_update_signal_value("t")')


def test_a_program_waits_for_a_requested_answer(rig, modbus):
    modbus.silent.add(UNIT)
    rig.start(add(2) + 'modbus_set_signal_update_frequency("s", -1)\ntextmsg(modbus_get_signal_status("s"))')
    rig.seconds(1.0)
    assert rig.texts == []
    modbus.speak(UNIT)
    rig.tick(3)
    assert rig.texts == ["40000"]


def test_deleting_a_signal_releases_threads_waiting_for_it(rig, modbus):
    modbus.silent.add(UNIT)
    rig.start(add(2) + 'modbus_set_signal_update_frequency("s", 0)\ntextmsg(modbus_get_signal_status("s"))')
    rig.seconds(0.1)
    rig.submit('sec tidy():\n  modbus_delete_signal("s")\nend\n')
    rig.seconds(0.1)
    assert 'there is no Modbus signal "s"' in rig.exceptions[0].text


def test_a_preamble_for_a_missing_device_does_not_affect_the_program(rig, modbus):
    """As PolyScope writes it for an installation with signals."""
    modbus.units.clear()
    took = rig.run(
        """
        modbus_add_signal("192.168.1.3", 255, 1, 0, "MODBUS_1", False)
        modbus_set_signal_update_frequency("MODBUS_1", 10)
        modbus_add_signal("192.168.1.3", 255, 1, 1, "MODBUS_2", False)
        modbus_set_signal_update_frequency("MODBUS_2", 10)
        modbus_set_runstate_dependent_choice("MODBUS_2",0)
        sleep(3)
        textmsg("done")
        """
    )
    assert rig.texts == ["done"]
    assert took == pytest.approx(3.0, abs=0.05)


def test_the_value_of_a_silent_device_is_valid_until_the_watchdog_expires(rig, modbus):
    modbus.silent.add(UNIT)
    rig.start(
        add(0) + 'textmsg(modbus_get_signal_status("s"))\nsleep(1.9)\nx = modbus_get_signal_status("s")\nsleep(0.2)'
    )
    rig.until(lambda: bool(rig.texts), 1.0)
    assert rig.texts == ["False"]
    rig.seconds(2.0)
    assert rig.exceptions == []
    text = rig.fault(add(0) + 'sleep(2.1)\nx = modbus_get_signal_status("s")')
    assert text == (
        'Modbus signal "s" has been invalid for more than 2 s (connection error -1, device error 0):'
        " check unit 255 at 10.0.0.5"
    )


def test_without_a_watchdog_time_only_a_valid_signal_can_be_read(rig, modbus):
    rig.run(add(2) + 'modbus_set_signal_watchdog("s", 0)\nsleep(0.2)\ntextmsg(modbus_get_signal_status("s"))')
    assert rig.texts == ["40000"]
    del modbus.units[UNIT]
    assert "invalid for more than 0 s" in rig.fault(
        add(2) + 'modbus_set_signal_watchdog("s", 0)\nsleep(0.2)\nx = modbus_get_signal_status("s")'
    )


def test_the_last_value_of_a_lost_device_holds_until_its_watchdog_expires(rig, modbus):
    unit = modbus.units[UNIT]
    rig.start(
        add(2)
        + """
        modbus_set_signal_watchdog("s", 0.5)
        while True:
          x = modbus_get_signal_status("s")
          t = modbus_get_time_since_signal_invalid("s")
          sync()
        end
        """
    )
    rig.seconds(1.0)
    variables = rig.controller.programs.variables
    assert (variables["x"], variables["t"]) == (40000, 0.0)
    del modbus.units[UNIT]
    rig.seconds(0.4)
    variables = rig.controller.programs.variables
    assert variables["x"] == 40000
    assert 0.3 < variables["t"] <= 0.5
    rig.seconds(0.3)
    assert "invalid for more than 0.5 s (connection error 111" in rig.exceptions[0].text
    modbus.units[UNIT] = unit
    rig.start('sleep(0.2)\ntextmsg(modbus_get_signal_status("s"))')
    rig.seconds(0.5)
    assert rig.texts == ["40000"], "valid again"


def test_setting_an_output_of_a_lost_device_ends_the_program_too(rig, modbus):
    modbus.units.clear()
    rig.run(add(1) + 'modbus_set_output_signal("s", True)')
    assert "invalid" in rig.fault('sleep(2.5)\nmodbus_set_output_signal("s", True)')


@each_row(
    ("broken", "there", "combined", "device", "connection"),
    [
        (0, True, 0, 0, 0),
        (ExceptionCode.DEVICE_FAILURE, True, 4, 4, 0),
        (0, False, errno.ECONNREFUSED << 16, 0, errno.ECONNREFUSED),
    ],
)
def test_errors(rig, modbus, broken, there, combined, device, connection):
    modbus.units[UNIT].broken = broken
    if not there:
        modbus.units.clear()
    rig.run(add(0) + "sleep(0.1)")
    errors = [rig.value(f'modbus_get_error("s"{source})') for source in ("", ", 1", ", error_source=2")]
    assert errors == [combined, device, connection]


def test_connecting_is_minus_one_in_the_upper_half(rig, modbus):
    modbus.silent.add(UNIT)
    rig.run(add(0))
    assert rig.value('modbus_get_error("s")') == -0x10000


def test_disconnected_and_a_device_error_read_as_in_the_manual(rig, modbus):
    rig.run(add(0) + 'modbus_set_signal_update_frequency("s", 0)\nsleep(0.1)')
    signal = rig.controller.programs.modbus.get("s")
    signal.device_error, signal.connection_error = 4, -2
    assert rig.value('modbus_get_error("s")') == -131068, "the example of the Script Manual"


def test_an_address_that_the_device_does_not_have(rig, modbus):
    rig.run(add(2, 99) + "sleep(0.1)")
    assert rig.value('modbus_get_error("s", 1)') == ExceptionCode.ILLEGAL_DATA_ADDRESS


def test_read_write_signal(rig, modbus):
    rig.run(
        """
        modbus_add_rw_signal("10.0.0.5", 255, 1, 2, 10, 3, "s")
        sleep(0.1)
        textmsg(modbus_get_signal_status("s"))
        modbus_set_output_register("s", [5, 6])
        sleep(0.2)
        textmsg(modbus_get_signal_status("s"))
        """
    )
    assert rig.texts == ["[7,8]", "[7,8]"]
    requests = modbus.units[UNIT].requests
    assert requests[0].function == Function.READ_HOLDING_REGISTERS
    assert (requests[-1].function, requests[-1].values, requests[-1].write_address) == (23, (5, 6, 0), 10)
    assert [modbus.units[UNIT].registers[address] for address in (10, 11, 12)] == [5, 6, 0]


def test_an_answer_in_flight_does_not_overwrite_a_set_value(rig, modbus):
    modbus.silent.add(UNIT)
    rig.start(
        add(3) + 'sleep(0.1)\nmodbus_set_output_register("s", 5)\nsleep(0.5)\ntextmsg(modbus_get_signal_status("s"))'
    )
    rig.seconds(0.2)
    modbus.speak(UNIT)
    rig.seconds(0.6)
    assert rig.texts == ["5"]


def test_signals_outlive_their_program_and_can_come_from_secondary_programs(rig, modbus):
    """URCaps add signals from a separate secondary program; the next main program uses them."""
    rig.submit('sec install():\n  modbus_add_signal("10.0.0.5", 255, 1, 2, "s")\nend\n')
    rig.seconds(0.2)
    rig.run('textmsg(modbus_get_signal_status("s"))')
    rig.run('textmsg(modbus_get_signal_status("s"))')
    assert rig.texts == ["7", "7"]


def test_a_secondary_program_does_not_wait(rig, modbus):
    rig.run(add(2, 1) + 'modbus_set_signal_update_frequency("s", 0)\nsleep(0.1)')
    rig.submit('sec read():\n  textmsg(modbus_get_signal_status("s", True))\nend\n')
    rig.tick(5)
    assert rig.texts == ["7"]


def test_a_reused_name_is_a_new_signal(rig, modbus):
    rig.run(add(2, 1) + add(2, 2) + 'sleep(0.1)\ntextmsg(modbus_get_signal_status("s"))')
    assert rig.texts == ["8"]
    assert modbus.released == [], "its unit is still in use"
    rig.run('modbus_delete_signal("s")\nmodbus_delete_signal("s")\nmodbus_delete_signal("never")')
    assert modbus.released == [UNIT]
    assert "there is no Modbus signal" in rig.fault('x = modbus_get_signal_status("s")')


@pytest.mark.parametrize(
    ("choice", "running", "stopped", "failed"),
    [
        (0, None, None, None),
        (1, None, 0, 0),
        (2, None, 1, 1),
        (3, 1, 0, 0),
        (4, None, None, 0),
        (5, 1, None, 0),
    ],
)
def test_levels_by_run_state(rig, modbus, choice, running, stopped, failed):
    """None: the program's own level stays."""
    signal = add(1) + f'modbus_set_runstate_dependent_choice("s", {choice})\n'
    own = 1 if choice == 1 else 0
    rig.start(signal + "sleep(0.2)\nwhile True:\n  sync()\nend")
    rig.seconds(0.1)
    wanted = rig.controller.programs.modbus.get("s")
    assert wanted.wanted == (None if running is None else (running,))
    if running is None:
        rig.submit(f'sec own():\n  modbus_set_output_signal("s", {bool(own)})\nend\n')
        rig.seconds(0.05)
    before = wanted.wanted
    rig.controller.programs.stop()
    rig.seconds(0.1)
    assert wanted.wanted == (before if stopped is None else (stopped,))
    rig.start("sleep(0.1)\nx = [1][5]")
    rig.until(lambda: bool(rig.exceptions), 2.0)
    assert wanted.wanted == (before if failed is None else (failed,))


def test_a_protective_stop_is_an_unscheduled_end(rig, modbus):
    rig.start(add(1) + 'modbus_set_runstate_dependent_choice("s", 5)\nwhile True:\n  sync()\nend')
    rig.seconds(0.1)
    rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    rig.seconds(0.1)
    rig.controller.programs.stop()
    rig.seconds(0.2)
    assert modbus.units[UNIT].coils[0] == 0


def test_a_custom_command_is_sent_unchanged(rig, modbus):
    rig.run('modbus_send_custom_command("10.0.0.5", 255, 6, [17,32,2,88])')
    assert modbus.units[UNIT].commands == [b"\x06\x11\x20\x02\x58"]


def test_reset_blocks_until_the_device_is_back(rig, modbus):
    unit = modbus.units.pop(UNIT)
    rig.start(add(0) + 'sleep(0.1)\nmodbus_reset_connection("10.0.0.5")\ntextmsg("back")')
    rig.seconds(3.0)
    assert rig.texts == []
    modbus.units[UNIT] = unit
    rig.seconds(0.2)
    assert rig.texts == ["back"]
    assert modbus.resets == ["10.0.0.5"]


def test_a_non_blocking_reset_and_a_reset_without_signals(rig, modbus):
    modbus.units.clear()
    took = rig.run(add(0) + 'modbus_reset_connection("10.0.0.5", False)\nmodbus_reset_connection("10.0.0.9")')
    assert took < 0.05


def test_update_on_request(rig, modbus):
    rig.run(
        add(0)
        + 'modbus_set_signal_update_frequency("s", 1)\nsleep(0.1)\nmodbus_request_update_signal_value("s")\nsleep(0.1)'
    )
    assert len(modbus.units[UNIT].requests) == 2


def test_without_a_network_units_are_unreachable(make_rig):
    rig = make_rig("ur5e", None)
    rig.run(add(0) + "sleep(0.1)")
    assert rig.value('modbus_get_error("s", 2)') == errno.ENETUNREACH


@each_row(
    ("call", "message"),
    [
        ('modbus_add_signal("", 255, 0, 0, "s")', "address of a Modbus unit must not be empty"),
        ('modbus_add_signal("10.0.0.5", 256, 0, 0, "s")', "must be 0 to 255, not 256"),
        ('modbus_add_signal("10.0.0.5", 255, -1, 0, "s")', "Modbus address -1 with 1 values is out of range"),
        (
            'modbus_add_signal("10.0.0.5", 255, 65535, 16, "s", False, 2)',
            "Modbus address 65535 with 2 values is out of range",
        ),
        ('modbus_add_signal("10.0.0.5", 255, 0, 23, "s")', "signal_type must be one of"),
        ('modbus_add_signal("10.0.0.5", 255, 0, 0, "")', "1 to 20 characters, not 0"),
        ('modbus_add_signal("10.0.0.5", 255, 0, 0, "012345678901234567890")', "1 to 20 characters, not 21"),
        ('modbus_add_signal("10.0.0.5", 255, 0, 16, "s", False, 124)', "1 to 123 values, not 124"),
        ('modbus_add_rw_signal("10.0.0.5", 255, 0, 1, 0, 122, "s")', "at most 121"),
        ('modbus_get_signal_status("x")', 'no Modbus signal "x": add it'),
        ('modbus_set_output_signal("x", True)', 'no Modbus signal "x"'),
        ('modbus_set_output_signal("in", True)', '"in" is a digital input, not a digital output'),
        ('modbus_set_output_register("out", 1)', '"out" is a digital output, not a register output'),
        ('modbus_set_output_signal("out", [True, True])', "takes 1 to 1 values, not 2"),
        ('modbus_set_output_signal("out", [])', "takes 1 to 1 values, not 0"),
        ('modbus_set_output_signal("out", 1)', "must be a bool"),
        ('modbus_set_output_register("word", 65536)', "words from 0 to 65535"),
        ('modbus_set_output_register("word", -1)', "words from 0 to 65535"),
        ('modbus_set_output_register("word", 0.5)', "an integer or a list of integers"),
        ('modbus_set_output_register("word", "a")', "an integer or a list of integers"),
        ('modbus_set_signal_update_frequency("in", 501)', "0 to 500 Hz"),
        ('modbus_set_signal_watchdog("in", 301)', "0 to 300 s"),
        ('modbus_set_runstate_dependent_choice("out", 6)', "0 to 5, not 6"),
        ('modbus_set_runstate_dependent_choice("in", 1)', "only outputs"),
        ('modbus_set_digital_input_action("out", "default")', "not a digital input"),
        ('modbus_set_digital_input_action("in", "teach")', '"default" or "freedrive"'),
        ('modbus_send_custom_command("10.0.0.5", 255, 0, [])', "function_code must be 1 to 127"),
        ('modbus_send_custom_command("10.0.0.5", 255, 6, [256])', "at most 252 bytes"),
        ('modbus_get_error("in", 3)', "0, 1 or 2, not 3"),
    ],
)
def test_errors_name_the_invalid_argument(rig, modbus, call, message):
    signals = "\n".join(
        f'modbus_add_signal("10.0.0.5", 255, 0, {type_}, "{name}")'
        for type_, name in ((0, "in"), (1, "out"), (3, "word"))
    )
    assert message in rig.fault(f"{signals}\n{call}")


def test_the_number_of_signals_is_limited(rig, modbus):
    text = rig.fault('i = 0\nwhile True:\n  modbus_add_signal("10.0.0.5", 255, 0, 0, to_str(i))\n  i = i + 1\nend')
    assert "there are already 500 Modbus signals" in text


def test_a_high_input_signal_enables_freedrive_while_its_unit_answers(rig, modbus):
    rig.run(add(0) + 'modbus_set_digital_input_action("s", "freedrive")\nsleep(0.2)')
    rig.seconds(0.2)
    assert rig.controller.snapshot.control_mode is ControlMode.TEACH
    del modbus.units[UNIT]
    rig.seconds(5.0)
    assert rig.controller.snapshot.control_mode is not ControlMode.TEACH


@pytest.mark.parametrize(
    ("choice", "expected_text"), [(3, None), (4, "must be 0 to 3, not 4"), (5, "must be 0 to 3, not 5")]
)
def test_cb3_has_run_state_choices_up_to_3(cb3, choice, expected_text):
    body = add(1) + f'modbus_set_runstate_dependent_choice("s", {choice})'
    if expected_text is None:
        cb3.run(body)
    else:
        assert expected_text in cb3.fault(body)
