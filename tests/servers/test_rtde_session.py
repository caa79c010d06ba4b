"""Sessions of the RTDE server, without sockets. Names and layouts are those of the RTDE guide."""

import struct
from itertools import pairwise, product
from typing import Any

import pytest
from server_rig import CB3, E_SERIES

from emulator.servers.rtde_session import TRANSITIONS, RTDEHost, RTDESession, SessionEvent, SessionState
from emulator.snapshot import Snapshot
from tests.rows import each_row
from urproto.rtde.codec import (
    ClientMessage,
    GetVersion,
    InputData,
    Package,
    Pause,
    PauseReply,
    ProtocolReply,
    RequestProtocol,
    SetupInputs,
    SetupInputsReply,
    SetupOutputs,
    SetupOutputsReply,
    Start,
    StartReply,
    TextMessage,
    VersionReply,
)
from urproto.rtde.fields import OUTPUT_FIELDS, available_fields
from urproto.versions import PolyscopeVersion


class Conversation:
    """A session with its packages and log messages."""

    def __init__(self, host: RTDEHost, protocol: int = 2) -> None:
        self.written: list[dict[str, Any]] = []
        self.noted: list[str] = []
        self.session = RTDESession(host, self.written.append, self.noted.append)
        if protocol == 2:
            assert self.request(RequestProtocol(2)) == [ProtocolReply(True)]

    def request(self, request: Any) -> list[Any]:
        return self.session.answer(request)

    def packages(self, periods: int) -> list[bytes | None]:
        due = (self.session.due() for _ in range(periods))
        return [packer(Snapshot(timestamp=41.5)) if packer else None for packer in due]


@pytest.fixture
def host() -> RTDEHost:
    return RTDEHost(CB3)


@pytest.fixture
def client(host: RTDEHost) -> Conversation:
    return Conversation(host)


def test_every_state_has_every_event() -> None:
    assert set(TRANSITIONS) == set(product(SessionState, SessionEvent))
    for state in SessionState:
        assert TRANSITIONS[state, SessionEvent.INVALID_RECIPE] is SessionState.NO_RECIPE
    starts = {state: TRANSITIONS[state, SessionEvent.START] for state in SessionState}
    assert starts[SessionState.NO_RECIPE] is SessionState.NO_RECIPE
    assert starts[SessionState.PAUSED] is SessionState.STARTED


@pytest.mark.parametrize(("version", "accepted"), [(0, False), (1, True), (2, True), (3, False), (65535, False)])
def test_protocol_versions(host: RTDEHost, version: int, accepted: bool) -> None:
    client = Conversation(host, protocol=1)
    assert client.request(RequestProtocol(version)) == [ProtocolReply(accepted)]
    assert client.session.protocol == (2 if version == 2 else 1)


def test_controller_version(client: Conversation) -> None:
    """The build is that of URControl, 0 in late versions: a public client logs "URControl 5.16.0.0"."""
    assert client.request(GetVersion()) == [VersionReply(PolyscopeVersion(3, 15, 8))]
    early = Conversation(RTDEHost(PolyscopeVersion(3, 3, 4, 310)))  # a UR10's log has URControl 3.3.4.208 next to it
    assert early.request(GetVersion()) == [VersionReply(PolyscopeVersion(3, 3, 4, 208))]


def test_outputs_flow_between_start_and_pause(client: Conversation) -> None:
    assert client.packages(2) == [None, None]
    assert client.request(SetupOutputs(("timestamp",), 125.0)) == [SetupOutputsReply(("DOUBLE",), 1)]
    assert client.packages(2) == [None, None]
    assert client.request(Start()) == [StartReply(True)]
    package = struct.pack(">HBBd", 12, ord("U"), 1, 41.5)
    assert client.packages(3) == [None, package, package]
    assert client.request(Pause()) == [PauseReply(True)]
    assert client.packages(2) == [None, None]
    assert client.request(Start()) == [StartReply(True)]
    assert client.packages(2) == [None, package]


