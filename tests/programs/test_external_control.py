"""Programs with External Control nodes: the robot's request to a driver, and its handling of the answer."""

import gzip
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tree_rig import Arm

from emulator.commands.requests import DashboardLine, ScriptUnit
from emulator.control.programs import ProgramVerbs
from emulator.control.verbs import ControlledRobot
from emulator.services.urcap import DriverAddress, ProgramRequest, split_program
from tests.budget import examples
from tests.networks import MemorySocket, MemorySockets
from tests.rows import each_row
from urproto.modes import RuntimeState
from urproto.primary.messages import KeyMessage, RuntimeExceptionMessage
from urscript.polyscope.installation_file import read_installation

URCAP_DEFAULT = ("192.168.56.1", 50002)
ASKED = b"request_program\n"
PLAYED, FAILED = "Starting program", "Failed to execute: play"
NODE = (
    '<Contributed strategyClass="com.fzi.externalcontrol.ExternalControlNode"'
    ' strategyProgramNodeType="External Control" strategyURCapName="External Control"><dataModel/></Contributed>'
)
PROGRAM = b"""# of no use
# HEADER_BEGIN
global nodes = 0
def count():
  nodes = nodes + 1
end
# HEADER_END

# NODE_CONTROL_LOOP_BEGINS
count()
textmsg("node ", nodes)
sleep(0.1)
# NODE_CONTROL_LOOP_ENDS

"""


def urp(nodes: str, once: str = "true") -> bytes:
    main = f'<MainProgram runOnlyOnce="{once}"><children>{nodes}</children></MainProgram>'
    return gzip.compress(f'<URProgram name="drive"><children>{main}</children></URProgram>'.encode())


def contribution(data: str) -> str:
    """An installation file with a page of the URCap."""
    return (
        '<Installation><Tool activePose="TCP" toolPayload="0"><tcp name="TCP" offset="0,0,0,0,0,0"/></Tool>'
        "<Contributions><URCaps>"
        '<Contributed id="EthernetIP" name="Ethernet/IP"><data key="host_ip" value="10.9.9.9"/></Contributed>'
        f'<Contributed id="com.fzi.externalcontrol.impl" name="External Control">{data}</Contributed>'
        "</URCaps></Contributions></Installation>"
    )


class Robot(Arm):
    """An arm whose loaded program has External Control nodes."""

    patience_s = 20.0

    def __init__(
        self, folder: Path, *, nodes: str = NODE, driver: tuple[str, int] = URCAP_DEFAULT, **config: Any
    ) -> None:
        (folder / "drive.urp").write_bytes(urp(nodes))
        super().__init__(folder, **config)
        self.network = MemorySockets(driver)
        self.controller.programs.socket_backend = self.network
        self.request("load drive.urp")

    @property
    def popups(self) -> list[str]:
        return [popup.text for popup in self.controller.popups.shown]

    def post(self, line: str) -> list[str]:
        """A list that will contain the dashboard's answer."""
        answers: list[str] = []
        self.controller.post(DashboardLine(line), answers.append)
        return answers

    def request(self, line: str) -> str:
        answers = self.post(line)
        self.until(lambda: answers)
        return answers[0]

    def play(self) -> tuple[list[str], MemorySocket]:
        """Send play; a list for the answer, and the connection to the driver once the robot has sent its request."""
        answers = self.post("play")
        self.until(lambda: self.network.opened and self.network.opened[-1].sent == ASKED, 0.1)
        return answers, self.network.opened[-1]

    def finish(self) -> None:
        self.until(lambda: self.state is RuntimeState.STOPPED)


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def test_play_is_answered_once_the_drivers_program_runs(robot):
    answers, driver = robot.play()
    assert robot.network.opened == [driver]
    robot.seconds(0.2)
    assert answers == []
    assert robot.state is RuntimeState.STOPPED
    driver.feed(PROGRAM)
    assert robot.until(lambda: answers, 0.2) < 0.05  # drivers have half a second for all of it
    assert answers == [PLAYED]
    assert robot.state is RuntimeState.PLAYING
    assert driver.state == "closed"
    robot.finish()
    assert robot.texts == ["node 1"]


def test_the_header_is_inserted_once_and_the_rest_at_each_node(tmp_path):
    robot = Robot(tmp_path, nodes=NODE * 3)
    _, driver = robot.play()
    driver.feed(PROGRAM)
    robot.until(lambda: robot.state is RuntimeState.PLAYING)
    robot.finish()
    assert robot.texts == ["node 1", "node 2", "node 3"]
    assert len(robot.network.opened) == 1


