"""The four ports alone, against a robot that is a plain socket."""

import asyncio
import socket
import struct
from contextlib import suppress

import pytest
from driver_rig import PATIENCE_S

from client.driver import ReverseEndpoint, ScriptCommandEndpoint, ScriptSender, TrajectoryEndpoint, points
from client.driver.reverse import read_timeout_ms
from client.errors import NoAnswerError, ProgramEndedError, ProgramNotRunningError
from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.errors import LocalProtocolError
from urproto.external_control import (
    ControlMode,
    FreedriveAction,
    Query,
    ReverseMessage,
    ScriptCommand,
    ScriptCommandKind,
    TrajectoryAction,
    TrajectoryResult,
)

HOST = "127.0.0.1"
TOKEN = "0123abcd"
Q = [0.1, -1.5, 1.5, 0.0, 0.25, -3.0]


class Robot:
    """The robot's end of one connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def at(cls, endpoint, address=HOST) -> "Robot":
        robot = cls(*await asyncio.open_connection(HOST, endpoint.port, local_addr=(address, 0)))
        return robot

    async def words(self, count: int) -> tuple[int, ...]:
        async with timeout(PATIENCE_S):
            return struct.unpack(f">{count}i", await self.reader.readexactly(4 * count))

    async def gone(self) -> None:
        """Wait until the driver has ended the connection."""
        async with timeout(PATIENCE_S):
            with suppress(ConnectionError):
                while await self.reader.read(65536):
                    pass

    def greet(self) -> None:
        self.writer.write(f"external_control {TOKEN}\n".encode())

    def answer(self, *words: int) -> None:
        self.writer.write(struct.pack(f">{len(words)}i", *words))

    def close(self) -> None:
        self.writer.close()


async def test_setpoints_as_the_robot_reads_them():
    """Words as documented: timeout in ms, six values times a million, mode."""
    async with ReverseEndpoint(0, HOST) as reverse:
        robot = await Robot.at(reverse)
        await reverse.wait_connected()
        assert reverse.peer.transport.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        reverse.setpoint(ControlMode.SERVOJ, Q)
        assert await robot.words(8) == (20, 100000, -1500000, 1500000, 0, 250000, -3000000, 1)
        reverse.keep_alive()
        assert (await robot.words(8))[::7] == (1000, 0)
        reverse.trajectory(TrajectoryAction.STREAM_END, 17)
        assert await robot.words(8) == (200, 3, 17, 0, 0, 0, 0, 3)
        reverse.continue_mode(0.5)
        assert await robot.words(8) == (500, 0, 0, 0, 0, 0, 0, 3)
        reverse.freedrive(FreedriveAction.START)
        assert await robot.words(8) == (200, 1, 0, 0, 0, 0, 0, 6)
        reverse.continue_mode(0.5)
        assert await robot.words(8) == (500, 0, 0, 0, 0, 0, 0, 6)
        reverse.stop()
        assert (await robot.words(8))[::7] == (100, -2)
        robot.close()
        await reverse.wait_disconnected()


@each_row(
    ("mode", "timeout_s", "sent_ms"),
    [
        (ControlMode.SERVOJ, 0.02, 20),
        (ControlMode.SERVOJ, 0.0, 8),
        (ControlMode.TORQUE, 0.001, 8),
        (ControlMode.POSE, 0.2, 200),
        (ControlMode.IDLE, 0.0, 0),
        (ControlMode.IDLE, 0.001, 8),
        (ControlMode.FORWARD, 5.0, 5000),
        (ControlMode.FREEDRIVE, float("inf"), 2**31 - 1),
        (ControlMode.STOPPED, 5.0, 100),
    ],
)
def test_timeouts_are_kept_within_what_is_safe(mode, timeout_s, sent_ms):
    assert read_timeout_ms(mode, timeout_s, 0.008) == sent_ms


@each_row(
    ("mode", "wrong"),
    [
        (ControlMode.IDLE, -1.0),
        (ControlMode.IDLE, float("nan")),
        (ControlMode.POSE, 0.201),
        (ControlMode.SPEEDL, float("inf")),
    ],
)
def test_timeouts_that_no_robot_keeps(mode, wrong):
    with pytest.raises(LocalProtocolError):
        read_timeout_ms(mode, wrong, 0.002)


async def test_no_robot():
    async with ReverseEndpoint(0, HOST) as reverse:
        with pytest.raises(ProgramNotRunningError):
            reverse.keep_alive()
        with pytest.raises(ProgramNotRunningError, match=r"0\.05 s"):
            await reverse.wait_connected(0.05)


async def test_a_new_program_that_knows_the_token_replaces_the_old_connection():
    async with ReverseEndpoint(0, HOST) as reverse:
        reverse.token = TOKEN
        reported = []
        reverse.listeners.append(reported.append)
        old = await Robot.at(reverse)
        old.greet()
        await reverse.wait_connected()
        new = await Robot.at(reverse)
        for part in (b"exter", b"nal_control", b" 0123", b"abcd\n"):
            assert reported == [True]
            new.writer.write(part)
            await asyncio.sleep(0.01)
        await old.gone()
        reverse.keep_alive()
        assert (await new.words(8))[7] == 0
        assert reported == [True, False, True]
        old.close()
        new.close()


SAID = [
    b"",
    b"GET / HTTP/1.1\r\n\r\n",
    b"external_control 0123abce\n",
    b"external_control ",
    b"external_control" * 99,
    b"\xff",
]


@each_row("data", SAID)
async def test_no_other_client_takes_the_place_of_a_robot(data):
    """Or that of no robot: who knows no token waits, or is sent away."""
    async with ReverseEndpoint(0, HOST) as reverse:
        reverse.token = TOKEN
        reported = []
        reverse.listeners.append(reported.append)
        strangers = [await Robot.at(reverse) for _ in range(30)]
        for stranger in strangers:
            stranger.writer.write(data)
        robot = await Robot.at(reverse)
        robot.greet()
        await reverse.wait_connected()
        more = [await Robot.at(reverse) for _ in range(3)]
        more[0].close()
        for stranger in more[1:]:
            stranger.writer.write(data)
        reverse.keep_alive()
        assert (await robot.words(8))[7] == 0
        assert reported == [True]
        for connection in (*strangers, *more, robot):
            connection.writer.transport.abort()


async def test_without_a_token_the_next_one_waits_until_the_robot_has_left():
    async with ReverseEndpoint(0, HOST) as reverse:
        first = await Robot.at(reverse)
        await reverse.wait_connected()
        second = await Robot.at(reverse)
        reverse.keep_alive()
        assert (await first.words(8))[7] == 0
        peer = reverse.peer
        first.close()
        await peer.closed
        reverse.stop()
        assert (await second.words(8))[7] == -2
        second.close()


async def test_with_a_token_no_waiting_client_takes_the_place_of_a_robot_that_has_left():
    async with ReverseEndpoint(0, HOST) as reverse:
        reverse.token = TOKEN
        robot = await Robot.at(reverse)
        robot.greet()
        await reverse.wait_connected()
        stranger = await Robot.at(reverse)
        await asyncio.sleep(0.01)
        peer = reverse.peer
        robot.close()
        await peer.closed
        assert len(reverse.waiting) == 1
        assert not reverse.connected
        stranger.close()


async def test_a_greeting_is_no_result():
    async with TrajectoryEndpoint(0, HOST) as trajectory:
        trajectory.token = TOKEN
        robot = await Robot.at(trajectory)
        robot.writer.write(b"external_control 0123abcd\n\0\0\0\2")
        await trajectory.wait_connected()
        assert await trajectory.result(5) is TrajectoryResult.FAILURE
        robot.close()


async def test_another_robot_is_sent_away(caplog):
    async with ReverseEndpoint(0, HOST) as reverse:
        first = await Robot.at(reverse)
        await reverse.wait_connected()
        second = await Robot.at(reverse, "127.0.0.2")
        await second.gone()
        assert "connection from 127.0.0.2" in caplog.text
        assert f"this port serves {HOST}" in caplog.text, "at once, and not for want of patience"
        reverse.keep_alive()
        assert (await first.words(8))[7] == 0
        first.close()
        await reverse.wait_disconnected()
        third = await Robot.at(reverse, "127.0.0.2")
        await reverse.wait_connected()
        third.close()
        second.close()


async def test_data_from_the_robot_on_the_reverse_interface_is_ignored():
    async with ReverseEndpoint(0, HOST) as reverse:
        robot = await Robot.at(reverse)
        await reverse.wait_connected()
        robot.writer.write(b"hello\n" * 1000)
        reverse.keep_alive()
        assert (await robot.words(8))[7] == 0
        robot.close()


async def test_a_robot_that_does_not_read_is_given_up():
    async with ReverseEndpoint(0, HOST) as reverse:
        robot = await Robot.at(reverse)
        await reverse.wait_connected()
        robot.writer.transport.pause_reading()
        for _ in range(1_000_000):
            if not reverse.connected:
                break
            reverse.setpoint(ControlMode.SERVOJ, Q, 0.2)
            await asyncio.sleep(0)
        assert not reverse.connected
        robot.writer.transport.abort()


async def test_points_and_their_result():
    async with TrajectoryEndpoint(0, HOST) as trajectory:
        robot = await Robot.at(trajectory)
        await trajectory.wait_connected()
        await trajectory.write([points.movej(Q, v=0.5, a=2.0, duration_s=1.5, blend_radius_m=0.01)])
        words = await robot.words(21)
        assert words[:6] == (100000, -1500000, 1500000, 0, 250000, -3000000)
        assert words[12:] == (500000, 2000000, 0, 0, 0, 0, 1500000, 10000, 0)
        robot.writer.write(b"\0\0")
        with pytest.raises(NoAnswerError):
            await trajectory.result(0.05)
        robot.writer.write(b"\0\2")
        assert await trajectory.result(5) is TrajectoryResult.FAILURE
        robot.answer(0, 1)
        assert [await trajectory.result(5), await trajectory.result(5)] == [0, 1]
        robot.close()
        with pytest.raises(ProgramEndedError):
            await trajectory.result(5)


async def test_nothing_is_sent_when_one_point_is_wrong():
    async with TrajectoryEndpoint(0, HOST) as trajectory:
        robot = await Robot.at(trajectory)
        await trajectory.wait_connected()
        with pytest.raises(LocalProtocolError):
            await trajectory.write([points.movej(Q), points.movej([1e9] * 6)])
        await trajectory.write([points.movel(Q)])
        assert (await robot.words(21))[20] == 1
        robot.close()


async def test_many_points_wait_for_the_robot_to_read_and_end_with_it():
    async with TrajectoryEndpoint(0, HOST) as trajectory:
        robot = await Robot.at(trajectory)
        await trajectory.wait_connected()
        robot.writer.transport.pause_reading()
        writing = asyncio.create_task(trajectory.write([points.movej(Q)] * 100_000))
        done, _ = await asyncio.wait([writing], timeout=0.5)
        assert not done
        robot.writer.transport.abort()
        with pytest.raises(ProgramEndedError):
            await asyncio.wait_for(writing, 5)


async def test_a_result_that_means_nothing_ends_the_connection():
    async with TrajectoryEndpoint(0, HOST) as trajectory:
        robot = await Robot.at(trajectory)
        await trajectory.wait_connected()
        robot.answer(77)
        await robot.gone()
        with pytest.raises(ProgramEndedError):
            await trajectory.result(5)
        robot.close()


async def test_results_of_an_earlier_program_are_forgotten():
    async with TrajectoryEndpoint(0, HOST) as trajectory:
        first = await Robot.at(trajectory)
        await trajectory.wait_connected()
        first.answer(2)
        first.close()
        await trajectory.wait_disconnected()
        second = await Robot.at(trajectory)
        await trajectory.wait_connected()
        second.answer(0)
        assert await trajectory.result(5) is TrajectoryResult.SUCCESS
        second.close()


async def test_commands_and_contact():
    async with ScriptCommandEndpoint(0, HOST) as commands:
        robot = await Robot.at(commands)
        await commands.wait_connected()
        commands.send(ScriptCommand.set_payload(1.5, [0, 0, 0.1]))
        assert (await robot.words(28))[:5] == (1, 1500000, 0, 0, 100000)
        commands.send(ScriptCommand(ScriptCommandKind.START_TOOL_CONTACT))
        assert (await robot.words(28))[0] == 5
        robot.answer(0)
        assert await commands.result(5) is TrajectoryResult.SUCCESS
        robot.close()


async def test_what_was_left_of_an_earlier_question_answers_no_later_one():
    """The end of a program, or an answer that nobody waited for any more."""
    async with ScriptCommandEndpoint(0, HOST) as commands:
        first = await Robot.at(commands)
        await commands.wait_connected()
        peer = commands.peer
        first.answer(-2, 1_000_000, 0)
        first.close()
        await peer.closed
        second = await Robot.at(commands)
        await commands.wait_connected()
        asking = asyncio.create_task(commands.query(Query.INVERSE_KIN, (Q,)))
        await second.words(2 * 28)  # the argument, and the question
        second.answer(-2, 2_000_000, 0)
        assert await asking == (2.0,)
        second.close()


async def test_every_client_that_requests_the_program_gets_it_and_stays_connected():
    text = "textmsg(1)\n# NODE_CONTROL_LOOP_ENDS"
    async with ScriptSender(lambda: text, 0, HOST) as sender:
        robots = [await Robot.at(sender) for _ in range(2)]
        for robot in robots:
            for piece in (b"request_", b"program", b"\n"):
                robot.writer.write(piece)
                await robot.writer.drain()
            assert await robot.reader.readexactly(len(text) + 1) == text.encode() + b"\n"
        robots[0].writer.write(b"request_program\r\n")
        await robots[0].reader.readexactly(len(text) + 1)
        assert sender.requests == 3
        for robot in robots:
            robot.close()


@pytest.mark.parametrize("garbage", [b"x" * 5000, b"\0" * 2000])
async def test_the_script_sender_outlives_garbage(garbage):
    async with ScriptSender(lambda: "program", 0, HOST) as sender:
        bad = await Robot.at(sender)
        bad.writer.write(garbage)
        await bad.gone()
        good = await Robot.at(sender)
        good.writer.write(b"something\nrequest_program\n")
        assert await good.reader.readexactly(8) == b"program\n"
        bad.close()
        good.close()


async def test_a_taken_port_is_an_error():
    async with ReverseEndpoint(0, HOST) as reverse:
        with pytest.raises(OSError, match="in use"):
            async with ReverseEndpoint(reverse.port, HOST):
                pytest.fail("entered")


async def test_closing_ends_every_connection():
    reverse = ReverseEndpoint(0, HOST)
    async with reverse:
        robot = await Robot.at(reverse)
        await reverse.wait_connected()
        reverse.stop()
    assert ReverseMessage.decode(await robot.reader.readexactly(32)).mode is ControlMode.STOPPED
    await robot.gone()
    robot.close()
    await reverse.close()


async def test_a_client_accepted_while_the_port_closes_is_not_left_open() -> None:
    """A looping External Control program asks again in the moment in which the driver ends."""
    for rounds in range(5):
        async with ScriptSender(lambda: "program", 0, HOST) as endpoint:
            with socket.create_connection((HOST, endpoint.port)) as robot:
                for _ in range(rounds):
                    await asyncio.sleep(0)
                await endpoint.close()
                robot.settimeout(PATIENCE_S)
                with suppress(ConnectionError):
                    assert robot.recv(1) == b""
