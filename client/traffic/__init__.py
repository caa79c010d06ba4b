"""Network traffic of a robot: record, replay and compare it.

- ports: the ports of a controller, and those of a driver
- proxy: relay the connections of all ports
- recording: write connections to a pcapng file, and read those of a capture file
- tracks, rtde_log: the states in a recording
- players, rtde_player, replay: a recording as a robot
- trajectories, alignment, compare, report: compare two recordings

    from client.traffic.proxy import record

    async with record("192.168.56.101", Path("robot.pcapng")) as proxy:
        ...  # clients connect to 127.0.0.1 instead of the robot

    from client.traffic.compare import compare
    from client.traffic.recording import TrafficRecording
    from client.traffic.report import report

    print(report(compare(TrafficRecording.read(Path("robot.pcapng")), TrafficRecording.read(Path("emulator.pcapng")))))
"""
