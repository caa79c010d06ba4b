"""A robot that is switched off and on again. This runs only with emulators, since the manuals do not describe it."""

from emulator_process import EmulatorProcess
from waiting import wait_until

from client import BlockingRTDEClient

OUTPUTS = ["timestamp", "robot_mode", "input_int_register_24"]


def test_rtde_reconnects_with_its_recipes():
    process = EmulatorProcess(["--model", "ur3"])
    try:
        process.start()
        with BlockingRTDEClient(
            process.host, OUTPUTS, [["input_int_register_24"]], frequency_hz=25, reconnect_s=60, timeout_s=2
        ) as rtde:
            rtde.write(input_int_register_24=5)
            wait_until(rtde, lambda state: state["input_int_register_24"] == 5)
            process.kill()
            process.start()
            state = wait_until(rtde, lambda state: rtde.core.reconnects == 1)
            assert set(state) == set(OUTPUTS)
            assert (
                state["input_int_register_24"] == 0
            )  # the controller lost them; the client leaves the decision to its caller
            rtde.write(input_int_register_24=6)
            wait_until(rtde, lambda state: state["input_int_register_24"] == 6)
            assert rtde.core.rate_hz == 25
        assert process.stop() == 0
    finally:
        process.dispose()
