"""What went over the wires of a robot: recorded on the way, played back, compared.

- ports: the ports of a controller, and those of a driver
- recorder: byte streams with their times into a pcapng file
- proxy: carries the connections of all ports, and has them recorded
- recording: a capture file's connections
- tracks, rtde_log: the states in a recording
- players, rtde_player, replay: a recording as a robot
- trajectories, align, messages, compare, report: two recordings held against each other

    from client.traffic.proxy import record

    async with record("192.168.56.101", Path("robot.pcapng")) as proxy:
        ...  # clients connect to 127.0.0.1 instead of the robot

    from client.traffic.compare import compare
    from client.traffic.recording import Recording
    from client.traffic.report import report

    print(report(compare(Recording.read(Path("robot.pcapng")), Recording.read(Path("emulator.pcapng")))))
"""