HANDED_BACK = b"""# HEADER_BEGIN
# HEADER_END
socket_open("10.0.0.1", 50001, "reverse")
mode = [1, 0]
while mode[0] > 0 and mode[1] != -2:
  mode = socket_read_binary_integer(1, "reverse", 0)
end
socket_close("reverse")
# NODE_CONTROL_LOOP_ENDS
"""


def test_the_program_continues_after_the_node_when_control_is_handed_back(tmp_path):
    """As in the vendor's test of handing control back."""
    robot = Robot(tmp_path, nodes=f'{NODE}<Wait type="Sleep"><waitTime>0.2</waitTime></Wait>')
    robot.network.listening.add(("10.0.0.1", 50001))
    _, driver = robot.play()
    driver.feed(HANDED_BACK)
    robot.until(lambda: len(robot.network.opened) == 2)
    robot.seconds(1.0)
    reverse = robot.network.opened[1]
    reverse.feed(struct.pack(">i", -2))
    robot.until(lambda: reverse.state == "closed", 0.01)
    assert robot.until(lambda: robot.state is RuntimeState.STOPPED, 1.0) == pytest.approx(0.2, abs=0.01)


def test_a_looping_program_starts_again_with_the_header(tmp_path):
    robot = Robot(tmp_path)
    (tmp_path / "drive.urp").write_bytes(urp(NODE, once="false"))
    robot.request("load drive.urp")
    _, driver = robot.play()
    driver.feed(PROGRAM)
    robot.until(lambda: len(robot.texts) == 3, 1.0)
    assert robot.texts == ["node 1", "node 1", "node 1"]
    assert len(robot.network.opened) == 1


def test_clients_see_which_program_runs(robot):
    _, driver = robot.play()
    driver.feed(PROGRAM)
    robot.until(lambda: robot.state is RuntimeState.PLAYING)
    robot.seconds(0.05)
    assert [thread.label for thread in robot.controller.programs.view.threads] == ["Control by 192.168.56.1"]
    robot.finish()
    keys = [(message.title, message.text) for message in robot.messages if isinstance(message, KeyMessage)]
    assert keys == [("PROGRAM_XXX_STARTED", "drive"), ("PROGRAM_XXX_STOPPED", "drive")]


def test_a_program_with_an_unknown_last_line_starts_slightly_later(robot):
    answers, driver = robot.play()
    driver.feed(b'textmsg("short")\nsync()\n')
    assert 0.1 <= robot.until(lambda: answers, 0.2) < 0.15


def test_every_play_sends_a_new_request(robot):
    for round_number in (1, 2):
        _, driver = robot.play()
        driver.feed(b'textmsg("round ", %d)\nsync()\n' % round_number)
        robot.until(lambda: robot.state is RuntimeState.PLAYING)
        robot.finish()
        robot.network.opened.clear()
    assert robot.texts == ["round 1", "round 2"]


def test_a_program_in_pieces_with_data_after_its_last_line(robot):
    """The official tests append lines after the end of the control loop."""
    _, driver = robot.play()
    for line in (PROGRAM + b'textmsg("appended")\n').splitlines(keepends=True):
        driver.feed(line)
        robot.seconds(0.01)
    robot.until(lambda: robot.state is RuntimeState.PLAYING)
    robot.finish()
    assert robot.texts == ["node 1", "appended"]


def test_a_pause_in_transmission_does_not_end_an_incomplete_program(robot):
    _, driver = robot.play()
    head, tail = PROGRAM.split(b"textmsg")
    driver.feed(head)
    robot.seconds(0.08)
    driver.feed(b"textmsg" + tail)
    robot.until(lambda: robot.state is RuntimeState.PLAYING)
    robot.finish()
    assert robot.texts == ["node 1"]


def test_a_driver_that_closes_after_its_program(robot):
    """Simple servers do this, some without a final line end."""
    _, driver = robot.play()
    driver.feed(b'textmsg("all")\r\nsync()')
    driver.close()
    robot.tick()
    robot.until(lambda: robot.state is RuntimeState.PLAYING, 0.01)
    robot.finish()
    assert robot.texts == ["all"]


def refused(robot: Robot) -> str:
    robot.network.listening.clear()
    return "The connection to the remote PC at 192.168.56.1:50002 could not be established. Reason: Connection refused"


def unreachable(robot: Robot) -> str:
    robot.network.silent.add(URCAP_DEFAULT)
    return "Timeout while reading requested program from 192.168.56.1:50002"


def silent(robot: Robot) -> str:
    return "Timeout while reading requested program from 192.168.56.1:50002"


