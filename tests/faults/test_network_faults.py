"""Faults of connections and ports, as seen by clients that are plain sockets."""

import asyncio
import socket
from collections.abc import AsyncIterator

import pytest
from fault_rig import HOST, Client, Robot

from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.controlapi import NotPossible

REALTIME = 1108  # bytes of a package of PolyScope 3.15


@pytest.mark.parametrize(("how", "seen"), [("reset", "reset"), ("end", "end")])
async def test_a_connection_is_dropped_once(robot: Robot, how: str, seen: str) -> None:
    stream, bystander = await robot.stream(), await robot.dashboard()
    robot.control.inject_fault("drop_connection", port="rtde", how=how)
    await robot.step(2)
    stream.read()
    assert (stream.ended, bystander.read(), bystander.ended) == (seen, b"", "")
    again = await robot.stream()
    await robot.step(5)
    assert len(again.data()) == 5
    assert (robot.strikes(), robot.states()) == ([1], ["over"])


async def test_only_one_peer_is_dropped(ur3: Robot) -> None:
    victim, other = await ur3.stream(source="127.0.0.2"), await ur3.stream()
    ur3.control.inject_fault("drop_connection", peer="127.0.0.2")
    await ur3.step(2)
    victim.read(), other.read()
    assert (victim.ended, other.ended) == ("reset", "")


async def test_the_next_client_is_dropped_if_none_is_connected(ur3: Robot) -> None:
    ur3.control.inject_fault("drop_connection", port="rtde")
    await ur3.step(5)
    assert ur3.strikes() == [0]
    client = await ur3.connect("rtde")
    await ur3.step(2)
    client.read()
    assert (client.ended, ur3.strikes()) == ("reset", [1])


async def test_new_clients_are_refused(robot: Robot) -> None:
    before = await robot.stream()
    fault = robot.control.inject_fault("refuse_connections", port="rtde")
    await robot.step(2)
    with pytest.raises(ConnectionRefusedError):
        Client(robot.emulator.ports["rtde"])
    before.read()
    await robot.step(3)
    assert len(before.data()) == 3
    robot.control.clear_fault(fault)
    await robot.until(lambda: robot.emulator.servers["rtde"].listening)
    await robot.stream()


async def test_new_clients_are_disconnected(ur3: Robot) -> None:
    ur3.control.inject_fault("turn_away", port="dashboard", peer="127.0.0.2", once=True)
    welcome = await ur3.dashboard()
    turned_away = Client(ur3.emulator.ports["dashboard"], source="127.0.0.2")
    ur3.clients.append(turned_away)
    await ur3.until(lambda: turned_away.read() or turned_away.ended)
    assert (turned_away.ended, turned_away.received, welcome.ended) == ("reset", b"", "")
    await ur3.step()
    again = Client(ur3.emulator.ports["dashboard"], source="127.0.0.2")
    ur3.clients.append(again)
    await ur3.until(lambda: again.read())


async def test_a_half_open_connection_is_silent(robot: Robot) -> None:
    robot.control.inject_fault("half_open", port="dashboard", once=True)
    victim = await robot.connect("dashboard")
    assert await robot.request(victim, b"robotmode\n", periods=50) == b""
    assert victim.ended == ""
    other = await robot.dashboard()
    assert b"Robotmode" in await robot.request(other, b"robotmode\n")
    robot.control.clear_faults()
    await robot.until(lambda: victim.read() or victim.ended)
    assert victim.ended == "reset"


async def test_a_pulled_cable_closes_no_connection_and_loses_no_data(robot: Robot) -> None:
    stream, dashboard = await robot.stream(), await robot.dashboard()
    await robot.step(3)
    assert len(stream.data()) == 3
    fault = robot.control.inject_fault("stall")
    assert await robot.request(dashboard, b"robotmode\n", periods=50) == b""
    assert (stream.data(), stream.ended, dashboard.ended) == ([], "", "")
    robot.control.clear_fault(fault)
    await robot.step(3)
    assert b"Robotmode: RUNNING" in dashboard.read()
    assert len(stream.data()) == 53


