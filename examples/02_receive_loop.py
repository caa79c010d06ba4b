"""Watch the robot at 125 Hz for two seconds. Needs `pip install ur-rtde`.

python examples/02_receive_loop.py [HOST]
"""

import sys

from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
FREQUENCY_HZ = 125.0
SECONDS = 2.0


def main() -> None:
    receive = RTDEReceiveInterface(HOST, FREQUENCY_HZ)
    stamps = []
    for count in range(int(SECONDS * FREQUENCY_HZ)):
        began = receive.initPeriod()
        stamps.append(receive.getTimestamp())  # the controller's clock, not this computer's
        if count % 50 == 0:
            force = receive.getActualTCPForce()
            print(f"t {stamps[-1]:9.3f} s   base joint {receive.getActualQ()[0]:7.4f} rad   Fz {force[2]:6.2f} N")
        receive.waitPeriod(began)
    receive.disconnect()
    print(f"{len(set(stamps))} different periods in {stamps[-1] - stamps[0]:.2f} s of the robot's time")


if __name__ == "__main__":
    main()
