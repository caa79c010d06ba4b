"""Registers, signals, speed, installation, popups and the message log in isolation."""

import gzip
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.io.signals import RegisterBank, Signals
from emulator.lifecycle.runstate import Speed
from emulator.reporting.messages import MessageLog
from emulator.reporting.popups import Popups
from emulator.robot.installation import Installation, Payload
from tests.rows import each_row
from urproto.modes import AnalogDomain, RequestedType
from urproto.primary.messages import ErrorCodeMessage, PopupMessage, RequestValueMessage, TextMessage
from urproto.signals import CONFIGURABLE, STANDARD, TOOL
from urscript.polyscope.document import DocumentError
from urscript.polyscope.installation_file import load_installation_file

# registers


@given(st.integers(0, 127), st.integers(0, (1 << 128) - 1))
def test_a_bit_register_does_not_affect_others(index, before):
    bank = RegisterBank()
    bank.bits = before
    bank.set_bit(index, True)
    assert bank.bits == before | 1 << index
    assert bank.get_bit(index)
    bank.set_bit(index, False)
    assert bank.bits == before & ~(1 << index)


def test_packed_bits_replace_only_their_word():
    bank = RegisterBank()
    bank.bits = (1 << 128) - 1
    bank.set_bits(32, 32, 0x0000_00F0)
    assert bank.bits >> 32 & 0xFFFFFFFF == 0xF0
    assert bank.bits & 0xFFFFFFFF == 0xFFFFFFFF
    assert bank.bits >> 64 == (1 << 64) - 1


@pytest.mark.parametrize("index", [-1, 48])
def test_register_numbers_out_of_range_are_refused(index):
    bank = RegisterBank()
    for use in (lambda: bank.set_int(index, 1), lambda: bank.get_int(index)):
        with pytest.raises(IndexError, match="0 to 47"):
            use()
    for use in (lambda: bank.set_double(index, 1.0), lambda: bank.get_double(index)):
        with pytest.raises(IndexError, match="0 to 47"):
            use()
    with pytest.raises(IndexError, match="0 to 127"):
        bank.get_bit(128)


@pytest.mark.parametrize("value", [2**31, -(2**31) - 1])
def test_an_integer_register_holds_32_bits(value):
    bank = RegisterBank()
    with pytest.raises(OverflowError):
        bank.set_int(0, value)
    assert bank.get_int(0) == 0


def test_register_tuples_stay_the_same_object_until_a_value_changes():
    bank = RegisterBank()
    bank.set_int(3, 7)
    ints = bank.ints
    bank.set_int(3, 7)
    assert bank.ints is ints
    bank.set_double(47, -0.0)
    assert math.copysign(1.0, bank.get_double(47)) == -1.0


# signals


@each_row(("group", "first", "count"), [(STANDARD, 0, 8), (CONFIGURABLE, 8, 8), (TOOL, 16, 2)])
def test_groups_of_digital_signals_share_one_word(group, first, count):
    signals = Signals()
    for index in range(count):
        signals.set_digital_output(group, index, True)
        assert signals.get_digital_output(group, index)
    assert signals.digital_outputs == ((1 << count) - 1) << first
    signals.set_digital_input(group, count - 1, True)
    assert signals.digital_inputs == 1 << (first + count - 1)
    assert signals.get_digital_input(group, count - 1)
    with pytest.raises(IndexError, match=group.name):
        signals.set_digital_output(group, count, True)


@given(before=st.integers(0, 0x3FFFF), mask=st.integers(0, 255), levels=st.integers(0, 255))
def test_masked_outputs(before, mask, levels):
    signals = Signals()
    signals.digital_outputs = before
    signals.apply_outputs(CONFIGURABLE, mask, levels)
    assert signals.digital_outputs & ~0xFF00 == before & ~0xFF00
    assert signals.digital_outputs >> 8 & 0xFF == (before >> 8 & 0xFF & ~mask) | (levels & mask)


def test_a_mask_cannot_reach_beyond_its_group():
    signals = Signals()
    signals.apply_outputs(TOOL, 0xFF, 0xFF)
    assert signals.digital_outputs == 0b11 << 16


@each_row(
    ("domain", "ratio", "value"),
    [
        (AnalogDomain.CURRENT, 0.0, 0.004),
        (AnalogDomain.CURRENT, 1.0, 0.020),
        (AnalogDomain.VOLTAGE, 0.5, 5.0),
        (AnalogDomain.VOLTAGE, 1.7, 10.0),
        (AnalogDomain.VOLTAGE, -1.0, 0.0),
    ],
)
def test_analog_outputs_follow_ratio_and_domain(domain, ratio, value):
    signals = Signals()
    signals.analog_output_domains[1] = domain
    signals.set_analog_output(1, ratio)
    assert signals.analog_output(1) == pytest.approx(value)
    signals.set_analog_output(1, math.nan)
    assert signals.analog_output(1) == pytest.approx(value)


def test_analog_domains_are_four_bits():
    signals = Signals()
    signals.analog_input_domains = [AnalogDomain.VOLTAGE, AnalogDomain.CURRENT]
    signals.analog_output_domains = [AnalogDomain.CURRENT, AnalogDomain.VOLTAGE]
    assert signals.analog_io_types == 0b1001


def test_tool_voltage():
    signals = Signals()
    signals.set_tool_voltage(24)
    with pytest.raises(ValueError, match="0, 12 or 24"):
        signals.set_tool_voltage(5)
    assert signals.tool_voltage == 24


# speed


