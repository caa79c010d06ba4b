"""Conveyor encoders: counting, interpolation, and ranges that wrap around."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.config import ConfigError, check_encoder_speeds
from emulator.controller import Controller
from emulator.io.encoders import RANGES, DecoderType, Encoder, Encoders
from emulator.machine import ControllerConfig
from tests.rows import each_row
from tests.ticking import ticked
from urproto.robots import load_model

PERIOD = 0.002
QUADRATURE = (0b00, 0b01, 0b11, 0b10)  # levels of A (bit 0) and B (bit 1), A ahead


def pulse_encoder(decoder=DecoderType.QUADRATURE, a=8, b=9):
    encoder = Encoder(PERIOD)
    encoder.decode(decoder, a, b)
    return encoder


def feed(encoder, levels, a=8, b=9):
    for level in levels:
        encoder.advance((level & 1) << a | (level >> 1) << b)


def test_quadrature_counts_every_edge_in_both_directions():
    encoder = pulse_encoder()
    feed(encoder, [0, *QUADRATURE[1:], *QUADRATURE * 2])
    assert encoder.raw == 11
    feed(encoder, [*reversed(QUADRATURE[:-1])])
    assert encoder.raw == 8


@given(st.lists(st.sampled_from((-1, 0, 1)), max_size=300))
def test_quadrature_follows_any_motion(moves):
    encoder, position = pulse_encoder(), 0
    feed(encoder, [QUADRATURE[0]])
    for move in moves:
        position += move
        feed(encoder, [QUADRATURE[position % 4]])
    assert encoder.raw == position


def test_simultaneous_changes_of_both_inputs_have_no_direction():
    encoder = pulse_encoder()
    feed(encoder, [0b00, 0b11, 0b00])
    assert encoder.raw == 0


@each_row(("decoder", "counted"), [(DecoderType.BOTH_EDGES, 5), (DecoderType.RISING, 3), (DecoderType.FALLING, 2)])
def test_single_input_decoders(decoder, counted):
    encoder = pulse_encoder(decoder, 0, 0)
    feed(encoder, [0, 1, 1, 0, 1, 0, 0, 1], 0, 1)
    assert encoder.raw == counted


def test_the_initial_levels_are_not_edges():
    encoder = pulse_encoder(DecoderType.RISING, 0, 0)
    encoder.advance(1)
    assert encoder.raw == 0


def test_the_count_survives_only_an_identical_setup():
    encoder = pulse_encoder()
    feed(encoder, [*QUADRATURE])
    encoder.decode(DecoderType.QUADRATURE, 8, 9)
    assert encoder.raw == 3
    encoder.decode(DecoderType.QUADRATURE, 10, 11)
    assert encoder.raw == 0
    encoder.decode(DecoderType.DISABLED, 0, 0)
    feed(encoder, [*QUADRATURE])
    assert (encoder.raw, encoder.enabled) == (0, False)


@each_row("speed", [100.0, 1234.5, -300.0, 40_000.0])
def test_a_simulated_conveyor_is_interpolated_without_lag(speed):
    encoder = pulse_encoder()
    encoder.simulated_speed = speed
    for _ in range(1500):
        encoder.advance(0)
    assert encoder.raw == pytest.approx(3.0 * speed, abs=1)
    assert encoder.speed == pytest.approx(speed, rel=0.01)
    for count in range(1, 500):  # smooth although the count is in whole ticks
        before = encoder.travel
        encoder.advance(0)
        assert encoder.travel - before == pytest.approx(speed * PERIOD, rel=0.2)
        assert encoder.travel == pytest.approx(speed * (3.0 + count * PERIOD) - 0.5, abs=1.0)


def test_a_conveyor_that_stops_comes_to_rest_on_its_count():
    encoder = pulse_encoder()
    encoder.simulated_speed = 333.0
    for _ in range(1000):
        encoder.advance(0)
    encoder.simulated_speed = 0.0
    for _ in range(1500):
        encoder.advance(0)
    assert (encoder.travel, encoder.speed) == (encoder.raw, 0.0)


def test_single_input_decoders_have_no_direction_and_others_count_nothing():
    encoder = pulse_encoder(DecoderType.RISING, 0, 0)
    encoder.simulated_speed = -100.0
    for _ in range(500):
        encoder.advance(0)
    assert encoder.raw == pytest.approx(100, abs=1)
    idle = Encoder(PERIOD)
    idle.simulated_speed = 100.0
    idle.advance(0)
    assert idle.raw == 0


@each_row("range_id", range(len(RANGES)))
def test_fed_counts_wrap_around_their_range(range_id):
    low, size = RANGES[range_id]
    encoder = Encoder(PERIOD)
    encoder.expect_counts(range_id)
    encoder.feed(low + size - 3)
    assert encoder.count == low + size - 3
    encoder.feed(low + 4)
    for _ in range(1000):
        encoder.advance(0)
    assert encoder.travel == low + size + 4
    assert encoder.count == low + 4
    assert encoder.unwound(4 - (size - 3)) == 7
    assert encoder.unwound(-7) == -7
    with pytest.raises(ValueError, match="outside the encoder's range"):
        encoder.feed(low + size)


@given(start=st.integers(0, 65535), moved=st.integers(-32767, 32767))
def test_unwinding_undoes_wrapping(start, moved):
    encoder = pulse_encoder()
    assert encoder.unwound((start + moved) % 65536 - start) == moved


def test_invalid_use_raises_an_error():
    encoder = Encoder(PERIOD)
    with pytest.raises(ValueError, match="does not expect counts"):
        encoder.feed(1)
    with pytest.raises(ValueError, match="not enabled"):
        encoder.unwound(1)
    with pytest.raises(ValueError, match="no encoder range 5"):
        encoder.expect_counts(5)
    with pytest.raises(IndexError, match="no encoder -1"):
        Encoders(PERIOD)[-1]


def test_the_controller_counts_its_digital_inputs_and_publishes_raw_counts():
    controller = Controller(ControllerConfig(model=load_model("ur5e"), encoder_speeds=(0.0, -50.0)))
    controller.encoders.decode(0, DecoderType.QUADRATURE, 8, 9)
    controller.encoders.decode(1, DecoderType.QUADRATURE, 10, 11)
    for count in range(500):
        controller.signals.digital_inputs = QUADRATURE[count // 10 % 4] << 8
        snapshot = ticked(controller)
    assert (snapshot.encoder0_raw, snapshot.encoder1_raw) == (49, -50)


@each_row("speed", [float("nan"), float("inf"), 50_000.0])
def test_speeds_on_the_command_line_are_checked(speed):
    assert check_encoder_speeds(1.0, -2.0) == (1.0, -2.0)
    with pytest.raises(ConfigError, match="encoder 1"):
        check_encoder_speeds(0.0, speed)