async def test_a_new_client_of_a_stalled_port_waits_too(ur3: Robot) -> None:
    ur3.control.inject_fault("stall", port="dashboard", lasting=0.4)
    client = await ur3.connect("dashboard")
    await ur3.step(40)
    assert client.read() == b""
    await ur3.step(20)
    assert b"Connected" in client.read()


async def test_slow_readers_are_disconnected(ur3: Robot) -> None:
    ur3.control.inject_fault("kick_slow_readers", port="realtime", patience_s=0.5, buffer_bytes=4096)
    slow = await ur3.connect("realtime", buffer=4096)
    quick = await ur3.connect("realtime")
    for _ in range(60):
        await ur3.step(5)
        quick.read()
    assert quick.ended == ""
    assert ur3.emulator.servers["realtime"].peers == [f"{HOST}:{quick.address[1]}"]
    slow.read()
    assert slow.ended == "reset"
    assert ur3.strikes() == [1]


async def test_a_port_restarts(robot: Robot) -> None:
    stream, dashboard = await robot.stream(), await robot.dashboard()
    robot.control.inject_fault("restart_port", port="rtde", outage_s=0.4)
    await robot.step()
    stream.read()
    assert stream.ended == "reset"
    with pytest.raises(ConnectionRefusedError):
        Client(robot.emulator.ports["rtde"])
    assert b"Robotmode" in await robot.request(dashboard, b"robotmode\n")
    await robot.step(round(0.4 / robot.period_s))
    await robot.until(lambda: robot.emulator.servers["rtde"].listening)
    again = await robot.stream()
    await robot.step(2)
    assert len(again.data()) == 2
    assert robot.states() == ["over"]


async def test_a_port_taken_by_another_process_is_reopened_later(ur3: Robot, caplog: pytest.LogCaptureFixture) -> None:
    server = ur3.emulator.servers["rtde"]
    ur3.control.inject_fault("restart_port", port="rtde", outage_s=0.05)
    thief = await asyncio.start_server(lambda reader, writer: writer.close(), HOST, server.port)
    await ur3.step(20)
    await ur3.until(lambda: "another program uses it" in caplog.text)
    thief.close()
    async with timeout(10):
        while not server.listening:
            await asyncio.sleep(0.05)
    await ur3.stream()


@pytest.mark.parametrize("direction", ["sent", "received"])
async def test_delayed_bytes_arrive_in_order(robot: Robot, direction: str) -> None:
    dashboard = await robot.dashboard()
    usual = await robot.request(dashboard, b"robotmode\n")
    delay_s = 30 * robot.period_s
    robot.control.inject_fault("delay", port="dashboard", delay_s=delay_s, jitter_s=delay_s, direction=direction)
    dashboard.send(b"robotmode\n")
    await asyncio.sleep(0)
    await robot.step(1)
    dashboard.send(b"safetymode\n")
    await asyncio.sleep(0)
    await robot.step(28)
    assert dashboard.read() == b""
    await robot.step(65)
    assert dashboard.read() == usual + b"Safetymode: NORMAL\n"


async def test_the_last_bytes_of_a_connection_are_delayed_not_lost(ur3: Robot) -> None:
    dashboard = await ur3.dashboard()
    ur3.control.inject_fault("delay", port="dashboard", delay_s=0.1)
    dashboard.send(b"quit\n")
    await asyncio.sleep(0)
    await ur3.step(5)
    assert (dashboard.read(), dashboard.ended) == (b"", "")
    await ur3.step(20)
    assert (dashboard.read(), dashboard.ended) == (b"Disconnected\n", "end")


async def test_a_delayed_script_runs_although_its_connection_was_closed(ur3: Robot) -> None:
    ur3.control.inject_fault("delay", port="primary", delay_s=0.1, direction="received")
    client = await ur3.connect("primary")
    client.send(b"set_digital_out(3, True)\n")
    client.socket.shutdown(socket.SHUT_WR)
    await asyncio.sleep(0)
    await ur3.step(5)
    assert ur3.control.state(["actual_digital_output_bits"]) == {"actual_digital_output_bits": 0}
    await ur3.step(20)
    assert ur3.control.state(["actual_digital_output_bits"]) == {"actual_digital_output_bits": 8}
    assert ur3.emulator.servers["primary"].peers == []