def test_the_slider_is_clipped_and_ignores_nan():
    speed = Speed()
    for given_value, expected in ((2.0, 1.0), (-1.0, 0.0), (math.nan, 0.0), (0.5, 0.5), (math.inf, 1.0)):
        speed.set_slider(given_value)
        assert speed.slider == expected


def test_speed_scaling_shows_the_limiter_not_the_slider():
    speed = Speed()
    speed.set_slider(0.5)
    speed.scaling = 0.5
    assert (speed.slider, speed.fraction) == (0.5, 0.25)


# installation


def installation_file(path, body):
    path.write_bytes(gzip.compress(body.encode()))
    return path


@pytest.mark.parametrize("element", ["TCPSettings", "com.ur.view.tcp.domain.TCPSettingsImpl"])  # 3.12 and 5.x files
def test_installation_file_sets_tcp_and_payload(tmp_path, element):
    body = (
        f'<Installation><{element} activePose="Gripper" toolPayload="1.5"><availablePoses>'
        '<tcp name="TCP" offset="0.0, 0.0, 0.0, 0.0, 0.0, 0.0"/>'
        '<tcp name="Gripper" offset="0.0, 0.0, 0.1, 0.0, 0.0, 1.5"/>'
        f"</availablePoses></{element}></Installation>"
    )
    installation = Installation()
    path = installation_file(tmp_path / "cell.installation", body)
    installation.apply(path, load_installation_file(path))
    assert installation.name == "cell.installation"
    assert installation.tcp == (0.0, 0.0, 0.1, 0.0, 0.0, 1.5)
    assert installation.payload.mass == 1.5


@each_row(
    "content",
    [
        b"",
        b"not gzip",
        gzip.compress(b"<Installation", mtime=0),
        gzip.compress(b"<Installation/>", mtime=0),
        gzip.compress(b'<I><T activePose="X"><tcp name="TCP" offset="0,0,0,0,0,0"/></T></I>', mtime=0),
        gzip.compress(b'<I><T activePose="TCP"><tcp name="TCP" offset="0,0"/></T></I>', mtime=0),
        gzip.compress(b"<Installation/>" * 100, mtime=0)[:40],
    ],
)
def test_a_bad_installation_file_is_refused(tmp_path, content):
    path = tmp_path / "bad.installation"
    path.write_bytes(content)
    with pytest.raises(DocumentError):
        load_installation_file(path)


def test_payload_transition_ramps_and_a_later_call_wins():
    installation = Installation()
    installation.set_payload(Payload.of(1.0, (0.0, 0.0, 0.1)), transition_s=1.0)
    assert installation.target_payload.mass == 1.0
    for _ in range(50):
        installation.advance(0.01)
    assert installation.payload.mass == pytest.approx(0.5)
    assert installation.payload.cog[2] == pytest.approx(0.05)
    for _ in range(60):
        installation.advance(0.01)
    assert installation.payload == Payload.of(1.0, (0.0, 0.0, 0.1))
    installation.set_payload(Payload.of(3.0, (0.0, 0.0, 0.0)), transition_s=10.0)
    installation.set_payload(Payload.of(2.0, (0.0, 0.0, 0.0)))
    installation.advance(5.0)
    assert installation.payload.mass == 2.0


def test_payload_without_inertia_is_a_sphere_of_water():
    payload = Payload.of(4.1887902047863905, (0.0, 0.0, 0.0))  # 4/3 pi litres: radius 0.1 m
    assert payload.inertia[:3] == pytest.approx((0.4 * payload.mass * 0.01,) * 3)
    assert payload.inertia[3:] == (0.0, 0.0, 0.0)


# messages and popups


class Time:
    s = 50.0

    def us(self):
        return round(self.s * 1e6)


@pytest.fixture
def time():
    return Time()


@pytest.fixture
def messages(time):
    return MessageLog(time.us)


def test_messages_are_stamped_and_taken_once(messages):
    messages.text("hello")
    messages.error(209)
    text, error = messages.take()
    assert text == TextMessage(text="hello", timestamp_us=50_000_000)
    assert isinstance(error, ErrorCodeMessage)
    assert error.label == "C209A0"
    assert error.text
    assert messages.take() == ()
    assert messages.history[0] == "50.000 hello"


def test_popup_stays_open_until_closed(messages, time):
    popups = Popups(messages, lambda: time.s)
    popup = popups.show("mind the arm", blocking=True)
    (message,) = messages.take()
    assert isinstance(message, PopupMessage)
    assert (message.text, message.blocking) == ("mind the arm", True)
    time.s += 1e6
    popups.advance()
    assert popup.open
    popups.close_all()
    assert not popup.open
    assert popups.shown == []


def test_popups_can_close_by_themselves(messages, time):
    popups = Popups(messages, lambda: time.s, auto_close_s=2.0)
    popup, request = popups.show("x"), popups.request("how many?", RequestedType.INTEGER)
    time.s += 1.9
    popups.advance()
    assert popup.open
    time.s += 0.2
    popups.advance()
    assert not popup.open
    assert request.open


def test_only_an_answer_closes_a_request(messages, time):
    popups = Popups(messages, lambda: time.s)
    request = popups.request("how many?", RequestedType.INTEGER)
    (message,) = messages.take()
    assert isinstance(message, RequestValueMessage)
    popups.close_all()
    assert request.open
    assert not popups.answer(message.request_id + 1, 3)
    assert popups.answer(message.request_id, 3)
    assert (request.open, request.answer) == (False, 3)
    assert not popups.answer(message.request_id, 4)