@each_row(("driver", "waits_s"), [(refused, 0.0), (unreachable, 5.0), (silent, 0.5)])
def test_without_an_answer_the_program_shows_a_popup_and_continues_after_it(tmp_path, driver, waits_s):
    robot = Robot(tmp_path, nodes=f'{NODE}<Wait type="Sleep"><waitTime>0.2</waitTime></Wait>')
    text = driver(robot)
    answers = robot.post("play")
    took = robot.until(lambda: answers)
    assert answers == [PLAYED]
    assert took == pytest.approx(waits_s, abs=0.03)
    robot.seconds(1.0)
    assert robot.popups == [text]
    assert robot.controller.popups.shown[0].title == "Receive program failed"
    assert robot.controller.popups.shown[0].error
    robot.request("close popup")
    assert 0.15 < robot.until(lambda: robot.state is RuntimeState.STOPPED, 1.0) < 0.25


def test_half_a_line_is_not_a_program(robot):
    _, driver = robot.play()
    driver.feed(b'textmsg("one")\ntextmsg("tw')
    robot.until(lambda: robot.popups, 1.0)
    assert robot.popups == ["Timeout while reading requested program from 192.168.56.1:50002"]
    assert robot.texts == []


def test_a_broken_connection_is_reported_with_its_reason(robot):
    _, driver = robot.play()
    driver.failure = "Connection reset by peer"
    driver.close()
    robot.until(lambda: robot.popups, 1.0)
    assert robot.popups[0].endswith("could not be established. Reason: Connection reset by peer")


def test_a_driver_that_closes_without_sending(robot):
    """Seen with URCap 1.0.4: its program is the word null, which does not compile."""
    answers, driver = robot.play()
    driver.close()
    robot.until(lambda: answers, 0.1)
    assert answers == [FAILED]
    assert robot.state is RuntimeState.STOPPED
    assert any(isinstance(message, RuntimeExceptionMessage) for message in robot.messages)


def test_an_endless_program_is_abandoned(robot):
    _, driver = robot.play()
    robot.until(lambda: driver.feed(b"sync()\n" * 400) or robot.popups, 5.0)
    assert "the program has more than 256 KiB" in robot.popups[0]
    assert driver.state == "closed"


def test_a_trickling_program_is_abandoned(robot):
    answers, driver = robot.play()
    took = robot.until(lambda: driver.feed(b" ") or answers, 11.0)
    assert took == pytest.approx(10.0, abs=0.1)


def test_a_driver_program_with_an_error_is_reported_and_not_started(robot):
    answers, driver = robot.play()
    driver.feed(b"no_such_function()\n")
    robot.until(lambda: answers)
    assert answers == [FAILED]
    (error,) = [message for message in robot.messages if isinstance(message, RuntimeExceptionMessage)]
    assert error.text == "compile_error_name_not_found:no_such_function:"


@pytest.mark.parametrize("line", ["stop", "power off", "load drive.urp"])
def test_ending_the_program_also_ends_waiting_for_the_driver(robot, line):
    answers, driver = robot.play()
    robot.request(line)
    robot.tick()
    assert answers == [FAILED]
    assert driver.state == "closed"
    robot.seconds(1.0)
    assert robot.state is RuntimeState.STOPPED
    assert robot.popups == []


def test_another_program_replaces_the_one_being_waited_for(robot):
    answers, driver = robot.play()
    robot.controller.post(ScriptUnit('def other():\n  textmsg("other")\n  sleep(1)\nend\n', "block"))
    robot.until(lambda: robot.state is RuntimeState.PLAYING, 0.1)
    robot.tick()
    assert answers == [FAILED]
    assert driver.state == "closed"
    robot.seconds(0.5)
    assert robot.controller.programs.name == "other"


def test_a_secondary_program_does_not_interrupt_waiting(robot):
    answers, driver = robot.play()
    robot.controller.post(ScriptUnit('sec note():\n  textmsg("beside")\nend\n', "block"))
    robot.seconds(0.1)
    driver.feed(PROGRAM)
    robot.until(lambda: answers)
    robot.finish()
    assert robot.texts == ["beside", "node 1"]


def test_a_stop_of_the_arm_while_waiting_keeps_the_program_from_starting(robot):
    answers, driver = robot.play()
    robot.controller.post(ScriptUnit("protective_stop()\n", "line"))
    robot.tick()
    driver.feed(PROGRAM)
    robot.until(lambda: answers)
    assert answers == [FAILED]


