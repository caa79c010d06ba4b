"""Switch outputs, slow the robot down, and read it all back. Needs `pip install ur-rtde`.

python examples/06_inputs_and_outputs.py [HOST]
"""

import sys
import time
from collections.abc import Callable

from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"


def wait_for(what: str, condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 2
    while not condition():
        if time.monotonic() > deadline:
            sys.exit(f"not seen within 2 s: {what}")
        time.sleep(0.01)
    print(what)


def main() -> None:
    io = RTDEIOInterface(HOST)
    receive = RTDEReceiveInterface(HOST)
    io.setStandardDigitalOut(3, True)
    wait_for("digital output 3 is high", lambda: receive.getDigitalOutState(3))
    io.setStandardDigitalOut(3, False)
    wait_for("digital output 3 is low", lambda: not receive.getDigitalOutState(3))
    io.setAnalogOutputVoltage(0, 0.25)  # a ratio of 10 V
    wait_for("analog output 0 has 2.5 V", lambda: abs(receive.getStandardAnalogOutput0() - 2.5) < 1e-6)
    io.setSpeedSlider(0.5)
    wait_for("the speed slider is at 50 %", lambda: receive.getTargetSpeedFraction() == 0.5)
    io.setSpeedSlider(1.0)
    wait_for("the speed slider is at 100 %", lambda: receive.getTargetSpeedFraction() == 1.0)
    io.disconnect()
    receive.disconnect()


if __name__ == "__main__":
    main()