async def test_a_slow_line(ur3: Robot) -> None:
    client = await ur3.connect("realtime")
    ur3.control.inject_fault("limit_bandwidth", port="realtime", bytes_per_s=10_000)
    await ur3.step(125)
    assert 9_900 < len(client.read()) <= 10_000
    ur3.control.clear_faults()
    await ur3.step(1)
    client.read()
    assert len(client.received) == 126 * REALTIME


async def test_a_line_that_is_too_slow_drops_states_and_bounds_memory(ur3: Robot) -> None:
    client = await ur3.connect("realtime")
    ur3.control.inject_fault("limit_bandwidth", port="realtime", bytes_per_s=1)
    await ur3.step(400)
    ur3.control.clear_faults()
    await ur3.step(1)
    assert 256 * 1024 < len(client.read()) < 260 * 1024 + 2 * REALTIME


async def test_packages_are_split(ur3: Robot) -> None:
    client = await ur3.connect("realtime")
    ur3.control.inject_fault("split", port="realtime")
    lengths = []
    for _ in range(20):
        await ur3.step()
        lengths.append(len(client.read()))
    assert 0 < lengths[0] < REALTIME
    assert len(set(lengths)) > 10
    ur3.control.clear_faults()
    client.read()
    assert len(client.received) == 20 * REALTIME


