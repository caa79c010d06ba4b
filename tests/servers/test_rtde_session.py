"""Sessions of the RTDE server, without sockets. Names and layouts are those of the RTDE guide."""

import struct
from itertools import pairwise, product
from typing import Any

import pytest
from server_rig import CB3, E_SERIES

from emulator.servers.rtde_session import TRANSITIONS, RTDEHost, RTDESession, SessionEvent, SessionState
from emulator.snapshot import Snapshot
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
def talk(host: RTDEHost) -> Conversation:
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
    talk = Conversation(host, protocol=1)
    assert talk.request(RequestProtocol(version)) == [ProtocolReply(accepted)]
    assert talk.session.protocol == (2 if version == 2 else 1)


def test_controller_version(talk: Conversation) -> None:
    assert talk.request(GetVersion()) == [VersionReply(CB3)]


def test_outputs_flow_between_start_and_pause(talk: Conversation) -> None:
    assert talk.packages(2) == [None, None]
    assert talk.request(SetupOutputs(("timestamp",), 125.0)) == [SetupOutputsReply(("DOUBLE",), 1)]
    assert talk.packages(2) == [None, None]
    assert talk.request(Start()) == [StartReply(True)]
    package = struct.pack(">HBBd", 12, ord("U"), 1, 41.5)
    assert talk.packages(3) == [None, package, package]
    assert talk.request(Pause()) == [PauseReply(True)]
    assert talk.packages(2) == [None, None]
    assert talk.request(Start()) == [StartReply(True)]
    assert talk.packages(2) == [None, package]


def test_protocol_1_has_neither_frequency_nor_recipe_id(host: RTDEHost) -> None:
    talk = Conversation(host, protocol=1)
    assert talk.request(SetupOutputs(("timestamp",))) == [SetupOutputsReply(("DOUBLE",), 1)]
    talk.request(Start())
    package = struct.pack(">HBd", 11, ord("U"), 41.5)
    assert talk.packages(3) == [None, package, package]
    talk.request(RequestProtocol(2))
    assert talk.packages(1) == [struct.pack(">HBBd", 12, ord("U"), 1, 41.5)]


