"""ur_rtde's I/O interface, read back by its receive interface, and the registers programs share."""

import pytest
from rig import Rig, disconnecting
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

from tests.budget import subset

both_series = pytest.mark.parametrize("rig", subset(["ur3", "ur3e"], now=["ur3"]), indirect=True)


@both_series
@pytest.mark.parametrize(
    ("setter", "first_bit"),
    [("setStandardDigitalOut", 0), ("setConfigurableDigitalOut", 8), ("setToolDigitalOut", 16)],
)
def test_digital_outputs(
    rig: Rig, io: RTDEIOInterface, receive: RTDEReceiveInterface, setter: str, first_bit: int
) -> None:
    others = receive.getActualDigitalOutputBits() & ~(0b11 << first_bit)
    for level in (True, False):
        assert getattr(io, setter)(1, level)
        rig.eventually(lambda level=level: receive.getDigitalOutState(first_bit + 1) is level)
        assert receive.getDigitalOutState(first_bit) is False
    assert receive.getActualDigitalOutputBits() & ~(0b11 << first_bit) == others


@both_series
def test_analog_outputs_as_voltage_and_current(rig: Rig, io: RTDEIOInterface, receive: RTDEReceiveInterface) -> None:
    assert io.setAnalogOutputVoltage(0, 0.5)
    rig.eventually(lambda: receive.getStandardAnalogOutput0() == pytest.approx(5.0))  # half of 10 V
    assert io.setAnalogOutputCurrent(1, 0.25)
    rig.eventually(lambda: receive.getStandardAnalogOutput1() == pytest.approx(0.008))  # a quarter of 4-20 mA
    assert receive.getStandardAnalogOutput0() == pytest.approx(5.0)


@both_series
def test_speed_slider(rig: Rig, io: RTDEIOInterface, receive: RTDEReceiveInterface) -> None:
    assert io.setSpeedSlider(0.3)
    rig.eventually(lambda: receive.getTargetSpeedFraction() == pytest.approx(0.3))
    assert io.setStandardDigitalOut(0, True)  # other inputs leave the slider alone
    rig.eventually(lambda: receive.getDigitalOutState(0))
    assert receive.getTargetSpeedFraction() == pytest.approx(0.3)


def test_a_program_reads_input_and_returns_output_registers(
    rig: Rig, io: RTDEIOInterface, receive: RTDEReceiveInterface, control: RTDEControlInterface
) -> None:
    for register in range(18, 23):
        assert io.setInputIntRegister(register, register * 1000)
        assert io.setInputDoubleRegister(register, register + 0.25)
    with rig.watch("input_double_register_22") as state:  # these writes take some time to arrive
        state.wait_until(lambda sample: sample["input_double_register_22"] == 22.25)
    body = "".join(
        f"    write_output_integer_register({out}, read_input_integer_register({register}) + 1)\n"
        f"    write_output_float_register({out}, read_input_float_register({register}) * 2)\n"
        for out, register in zip(range(12, 17), range(18, 23), strict=True)
    )
    assert control.sendCustomScriptFunction("copy_registers", body)
    rig.eventually(lambda: receive.getOutputIntRegister(16) == 22001)
    assert [receive.getOutputIntRegister(n) for n in range(12, 17)] == [18001, 19001, 20001, 21001, 22001]
    assert [receive.getOutputDoubleRegister(n) for n in range(12, 17)] == [36.5, 38.5, 40.5, 42.5, 44.5]


def test_the_inputs_of_a_closed_connection_are_free_again(rig: Rig, receive: RTDEReceiveInterface) -> None:
    for level in (True, False, True):
        io = RTDEIOInterface(rig.host)
        with disconnecting(io):
            assert io.setStandardDigitalOut(4, level)
            rig.eventually(lambda level=level: receive.getDigitalOutState(4) is level)


def test_a_second_owner_of_the_same_inputs_is_refused(rig: Rig, io: RTDEIOInterface) -> None:
    with pytest.raises(RuntimeError, match="input registers are already in use"):
        RTDEIOInterface(rig.host)
