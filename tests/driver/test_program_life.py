"""Starting, ending, losing and recovering the control program."""

import asyncio
import socket
from dataclasses import replace

import pytest
from driver_rig import CALM_S, HOME, HOST, PATIENCE_S, Pair, swing

from client.driver import calibration_hash, points
from client.errors import NoAnswerError, ProgramEndedError, ScriptFailedError
from client.rtde import RTDEClient
from urproto.compat_asyncio import timeout
from urproto.errors import RobotRefused
from urproto.external_control import GREETING, TrajectoryResult
from urproto.modes import SafetyMode

LONG = points.movej([HOME[0] + 1.5, *HOME[1:]], v=0.5)


async def move_again(pair):
    """The next program works."""
    await pair.driver.start_program()
    here = [pair.q[0] - 0.05, *pair.q[1:]]
    assert await pair.driver.execute([points.movej(here, v=1, a=5)], PATIENCE_S) is TrajectoryResult.SUCCESS


async def test_callers_are_notified_when_the_program_connects_and_disconnects(connect):
    async with connect(start=False) as pair:
        reported = []
        pair.driver.on_program_state(reported.append)
        await pair.driver.start_program()
        await pair.driver.stop_program()
        assert reported == [True, False]
        await pair.until(lambda: pair.program_ended)
        await pair.driver.start_program()
        await pair.driver.start_program()
        assert reported == [True, False, True, False, True]


async def test_leaving_the_context_stops_the_arm_and_the_program(connect):
    async with connect() as pair:
        await pair.driver.start_trajectory([LONG])
        await pair.until(lambda: pair.snapshot.target_qd[0] > 0.1)
    await pair.until(lambda: pair.program_ended and pair.at_rest)


@pytest.mark.parametrize("lost", ["reverse", "trajectory", "commands"])
async def test_any_connection_lost_in_motion_stops_the_arm_and_ends_the_program(pair, lost):
    await pair.driver.start_trajectory([LONG])
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.1)
    getattr(pair.driver, lost).peer.abort()
    await pair.until(lambda: pair.program_ended and pair.at_rest)
    assert pair.distance() < 1.0
    with pytest.raises(ProgramEndedError):
        await pair.driver.trajectory_result(PATIENCE_S)
    await move_again(pair)


@pytest.mark.parametrize("lost", ["trajectory", "commands"])
async def test_the_program_notices_a_lost_connection_by_itself(pair, lost):
    """When the driver does not: only the robot's end is told."""
    pair.driver.trajectory.listeners.clear()
    pair.driver.commands.listeners.clear()
    if lost == "trajectory":
        await pair.driver.start_trajectory([points.movej(HOME, duration_s=0.5)] * 2)
    getattr(pair.driver, lost).peer.abort()
    await pair.until(lambda: pair.program_ended and pair.at_rest)
    await move_again(pair)


async def test_the_last_word_of_an_old_program_does_not_end_the_new_one(connect):
    """It comes by another connection than the end of that program, so it may come while the next one starts."""
    async with connect(start=False) as pair:
        reported = []
        pair.driver.on_program_state(reported.append)
        starting = asyncio.create_task(pair.driver.start_program())
        await asyncio.sleep(0)
        pair.driver.program._on_text(pair.driver.program.control_program().gone_text)
        await starting
        await pair.periods(20)
        assert reported == [True]
        assert not pair.driver.loss_reason


async def test_a_program_that_is_lost_while_the_driver_ends_is_not_restarted(connect):
    async with connect() as pair:
        listeners, program = pair.driver.link.on_text, pair.driver.program
        last_word = program.control_program().gone_text
    before = asyncio.all_tasks()
    for listener in listeners:
        listener(last_word)
    assert program.losses == 0
    assert asyncio.all_tasks() <= before


async def test_two_simultaneous_starts_start_one_program(connect):
    async with connect(start=False) as pair:
        reported = []
        pair.driver.on_program_state(reported.append)
        await asyncio.gather(pair.driver.start_program(), pair.driver.start_program())
        assert reported == [True]


@pytest.mark.parametrize("send", ["servoj", "speedj"])
async def test_a_driver_that_freezes_stops_the_arm(pair, send, monkeypatch):
    """Setpoints cease and no keep-alive follows, as when the driver's process hangs."""
    monkeypatch.setattr(pair.driver.keep_alive, "_cycle", lambda due_s: due_s)
    monkeypatch.setattr(pair.driver.reverse, "report_late", lambda *_: None)

    def setpoint(t):
        if send == "servoj":
            pair.driver.servoj(swing(t), 0.1)
        else:
            pair.driver.speedj([0.3, 0, 0, 0, 0, 0], 0.1)

    await pair.setpoints(0.8, setpoint)
    begin = pair.snapshot.timestamp
    await pair.until(lambda: pair.at_rest)
    assert pair.snapshot.timestamp - begin < 0.6
    await pair.until(lambda: pair.program_ended)
    await move_again(pair)