def test_protocol_1_has_neither_frequency_nor_recipe_id(host: RTDEHost) -> None:
    client = Conversation(host, protocol=1)
    assert client.request(SetupOutputs(("timestamp",))) == [SetupOutputsReply(("DOUBLE",), 1)]
    client.request(Start())
    package = struct.pack(">HBd", 11, ord("U"), 41.5)
    assert client.packages(3) == [None, package, package]
    client.request(RequestProtocol(2))
    assert client.packages(1) == [struct.pack(">HBBd", 12, ord("U"), 1, 41.5)]


@each_row(
    ("version", "frequency_hz", "every"),
    [
        (CB3, 125.0, 1),
        (CB3, 500.0, 1),
        (CB3, 100.0, 1),
        (CB3, 62.5, 2),
        (CB3, 50.0, 2),
        (CB3, 125.0 / 3.0, 3),
        (CB3, 10.0, 12),
        (CB3, 1.0, 125),
        (E_SERIES, 500.0, 1),
        (E_SERIES, 125.0, 4),
        (E_SERIES, 25.0, 20),
        (CB3, 41.6666666667, 3),  # the expected rounding, written out
        (E_SERIES, 166.6666666667, 3),
        (E_SERIES, 1e-300, 2**31),
    ],
)
def test_frequency_is_rounded_to_whole_periods(version: PolyscopeVersion, frequency_hz: float, every: int) -> None:
    client = Conversation(RTDEHost(version))
    client.request(SetupOutputs(("timestamp",), frequency_hz))
    client.request(Start())
    sent = [package is not None for package in client.packages(min(4 * every, 400))]
    # the answer and the first package must not be sent together, since clients mistake one for the other
    assert sent == [index >= every and index % every == 0 for index in range(len(sent))]


@each_row(("first_hz", "then_hz", "every"), [(0.01, 125.0, 1), (1.0, 25.0, 5), (125.0, 25.0, 5)])
def test_a_frequency_changed_while_running_applies_from_the_next_package(
    first_hz: float, then_hz: float, every: int
) -> None:
    client = Conversation(RTDEHost(PolyscopeVersion.parse("3.15")))
    client.request(SetupOutputs(("timestamp",), first_hz))
    client.request(Start())
    client.packages(3)
    client.request(SetupOutputs(("timestamp",), then_hz))
    sent = [index for index, package in enumerate(client.packages(5 * every)) if package is not None]
    assert sent[0] <= every
    assert all(after - before == every for before, after in pairwise(sent))