def test_two_clients_sending_play_get_the_same_answer(robot):
    first, driver = robot.play()
    second = robot.post("play")
    robot.seconds(0.1)
    driver.feed(PROGRAM)
    robot.until(lambda: first and second)
    assert (first, second) == ([PLAYED], [PLAYED])
    assert len(robot.network.opened) == 1
    robot.finish()
    assert robot.texts == ["node 1"]


def test_the_address_used_for_the_driver(tmp_path):
    """The emulator's option overrides the installation's page, which overrides the URCap's default."""
    page = contribution('<data key="host_ip" value="10.0.0.7"/><data key="port_nr" value="6000"/>')
    (tmp_path / "cell.installation").write_bytes(gzip.compress(page.encode()))
    for option, wanted in [
        ("", ("10.0.0.7", 6000)),
        ("10.0.0.8", ("10.0.0.8", 6000)),
        (":7000", ("10.0.0.7", 7000)),
        ("10.0.0.8:7000", ("10.0.0.8", 7000)),
    ]:
        given_address = DriverAddress.parse(option) if option else DriverAddress()
        robot = Robot(tmp_path, driver=wanted, external_control=given_address)
        assert robot.request("load installation cell.installation").startswith("Loading installation")
        _, driver = robot.play()
        assert driver.state == "open"


class _ConnectedRobot(ControlledRobot):
    def wait(self, steps):
        raise AssertionError("it takes no time")


def test_an_address_from_the_control_api_applies_from_the_next_play(tmp_path):
    robot = Robot(tmp_path, driver=("10.0.0.8", 7000))
    ProgramVerbs(_ConnectedRobot(robot.controller)).set_external_control("10.0.0.8", 7000)
    _, driver = robot.play()
    assert driver.state == "open"


@each_row(
    ("data", "address"),
    [
        ("", URCAP_DEFAULT),
        ('<data key="host_ip" value="pc.local"/>', ("pc.local", 50002)),
        ('<data key="port_nr" value="50012"/>', ("192.168.56.1", 50012)),
        ('<data key="host_ip" value=""/><data key="port_nr" value="12x"/>', URCAP_DEFAULT),
        ('<data key="port_nr" value="99999"/>', URCAP_DEFAULT),
    ],
)
def test_addresses_on_the_installations_page(data, address):
    installation = read_installation(contribution(data).encode(), "cell")
    assert DriverAddress.of(installation).complete == address


@each_row(
    ("text", "address"),
    [
        ("10.0.0.1:5000", ("10.0.0.1", 5000)),
        ("driver", ("driver", 50002)),
        (":5000", ("192.168.56.1", 5000)),
        ("[::1]:5000", ("::1", 5000)),
        ("[fe80::1]", ("fe80::1", 50002)),
    ],
)
def test_addresses_as_an_option(text, address):
    assert DriverAddress.parse(text).complete == address


@each_row("text", ["", ":", "host:", "host:0", "host:65536", "host:x", "::1", "two words", "a:1:2"])
def test_invalid_addresses(text):
    with pytest.raises(ValueError, match="use HOST:PORT"):
        DriverAddress.parse(text)


@each_row(
    ("text", "header", "node"),
    [
        ("a\n# HEADER_BEGIN\nb\n  # HEADER_END \nc\n", "# HEADER_BEGIN\nb\n  # HEADER_END ", "c\n"),
        ("a\nb\n", "", "a\nb\n"),
        ("# HEADER_BEGIN\na\n", "", "# HEADER_BEGIN\na\n"),
        ("# HEADER_END\na\n# HEADER_BEGIN\n", "", "# HEADER_END\na\n# HEADER_BEGIN\n"),
        ('textmsg("# HEADER_BEGIN")\n# HEADER_END\n', "", 'textmsg("# HEADER_BEGIN")\n# HEADER_END\n'),
    ],
)
def test_a_program_is_split_at_its_anchors(text, header, node):
    code = split_program(text)
    assert (code.header, code.node) == (header, node)


@settings(deadline=None, max_examples=examples(33))
@given(pieces=st.lists(st.binary(max_size=60), max_size=6), closes=st.booleans())
def test_any_bytes_are_handled(pieces, closes):
    network = MemorySockets(URCAP_DEFAULT)
    request = ProgramRequest(network, URCAP_DEFAULT, 0.008)
    assert request.step() is None
    for piece in pieces:
        network.opened[0].feed(piece)
        assert request.step() is None
    if closes:
        network.opened[0].close()
    codes = [code for code in (request.step() for _ in range(100)) if code is not None]
    assert codes
    assert codes[0].node.endswith("\n")
    assert network.opened[0].state == "closed"