async def test_a_driver_that_freezes_during_a_trajectory_stops_the_arm(connect):
    async with connect(keep_alive_s=3600.0, keep_alive_timeout_s=0.3) as pair:
        await pair.driver.start_trajectory([LONG])
        begin = pair.snapshot.timestamp
        await pair.until(lambda: pair.program_ended and pair.at_rest)
        assert pair.snapshot.timestamp - begin < 1.0
        assert await pair.driver.trajectory_result(PATIENCE_S) is TrajectoryResult.CANCELED


@pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
async def test_port_scans_in_motion_change_nothing(pair):
    """From the robot's address, on every port: connections that end at once, are silent, or speak something else."""
    reported = []
    pair.driver.on_program_state(reported.append)
    await pair.driver.start_trajectory([points.movej([HOME[0] + 0.6, *HOME[1:]], v=0.5)])
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.1)
    kept = []
    for data in (b"", b"\0" * 200, b"GET / HTTP/1.0\r\n\r\n", GREETING + b"guessed\n"):
        for endpoint in (pair.driver.trajectory, pair.driver.commands, pair.driver.reverse, pair.driver.sender) * 3:
            _, writer = await asyncio.open_connection(HOST, endpoint.port)
            writer.write(data)
            kept.append(writer)
            (await asyncio.open_connection(HOST, endpoint.port))[1].close()
    assert await pair.driver.trajectory_result(PATIENCE_S) is TrajectoryResult.SUCCESS
    assert pair.driver.program_running
    assert reported == []
    for writer in kept:
        writer.transport.abort()


@pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
async def test_a_program_that_is_started_again_beside_silent_strangers_takes_over_at_once(pair):
    ends = (pair.driver.trajectory, pair.driver.commands, pair.driver.reverse)
    strangers = [await asyncio.open_connection(HOST, endpoint.port) for endpoint in ends]
    before = pair.driver.reverse.peer
    pair.robot.controller.programs.submit(pair.driver.program.control_program().render_headless(pair.driver.version))
    await pair.until(
        lambda: pair.driver.reverse.current_peer not in (None, before) and pair.driver.reverse.peer.authenticated
    )
    await pair.until(lambda: pair.driver.program_running)
    here = [pair.q[0] - 0.05, *pair.q[1:]]
    assert await pair.driver.execute([points.movej(here, v=1, a=5)], PATIENCE_S) is TrajectoryResult.SUCCESS
    for _, writer in strangers:
        writer.transport.abort()


@pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
async def test_a_silent_control_program_is_admitted_while_a_program_runs(connect):
    """As the vendor's; and the one that follows it. Strangers are not, whatever runs."""
    async with connect(start=False) as pair:
        foreign = replace(pair.driver.program.control_program(), token="").render_headless(pair.driver.version)
        strangers = [
            await asyncio.open_connection(HOST, end.port)
            for end in (pair.driver.trajectory, pair.driver.commands, pair.driver.reverse)
        ]
        await asyncio.sleep(0.5)
        assert not pair.driver.program_running  # nothing plays on the robot
        for _, writer in strangers:
            writer.close()
        for _ in range(2):
            pair.robot.controller.programs.submit(foreign)
            await pair.driver.wait_for_program(PATIENCE_S)
            here = [pair.q[0] - 0.05, *pair.q[1:]]
            assert await pair.driver.execute([points.movej(here, v=1, a=5)], PATIENCE_S) is TrajectoryResult.SUCCESS
            pair.robot.controller.programs.stop()
            await pair.driver.reverse.wait_disconnected()
        await pair.driver.start_program()
        assert pair.driver.reverse.peer.authenticated


async def test_an_idle_program_lives_as_long_as_its_driver(connect):
    async with connect(keep_alive_s=0.05, keep_alive_timeout_s=1.0) as pair:
        await pair.periods(round(1.2 / pair.robot.controller.period_s))
        assert pair.driver.program_running


