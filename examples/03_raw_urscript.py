"""Send a URScript program over a plain socket and wait until it has ended. Standard library only.

    python examples/03_raw_urscript.py [HOST]

The arm has to be running: examples/00_first_connection.py does that.
"""

import socket
import sys
import time

HOST = sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1"
SCRIPT_PORT, DASHBOARD_PORT = 30002, 29999

PROGRAM = """
def nod():
  q = [0.2, -1.4, 1.5, -1.7, -1.5, 0.1]
  movej(q, a=4, v=2)
  times = 0
  while times < 2:
    q[3] = -1.3
    movej(q, a=4, v=2)
    q[3] = -1.7
    movej(q, a=4, v=2)
    times = times + 1
  end
  textmsg("nodded ", times)
end
"""


def dashboard(command: str) -> str:
    with socket.create_connection((HOST, DASHBOARD_PORT), timeout=5) as connection:
        stream = connection.makefile("rw", newline="\n")
        stream.readline()  # the greeting
        stream.write(command + "\n")
        stream.flush()
        return stream.readline().strip()


def wait_until(answer: str, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while dashboard("running") != f"Program running: {answer}":
        if time.monotonic() > deadline:
            sys.exit(f"the program is not where it should be (running: {answer}); is the arm running?")
        time.sleep(0.05)


with socket.create_connection((HOST, SCRIPT_PORT), timeout=5) as script_port:
    script_port.sendall(PROGRAM.encode())  # starts as soon as its last `end` has arrived
    wait_until("true", 2)
    print("the arm nods ...")
    wait_until("false", 20)
print("done")
