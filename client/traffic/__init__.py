"""What went over the wires of a robot: recorded on the way, played back, compared.

- ports: the ports of a controller, and those of a driver
- recorder: byte streams with their times into a pcapng file
- proxy: carries the connections of all ports, and has them recorded
- recording: a capture file's connections
- tracks, rtde_log: the states in a recording
- players, rtde_player, replay: a recording as a robot
- trajectories, align, messages, compare, report: two recordings held against each other

    async with record("192.168.56.101", Path("robot.pcapng")) as proxy:
        ...  # clients connect to 127.0.0.1 instead of the robot

    comparison = compare(Recording.read(Path("robot.pcapng")), Recording.read(Path("emulator.pcapng")))
    print(report(comparison))
"""

from client.traffic.compare import Comparison, compare
from client.traffic.proxy import Proxy, record
from client.traffic.recorder import Recorder
from client.traffic.recording import Recording
from client.traffic.replay import ReplayRobot
from client.traffic.report import report

__all__ = ["Comparison", "Proxy", "Recorder", "Recording", "ReplayRobot", "compare", "record", "report"]