async def test_a_robot_that_freezes_is_noticed_and_works_again(connect, robot):
    async with connect(silence_s=1.0) as pair:
        robot.clock.close()
        async with timeout(PATIENCE_S):
            while pair.driver.program_running:
                await asyncio.sleep(0.02)
        with pytest.raises(NoAnswerError):
            await pair.driver.next_state()
        robot.clock.start(robot._tick)
        await pair.until(lambda: pair.program_ended)
        async with timeout(PATIENCE_S):
            before = pair.driver.state["timestamp"]
            while pair.driver.state["timestamp"] == before:
                await asyncio.sleep(0.02)
        await move_again(pair)


async def test_the_robot_stops_the_program(pair):
    await pair.driver.start_trajectory([LONG])
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.1)
    pair.robot.controller.programs.stop()
    with pytest.raises(ProgramEndedError, match="trajectory"):
        await pair.driver.trajectory_result(PATIENCE_S)
    await move_again(pair)


async def test_a_pose_without_joint_angles_ends_the_program(pair):
    """The robot reports it, the driver is told that the program has ended."""
    await pair.driver.start_trajectory([points.movej_pose([9, 9, 9, 0, 0, 0])])
    with pytest.raises(ProgramEndedError):
        await pair.driver.trajectory_result(PATIENCE_S)
    await move_again(pair)


async def test_protective_stop_and_recovery(pair):
    modes = []
    pair.driver.on_safety_mode(modes.append)
    await pair.driver.start_trajectory([LONG])
    await pair.until(lambda: pair.snapshot.target_qd[0] > 0.1)
    await pair.driver.link.send_script("sec hit():\n  protective_stop()\nend")
    await pair.until(lambda: pair.driver.protective_stopped)
    with pytest.raises(RobotRefused, match="PROTECTIVE_STOP"):
        await pair.driver.start_program()
    await pair.driver.recover()
    assert modes == [SafetyMode.PROTECTIVE_STOP, SafetyMode.NORMAL]
    assert pair.driver.program_running
    await move_again(pair)


async def test_an_error_in_the_program_is_shown(connect, monkeypatch):
    async with connect(start=False) as pair:
        monkeypatch.setattr("client.driver.control_program._template", lambda: "textmsg(1)\nno_such_function()\n")
        with pytest.raises(ScriptFailedError, match="no_such_function"):
            await pair.driver.start_program()


async def test_a_driver_that_comes_later_is_found(robot):
    """The program asks the operator and tries again when the popup is closed."""
    with socket.create_server((HOST, 0)) as taken:
        port = taken.getsockname()[1]
    pair = Pair(robot, reverse_port=port)
    async with pair.driver:
        text = pair.driver.program.control_program().render_headless(pair.driver.version)
    with socket.socket() as held:
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind((HOST, port))  # no other test listens there meanwhile
        robot.controller.programs.submit(text)
        await pair.until(lambda: bool(robot.controller.popups.shown))
    assert f"There is no driver at {HOST}" in robot.controller.popups.shown[-1].text


async def test_two_robots_do_not_share_a_driver(pair):
    """The second one is sent away, the first goes on."""
    reader, writer = await asyncio.open_connection(HOST, pair.driver.reverse.port, local_addr=("127.0.0.2", 0))
    assert await reader.read() == b""
    writer.close()
    await pair.setpoints(0.2, lambda t: pair.driver.servoj(swing(t), CALM_S))
    assert pair.driver.program_running


async def test_calibration(connect):
    async with connect(start=False) as pair:
        found = calibration_hash(await pair.driver.link.kinematics())
    async with connect(calibration=found):
        pass
    with pytest.raises(RobotRefused, match="another arm"):
        async with connect(calibration="calib_0000000000000000"):
            pytest.fail("entered")


async def test_the_slider_of_another_client_is_left_alone(robot, connect):
    slider = [("speed_slider_mask", "speed_slider_fraction")]
    async with (
        RTDEClient(HOST, ["timestamp"], slider, port=robot.ports["rtde"]),
        connect(start=False) as pair,
    ):
        with pytest.raises(RobotRefused, match="another RTDE client"):
            await pair.driver.set_speed_slider(0.5)


@pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
async def test_the_program_of_the_pendant(robot, connect, tmp_path):
    """Not headless: loaded and played through the dashboard."""
    async with connect(start=False, headless=False, program="control.script") as pair:
        body = "".join(f"  {line}\n" for line in pair.driver.program_text().splitlines())
        (tmp_path / "control.script").write_text(f"def control():\n{body}end\n")
        await pair.driver.start_program()
        assert await pair.driver.execute([points.movej(HOME)]) is TrajectoryResult.SUCCESS