@pytest.mark.parametrize(
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
    talk = Conversation(RTDEHost(version))
    talk.request(SetupOutputs(("timestamp",), frequency_hz))
    talk.request(Start())
    sent = [package is not None for package in talk.packages(min(4 * every, 400))]
    # the answer and the first package must not be sent together, since clients mistake one for the other
    assert sent == [index >= every and index % every == 0 for index in range(len(sent))]


@pytest.mark.parametrize(("first_hz", "then_hz", "every"), [(0.01, 125.0, 1), (1.0, 25.0, 5), (125.0, 25.0, 5)])
def test_a_frequency_changed_while_running_applies_from_the_next_package(
    first_hz: float, then_hz: float, every: int
) -> None:
    talk = Conversation(RTDEHost(PolyscopeVersion.parse("3.15")))
    talk.request(SetupOutputs(("timestamp",), first_hz))
    talk.request(Start())
    talk.packages(3)
    talk.request(SetupOutputs(("timestamp",), then_hz))
    sent = [index for index, package in enumerate(talk.packages(5 * every)) if package is not None]
    assert sent[0] <= every
    assert all(after - before == every for before, after in pairwise(sent))


@pytest.mark.parametrize("frequency_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_invalid_frequencies_are_refused(talk: Conversation, frequency_hz: float) -> None:
    reply, message = talk.request(SetupOutputs(("timestamp",), frequency_hz))
    assert reply == SetupOutputsReply(("DOUBLE",), 0)
    assert "frequency" in message.text
    assert talk.request(Start())[0] == StartReply(False)


def test_unknown_outputs_make_the_recipe_invalid(talk: Conversation) -> None:
    reply, message = talk.request(SetupOutputs(("timestamp", "ft_raw_wrench", "nonsense"), 125.0))
    assert reply == SetupOutputsReply(("DOUBLE", "NOT_FOUND", "NOT_FOUND"), 0)
    assert "ft_raw_wrench, nonsense" in message.text
    refusal, _ = talk.request(Start())
    assert refusal == StartReply(False)
    assert talk.packages(2) == [None, None]
    assert talk.request(SetupOutputs(("timestamp",), 125.0)) == [SetupOutputsReply(("DOUBLE",), 1)]
    assert talk.request(Start()) == [StartReply(True)]


def test_e_series_has_more_outputs() -> None:
    talk = Conversation(RTDEHost(E_SERIES))
    assert talk.request(SetupOutputs(("ft_raw_wrench",), 500.0)) == [SetupOutputsReply(("VECTOR6D",), 1)]


def test_polyscope_x_warns_each_client_until_the_arm_was_switched_on() -> None:
    """The C++ client's loop that asks for the version expects it there: "SafetySetup has not been confirmed yet"."""
    switched_on = False
    host = RTDEHost(PolyscopeVersion.parse("10.12"), lambda: switched_on)
    for _ in range(2):
        accepted, warning = Conversation(host, protocol=1).request(RequestProtocol(2))
        assert accepted == ProtocolReply(True)
        assert "SafetySetup has not been confirmed yet" in warning.text
    switched_on = True
    assert Conversation(host, protocol=1).request(RequestProtocol(2)) == [ProtocolReply(True)]
    assert Conversation(RTDEHost(E_SERIES), protocol=1).request(RequestProtocol(2)) == [ProtocolReply(True)]


def test_a_new_output_recipe_replaces_the_old_one(talk: Conversation) -> None:
    talk.request(SetupOutputs(("timestamp",), 125.0))
    talk.request(Start())
    talk.request(SetupOutputs(("robot_mode", "runtime_state"), 62.5))
    _, first, second = talk.packages(3)
    assert first is not None
    assert len(first) == 4 + 8
    assert second is None


def test_every_variable_fits_one_recipe(talk: Conversation) -> None:
    """The official client library requests its complete list, 9 kB of names, at once."""
    names = tuple(available_fields(OUTPUT_FIELDS, CB3))
    assert len(",".join(names)) > 2048
    (reply,) = talk.request(SetupOutputs(names, 125.0))
    assert reply == SetupOutputsReply(tuple(OUTPUT_FIELDS[name].type.wire_name for name in names), 1)


def test_the_largest_recipe_fits_its_package(talk: Conversation) -> None:
    names = ("actual_q",) * 1365  # the vector with the shortest name
    assert talk.request(SetupOutputs(names, 125.0))[0].recipe_id == 1
    talk.request(Start())
    _, package = talk.packages(2)
    assert package is not None
    assert len(package) == 4 + 1365 * 48


def test_over_long_lists_are_refused_name_by_name(talk: Conversation) -> None:
    names = ("actual_q",) * 1366  # 9 bytes each
    reply, message = talk.request(SetupOutputs(names, 125.0))
    assert reply == SetupOutputsReply(("NOT_FOUND",) * 1366, 0)
    assert "12288" in message.text


@pytest.mark.parametrize("count", [6144, 6145, 32_000])
def test_any_answer_fits_its_package(talk: Conversation, count: int) -> None:
    reply, message = talk.request(SetupOutputs(("x",) * count, 125.0))
    assert len(reply.encode(2)) < 65536
    assert message.encode(2)


def test_an_empty_list_is_not_a_recipe(talk: Conversation) -> None:
    assert talk.request(SetupOutputs((), 125.0))[0] == SetupOutputsReply((), 0)
    assert talk.request(SetupInputs(()))[0] == SetupInputsReply((), 0)


def test_input_recipes_count_from_one_and_may_share_variables(talk: Conversation) -> None:
    """ur_rtde names input_int_register_0 in 23 recipes and never reads the ids."""
    for expected in range(1, 24):
        (reply,) = talk.request(SetupInputs(("input_int_register_0", "input_double_register_1")))
        assert reply == SetupInputsReply(("INT32", "DOUBLE"), expected)
    talk.request(InputData(23, struct.pack(">id", -7, 2.5)))
    assert talk.written == [{"input_int_register_0": -7, "input_double_register_1": 2.5}]


def test_inputs_need_no_start_and_no_output_recipe(talk: Conversation) -> None:
    talk.request(SetupInputs(("speed_slider_mask", "speed_slider_fraction")))
    assert talk.request(InputData(1, struct.pack(">Id", 1, 0.5))) == []
    assert talk.written == [{"speed_slider_mask": 1, "speed_slider_fraction": 0.5}]


def test_unknown_inputs(talk: Conversation) -> None:
    reply, message = talk.request(SetupInputs(("input_int_register_0", "actual_q")))
    assert reply == SetupInputsReply(("INT32", "NOT_FOUND"), 0)
    assert "actual_q" in message.text
    assert talk.request(SetupInputs(("input_int_register_0",))) == [SetupInputsReply(("INT32",), 1)]


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
    "doing",
    [
        [Pause()],
        [Start(), Pause(), Start()],
        [SetupOutputs(("timestamp",), 125.0)],
        [RequestProtocol(2)],
        [InputData(1, bytes(4))],
        [SetupInputs(("input_int_register_1",))],
    ],
)
def test_only_closing_a_connection_releases_its_inputs(host: RTDEHost, doing: list[Any]) -> None:
    first, second = Conversation(host), Conversation(host)
    first.request(SetupOutputs(("timestamp",), 125.0))
    first.request(SetupInputs(("input_int_register_0",)))
    for request in doing:
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


def test_at_most_255_input_recipes(talk: Conversation) -> None:
    for _ in range(255):
        assert talk.request(SetupInputs(("input_int_register_0",)))[0].recipe_id != 0
    reply, message = talk.request(SetupInputs(("input_int_register_0",)))
    assert reply.recipe_id == 0
    assert "255" in message.text


@pytest.mark.parametrize(("extra", "written"), [(b"\0" * 48, 1), (b"\0", 1)])
def test_excess_input_data_is_ignored(talk: Conversation, extra: bytes, written: int) -> None:
    talk.request(SetupInputs(("input_int_register_0",)))
    (message,) = talk.request(InputData(1, struct.pack(">i", 5) + extra))
    assert "not 4" in message.text
    assert talk.written == [{"input_int_register_0": 5}]


def test_invalid_input_data_is_ignored_and_reported_once(talk: Conversation) -> None:
    talk.request(SetupInputs(("external_force_torque",)))
    for data in (b"", b"\0" * 44):
        (message,) = talk.request(InputData(1, data))
        assert "ignored" in message.text
        assert talk.request(InputData(1, data)) == []
    (message,) = talk.request(InputData(9, b"\0"))
    assert "recipe 9" in message.text
    assert talk.written == []


def test_messages_of_clients_are_logged(talk: Conversation) -> None:
    assert talk.request(ClientMessage("careful", "driver", 2)) == []
    assert talk.noted == ["RTDE client driver: WARNING: careful"]


@pytest.mark.parametrize("package", [Package(0, b""), Package(ord("V"), b"\0"), Package(ord("O"), b"\0")])
def test_unexpected_packages_are_answered_with_a_warning(talk: Conversation, package: Package) -> None:
    message = talk.session.read(package)
    assert isinstance(message, TextMessage)
    assert "ignored" in message.text