async def test_packages_are_merged(ur3: Robot) -> None:
    client = await ur3.connect("realtime")
    ur3.control.inject_fault("coalesce", port="realtime", wait_s=0.08)
    lengths = []
    for _ in range(30):
        await ur3.step()
        lengths.append(len(client.read()) // REALTIME)
    assert lengths == [0] * 10 + ([10] + [0] * 9) * 2


async def test_packages_are_duplicated(ur3: Robot) -> None:
    client = await ur3.stream()
    ur3.control.inject_fault("duplicate", port="rtde", once=True)
    await ur3.step(3)
    first, second, third, fourth = client.data()
    assert first == second != third != fourth


async def test_bits_flip(ur3: Robot) -> None:
    fine = await ur3.connect("realtime", source="127.0.0.2")
    victim = await ur3.connect("realtime")
    ur3.control.inject_fault("garble", port="realtime", peer=HOST, rate=0.01)
    await ur3.step(10)
    flipped = [a ^ b for a, b in zip(fine.read(), victim.read(), strict=True) if a != b]
    assert 50 < len(flipped) < 200
    assert all(bits.bit_count() == 1 for bits in flipped)


async def test_a_corrupted_request_is_harmless(ur3: Robot) -> None:
    ur3.control.inject_fault("garble", direction="received", rate=0.2)
    client = await ur3.connect("rtde")
    client.send(bytes(range(256)) * 4)
    await ur3.step(5)
    ur3.control.clear_faults()
    await ur3.stream()


async def test_a_package_is_truncated(ur3: Robot) -> None:
    client = await ur3.connect("realtime")
    ur3.control.inject_fault("truncate", port="realtime", lost_bytes=100, once=True)
    await ur3.step(2)
    assert len(client.read()) == 2 * REALTIME - 100


async def test_faults_of_one_port_do_not_disturb_each_other(ur3: Robot) -> None:
    client = await ur3.connect("realtime")
    for kind, more in (("split", {}), ("delay", {"delay_s": 0.05}), ("coalesce", {}), ("split", {})):
        ur3.control.inject_fault(kind, port="realtime", **more)
    await ur3.step(100)
    ur3.control.clear_faults()
    client.read()
    sizes = {client.received[i : i + 4] for i in range(0, len(client.received), REALTIME)}
    assert sizes == {REALTIME.to_bytes(4, "big")}
    assert len(client.received) == 100 * REALTIME


@each_row(("model", "port"), [("ur3", "tool line"), ("ur3", "interpreters"), ("ur5e", "tool line")])
async def test_an_unknown_port_is_refused(model: str, port: str) -> None:
    async with Robot(model) as robot:
        with pytest.raises(NotPossible, match=f"no port '{port}': choose from modbus"):
            robot.control.inject_fault("stall", port=port)
        assert robot.control.faults() == []


async def test_delayed_requests_are_answered_when_the_delay_ends(ur3: Robot) -> None:
    """They are created while delayed data is passed on, and are delayed in turn."""
    dashboard = await ur3.dashboard()
    fault = ur3.control.inject_fault("delay", port="rtde", delay_s=1.0, direction="both")
    client = await ur3.connect("rtde")
    client.send(b"\x00\x05V\x00\x02\x00\x03v")
    await asyncio.sleep(0)
    await ur3.step(3)
    ur3.control.clear_fault(fault)
    await ur3.until(lambda: client.read())
    assert client.received[:6] == b"\x00\x04V\x01\x00\x13"
    assert ur3.control.faults()[0]["problem"] == ""
    assert dashboard.ended == ""


SENDER = """def talk():
  socket_open("127.0.0.1", {port}, "a")
  while True:
    socket_send_string("x", "a")
    sync()
  end
end
"""


class Driver:
    """Listens for programs, and records the data they send."""

    def __init__(self) -> None:
        self.received = b""
        self.connections = 0
        self.ended = ""

    async def __call__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        try:
            while data := await reader.read(100):
                self.received += data
            self.ended = "end"
        except ConnectionResetError:
            self.ended = "reset"
        finally:
            writer.close()


@pytest.fixture
async def driver(ur3: Robot) -> AsyncIterator[Driver]:
    """A driver that a program of the robot sends to in every period."""
    driver = Driver()
    server = await asyncio.start_server(driver, HOST, 0)
    ur3.control.send_script(SENDER.format(port=server.sockets[0].getsockname()[1]))
    await ur3.until_ticking(lambda: driver.received)
    yield driver
    server.close()
    ur3.control.clear_faults()
    ur3.control.inject_fault("drop_connection", port="scripts", lasting=0.1)
    await ur3.until_ticking(lambda: driver.ended)
    await asyncio.sleep(0.01)


async def test_connections_opened_by_programs_stall(ur3: Robot, driver: Driver) -> None:
    fault = ur3.control.inject_fault("stall")
    await ur3.step(3)
    before = len(driver.received)
    await ur3.step(50)
    assert (len(driver.received), driver.ended) == (before, "")
    ur3.control.clear_fault(fault)
    await ur3.until_ticking(lambda: len(driver.received) > before + 50)


async def test_connections_opened_by_programs_are_dropped(ur3: Robot, driver: Driver) -> None:
    ur3.control.inject_fault("drop_connection", port="scripts")
    await ur3.until_ticking(lambda: driver.ended)
    assert driver.ended == "reset"


async def test_connections_opened_by_programs_fall_silent_without_power(ur3: Robot, driver: Driver) -> None:
    fault = ur3.control.inject_fault("power_loss")
    await ur3.step(100)
    assert driver.ended == ""
    ur3.control.clear_fault(fault)
    await ur3.until_ticking(lambda: driver.ended)
    assert driver.ended == "reset"


async def test_connections_opened_by_programs_are_disconnected(ur3: Robot) -> None:
    driver = Driver()
    server = await asyncio.start_server(driver, HOST, 0)
    ur3.control.inject_fault("turn_away", port="scripts")
    ur3.control.send_script(SENDER.format(port=server.sockets[0].getsockname()[1]))
    await ur3.until_ticking(lambda: driver.ended)
    assert (driver.connections, driver.received) == (1, b"")
    server.close()
    await asyncio.sleep(0.01)


async def test_connections_opened_by_programs_are_refused(ur3: Robot) -> None:
    with pytest.raises(NotPossible, match="there is no port to close"):
        ur3.control.inject_fault("refuse_connections", port="scripts")
