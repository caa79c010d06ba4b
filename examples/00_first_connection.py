"""Wake the arm up: power, then brakes, through the dashboard port. Nothing but the standard library.

python examples/00_first_connection.py [HOST]
"""

import socket
import sys
import time

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
DASHBOARD_PORT = 29999


def main() -> None:
    with socket.create_connection((HOST, DASHBOARD_PORT), timeout=5) as connection:
        stream = connection.makefile("rw", newline="\n")
        print(stream.readline().strip())

        def request(command: str) -> str:
            stream.write(command + "\n")
            stream.flush()
            answer = stream.readline().strip()
            print(f"{command:18} -> {answer}")
            return answer

        request("PolyscopeVersion")
        request("get robot model")
        request("power on")  # answered at once; the arm takes some seconds
        request("brake release")
        deadline = time.monotonic() + 30
        while request("robotmode") != "Robotmode: RUNNING":
            if time.monotonic() > deadline:
                sys.exit("the arm is still not running: what does `safetymode` answer?")
            time.sleep(0.5)
        print("The arm is ready: try examples/01_move_joints.py")


if __name__ == "__main__":
    main()