@pytest.mark.parametrize("frequency_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_invalid_frequencies_are_refused(client: Conversation, frequency_hz: float) -> None:
    reply, message = client.request(SetupOutputs(("timestamp",), frequency_hz))
    assert reply == SetupOutputsReply(("DOUBLE",), 0)
    assert "frequency" in message.text
    assert client.request(Start())[0] == StartReply(False)


def test_unknown_outputs_make_the_recipe_invalid(client: Conversation) -> None:
    reply, message = client.request(SetupOutputs(("timestamp", "ft_raw_wrench", "nonsense"), 125.0))
    assert reply == SetupOutputsReply(("DOUBLE", "NOT_FOUND", "NOT_FOUND"), 0)
    assert "ft_raw_wrench, nonsense" in message.text
    refusal, _ = client.request(Start())
    assert refusal == StartReply(False)
    assert client.packages(2) == [None, None]
    assert client.request(SetupOutputs(("timestamp",), 125.0)) == [SetupOutputsReply(("DOUBLE",), 1)]
    assert client.request(Start()) == [StartReply(True)]


def test_e_series_has_more_outputs() -> None:
    client = Conversation(RTDEHost(E_SERIES))
    assert client.request(SetupOutputs(("ft_raw_wrench",), 500.0)) == [SetupOutputsReply(("VECTOR6D",), 1)]


def test_polyscope_x_warns_each_client_until_the_arm_was_switched_on() -> None:
    """The C++ client expects it before the answer to any request: "SafetySetup has not been confirmed yet"."""
    snapshot = Snapshot()
    host = RTDEHost(PolyscopeVersion.parse("10.12"), lambda: snapshot)
    for _ in range(2):
        client = Conversation(host, protocol=1)
        (warning,) = client.session.greeting()
        assert "SafetySetup has not been confirmed yet" in warning.text
        assert client.request(RequestProtocol(2)) == [ProtocolReply(True)]
    snapshot.switched_on = True
    assert Conversation(host).session.greeting() == []
    assert Conversation(RTDEHost(E_SERIES)).session.greeting() == []


def test_no_data_is_sent_until_the_safety_setup_is_confirmed() -> None:
    """The text of Universal_Robots_ROS2_Driver issue 349, level WARNING (a recording of URSim 5.25.2)."""
    snapshot = Snapshot()
    snapshot.safety_confirmed = False
    client = Conversation(RTDEHost(E_SERIES, lambda: snapshot))
    (warning,) = client.session.greeting()
    assert warning.encode(1)[3:] == b"\2SafetySetup has not been confirmed yet, therefore no data will be send yet"
    assert client.request(SetupOutputs(("timestamp",), 125.0)) == [SetupOutputsReply(("DOUBLE",), 1)]
    assert client.request(Start()) == [warning, StartReply(False)]
    assert client.packages(2) == [None, None]
    snapshot.safety_confirmed = True
    assert client.request(Start()) == [StartReply(True)]
    assert client.session.greeting() == []


def test_a_new_output_recipe_replaces_the_old_one(client: Conversation) -> None:
    client.request(SetupOutputs(("timestamp",), 125.0))
    client.request(Start())
    client.request(SetupOutputs(("robot_mode", "runtime_state"), 62.5))
    _, first, second = client.packages(3)
    assert first is not None
    assert len(first) == 4 + 8
    assert second is None


def test_every_variable_fits_one_recipe(client: Conversation) -> None:
    """The official client library requests its complete list, 9 kB of names, at once."""
    names = tuple(available_fields(OUTPUT_FIELDS, CB3))
    assert len(",".join(names)) > 2048
    (reply,) = client.request(SetupOutputs(names, 125.0))
    assert reply == SetupOutputsReply(tuple(OUTPUT_FIELDS[name].type.wire_name for name in names), 1)


def test_the_largest_recipe_fits_its_package(client: Conversation) -> None:
    names = ("actual_q",) * 1365  # the vector with the shortest name
    assert client.request(SetupOutputs(names, 125.0))[0].recipe_id == 1
    client.request(Start())
    _, package = client.packages(2)
    assert package is not None
    assert len(package) == 4 + 1365 * 48


def test_over_long_lists_are_refused_name_by_name(client: Conversation) -> None:
    names = ("actual_q",) * 1366  # 9 bytes each
    reply, message = client.request(SetupOutputs(names, 125.0))
    assert reply == SetupOutputsReply(("NOT_FOUND",) * 1366, 0)
    assert "12288" in message.text


@pytest.mark.parametrize("count", [6144, 6145, 32_000])
def test_any_answer_fits_its_package(client: Conversation, count: int) -> None:
    reply, message = client.request(SetupOutputs(("x",) * count, 125.0))
    assert len(reply.encode(2)) < 65536
    assert message.encode(2)


def test_an_empty_list_is_not_a_recipe(client: Conversation) -> None:
    assert client.request(SetupOutputs((), 125.0))[0] == SetupOutputsReply((), 0)
    assert client.request(SetupInputs(()))[0] == SetupInputsReply((), 0)


def test_input_recipes_count_from_one_and_may_share_variables(client: Conversation) -> None:
    """ur_rtde names input_int_register_0 in 23 recipes and never reads the ids."""
    for expected in range(1, 24):
        (reply,) = client.request(SetupInputs(("input_int_register_0", "input_double_register_1")))
        assert reply == SetupInputsReply(("INT32", "DOUBLE"), expected)
    client.request(InputData(23, struct.pack(">id", -7, 2.5)))
    assert client.written == [{"input_int_register_0": -7, "input_double_register_1": 2.5}]


def test_inputs_need_no_start_and_no_output_recipe(client: Conversation) -> None:
    client.request(SetupInputs(("speed_slider_mask", "speed_slider_fraction")))
    assert client.request(InputData(1, struct.pack(">Id", 1, 0.5))) == []
    assert client.written == [{"speed_slider_mask": 1, "speed_slider_fraction": 0.5}]


def test_unknown_inputs(client: Conversation) -> None:
    reply, message = client.request(SetupInputs(("input_int_register_0", "actual_q")))
    assert reply == SetupInputsReply(("INT32", "NOT_FOUND"), 0)
    assert "actual_q" in message.text
    assert client.request(SetupInputs(("input_int_register_0",))) == [SetupInputsReply(("INT32",), 1)]


def test_another_connections_inputs_are_in_use_until_it_closes(host: RTDEHost) -> None:
    first, second = Conversation(host), Conversation(host)
    first.request(SetupInputs(("input_int_register_0", "input_int_register_1")))
    reply, message = second.request(SetupInputs(("input_int_register_1", "input_int_register_2")))
    assert reply == SetupInputsReply(("IN_USE", "INT32"), 0)
    assert "input_int_register_1" in message.text
    assert first.request(SetupInputs(("input_int_register_2",)))[0].recipe_id == 2, "a refused recipe holds nothing"
    first.session.close()
    assert second.request(SetupInputs(("input_int_register_1", "input_int_register_2")))[0].recipe_id == 1


@pytest.mark.parametrize(
    "requests",
    [
        [Pause()],
        [Start(), Pause(), Start()],
        [SetupOutputs(("timestamp",), 125.0)],
        [RequestProtocol(2)],
        [InputData(1, bytes(4))],
        [SetupInputs(("input_int_register_1",))],
    ],
)
def test_only_closing_a_connection_releases_its_inputs(host: RTDEHost, requests: list[Any]) -> None:
    first, second = Conversation(host), Conversation(host)
    first.request(SetupOutputs(("timestamp",), 125.0))
    first.request(SetupInputs(("input_int_register_0",)))
    for request in requests:
        first.request(request)
    assert second.request(SetupInputs(("input_int_register_0",)))[0] == SetupInputsReply(("IN_USE",), 0)
    second.request(InputData(1, struct.pack(">i", 7)))
    assert second.written == [], "a refused recipe writes nothing"
    first.session.close()
    assert second.request(SetupInputs(("input_int_register_0",)))[0] == SetupInputsReply(("INT32",), 1)


def test_a_third_client_gets_the_unowned_inputs(host: RTDEHost) -> None:
    clients = [Conversation(host) for _ in range(3)]
    names = [("speed_slider_mask", "speed_slider_fraction"), ("input_int_register_24",), ("input_double_register_24",)]
    for client, own in zip(clients, names, strict=True):
        assert client.request(SetupInputs(own))[0].recipe_id == 1
    for client in clients:
        others = tuple(name for own in names for name in own)
        types = client.request(SetupInputs(others))[0].types
        assert types.count("IN_USE") == len(others) - len(names[clients.index(client)])


def test_at_most_255_input_recipes(client: Conversation) -> None:
    for _ in range(255):
        assert client.request(SetupInputs(("input_int_register_0",)))[0].recipe_id != 0
    reply, message = client.request(SetupInputs(("input_int_register_0",)))
    assert reply.recipe_id == 0
    assert "255" in message.text


@pytest.mark.parametrize(("extra", "written"), [(b"\0" * 48, 1), (b"\0", 1)])
def test_excess_input_data_is_ignored(client: Conversation, extra: bytes, written: int) -> None:
    client.request(SetupInputs(("input_int_register_0",)))
    (message,) = client.request(InputData(1, struct.pack(">i", 5) + extra))
    assert "not 4" in message.text
    assert client.written == [{"input_int_register_0": 5}]


def test_invalid_input_data_is_ignored_and_reported_once(client: Conversation) -> None:
    client.request(SetupInputs(("external_force_torque",)))
    for data in (b"", b"\0" * 44):
        (message,) = client.request(InputData(1, data))
        assert "ignored" in message.text
        assert client.request(InputData(1, data)) == []
    (message,) = client.request(InputData(9, b"\0"))
    assert "recipe 9" in message.text
    assert client.written == []


def test_messages_of_clients_are_logged(client: Conversation) -> None:
    assert client.request(ClientMessage("careful", "driver", 2)) == []
    assert client.noted == ["RTDE client driver: WARNING: careful"]


@pytest.mark.parametrize("package", [Package(0, b""), Package(ord("V"), b"\0"), Package(ord("O"), b"\0")])
def test_unexpected_packages_are_answered_with_a_warning(client: Conversation, package: Package) -> None:
    message = client.session.read(package)
    assert isinstance(message, TextMessage)
    assert "ignored" in message.text
