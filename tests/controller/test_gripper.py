"""The gripper as a state machine in virtual time, and on the arm."""

from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.commands.requests import GripperCall
from emulator.controller import Controller
from emulator.devices.gripper_requests import GripperSession
from emulator.devices.robotiq import TRANSITIONS, Event, Gripper, Phase
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import ControllerConfig
from tests.rows import each_row
from urproto.robotiq import MODELS, Fault, Get, ObjectStatus, RequestDecoder, Status
from urproto.robots import load_model

PERIOD_S = 0.002
MODEL = MODELS["robotiq-2f-85"]


def until(gripper: Gripper, condition: Callable[[], bool], limit_s: float = 20.0) -> float:
    for count in range(round(limit_s / PERIOD_S)):
        if condition():
            return count * PERIOD_S
        gripper.advance(PERIOD_S, powered=True)
    raise AssertionError(f"not within {limit_s} s: {gripper.phase} at {gripper.position}")


def active(object_mm: float | None = None) -> Gripper:
    gripper = Gripper(MODEL, object_mm)
    gripper.advance(PERIOD_S, powered=True)
    gripper.set("ACT", 1)
    until(gripper, lambda: gripper.status is Status.ACTIVE)
    return gripper


def go(gripper: Gripper, position: int, **more: int) -> float:
    """Move and wait; the time it took [s]."""
    for name, value in {"POS": position, **more, "GTO": 1}.items():
        gripper.set(name, value)
    return until(gripper, lambda: gripper.object_status is not ObjectStatus.MOVING)


def test_activation_takes_time() -> None:
    gripper = Gripper(MODEL)
    gripper.advance(PERIOD_S, powered=True)
    assert (gripper.get("STA"), gripper.get("ACT"), gripper.get("FLT")) == ("0", "0", "00")
    gripper.set("ACT", 1)
    assert gripper.get("STA") == "1"
    closed = until(gripper, lambda: gripper.position == MODEL.closed_stop)
    opened = until(gripper, lambda: gripper.status is Status.ACTIVE)
    assert closed == pytest.approx(opened, abs=3 * PERIOD_S)
    assert closed == pytest.approx(227 / MODEL.speed(255), abs=2 * PERIOD_S)
    assert gripper.get("POS") == "3"


def test_motion_at_the_requested_speed() -> None:
    gripper = active()
    fast = go(gripper, 230, SPE=255)
    assert fast == pytest.approx(85 / 150, abs=2 * PERIOD_S), "85 mm at 150 mm/s"
    assert (gripper.get("POS"), gripper.get("PRE"), gripper.get("OBJ")) == ("230", "230", "3")
    slow = go(gripper, 3, SPE=0)
    assert slow == pytest.approx(85 / 20, abs=2 * PERIOD_S), "at 20 mm/s"
    for name, value in {"POS": 103, "SPE": 255}.items():
        gripper.set(name, value)
    assert gripper.object_status is ObjectStatus.MOVING, "in the period of the command"
    positions = []
    while gripper.object_status is ObjectStatus.MOVING:
        gripper.advance(PERIOD_S, powered=True)
        positions.append(gripper.position)
    steps = [b - a for a, b in pairwise(positions)]
    assert steps[:-1] == pytest.approx([MODEL.speed(255) * PERIOD_S] * (len(steps) - 1))
    assert positions[-1] == 103


def test_the_fingers_stop_before_the_ends_of_the_scale() -> None:
    gripper = active()
    go(gripper, 255)
    assert (gripper.get("POS"), gripper.get("PRE"), gripper.get("OBJ")) == ("230", "255", "3")
    go(gripper, 0)
    assert (gripper.get("POS"), gripper.get("PRE"), gripper.get("OBJ")) == ("3", "000", "3")
    assert gripper.get("NCY") == "2", "the activation closed once, too"


def test_gto_stops_the_fingers() -> None:
    gripper = active()
    gripper.set("POS", 200)
    gripper.set("GTO", 1)
    for _ in range(50):
        gripper.advance(PERIOD_S, powered=True)
    gripper.set("GTO", 0)
    here = gripper.position
    assert 3 < here < 200
    for _ in range(50):
        gripper.advance(PERIOD_S, powered=True)
    assert gripper.position == here


def test_an_object_is_gripped_from_outside_and_lost() -> None:
    gripper = active(object_mm=40.0)
    go(gripper, 255)
    assert gripper.object_status is ObjectStatus.HELD_CLOSING
    assert gripper.position == pytest.approx(230 - 40 * 227 / 85)
    go(gripper, 0)
    assert gripper.object_status is ObjectStatus.AT_REQUEST, "it is let go"
    go(gripper, 255)
    gripper.object_mm = None
    assert gripper.object_status is ObjectStatus.MOVING, "taken away, the fingers close on"
    until(gripper, lambda: gripper.object_status is ObjectStatus.AT_REQUEST)
    assert gripper.position == MODEL.closed_stop


def test_an_object_is_gripped_from_inside() -> None:
    gripper = active()
    go(gripper, 255)
    gripper.object_mm = 40.0
    go(gripper, 0)
    assert gripper.object_status is ObjectStatus.HELD_OPENING
    go(gripper, 255)
    assert gripper.object_status is ObjectStatus.AT_REQUEST


def test_commands_in_the_wrong_order_are_faults() -> None:
    gripper = Gripper(MODEL)
    gripper.advance(PERIOD_S, powered=True)
    gripper.set("GTO", 1)
    assert gripper.get("FLT") == "07", "not activated"
    gripper.set("ACT", 1)
    assert gripper.get("FLT") == "05", "activation is not over"
    until(gripper, lambda: gripper.status is Status.ACTIVE)
    assert gripper.get("FLT") == "00"


@pytest.mark.parametrize(("direction", "end"), [(0, MODEL.open_stop), (1, MODEL.closed_stop)])
def test_automatic_release(direction: int, end: int) -> None:
    gripper = active()
    go(gripper, 120)
    gripper.set("ARD", direction)
    gripper.set("ATR", 1)
    assert gripper.get("FLT") == "11"
    duration = until(gripper, lambda: gripper.get("FLT") == "15")
    assert duration == pytest.approx(abs(end - 120) / MODEL.speed(0), abs=3 * PERIOD_S), "slowly"
    assert gripper.position == end
    assert gripper.status is Status.RESET
    gripper.set("ATR", 0)
    gripper.set("ACT", 1)
    assert gripper.get("FLT") == "15", "only a reset ends it"
    gripper.set("ACT", 0)
    assert gripper.get("FLT") == "00"
    gripper.set("ACT", 1)
    until(gripper, lambda: gripper.status is Status.ACTIVE)
    assert gripper.get("ADR") == gripper.get("ARD") == str(direction), "both spellings"


def test_injected_faults() -> None:
    gripper = active()
    gripper.set("POS", 200)
    gripper.set("GTO", 1)
    gripper.fail(Fault.OVER_TEMPERATURE)
    here = gripper.position
    gripper.advance(PERIOD_S, powered=True)
    assert (gripper.get("FLT"), gripper.position) == ("08", here)
    gripper.recover()
    assert gripper.object_status is ObjectStatus.MOVING, "a minor fault passes"
    gripper.fail(Fault.OVER_CURRENT)
    gripper.recover()
    assert (gripper.get("FLT"), gripper.status) == ("14", Status.RESET)
    gripper.set("ACT", 0)
    gripper.set("ACT", 1)
    assert (gripper.get("FLT"), gripper.status) == ("00", Status.ACTIVATING)


def test_power_loss_resets_the_activation() -> None:
    gripper = active()
    go(gripper, 100)
    gripper.advance(PERIOD_S, powered=False)
    assert [gripper.get(name) for name in ("STA", "POS", "ACT", "PCO", "DST")] == [None, None, None, "1", "1"]
    gripper.set("ACT", 1)
    gripper.advance(PERIOD_S, powered=True)
    assert [gripper.get(name) for name in ("STA", "POS", "ACT", "PCO", "DST")] == ["0", "100", "0", "0", "4"]


@each_row("phase", Phase)
@each_row("event", Event)
def test_every_event_in_every_phase(phase: Phase, event: Event) -> None:
    after = TRANSITIONS.get((phase, event), phase)
    if event is Event.RESET:
        assert after is Phase.RESET
    if phase in (Phase.RELEASED, Phase.FAILED) and event not in (Event.RESET, Event.FAIL):
        assert after is phase, "only a reset leads out"
    assert (after is Phase.ACTIVE) is (phase is Phase.ACTIVE or (phase, event) == (Phase.OPENING, Event.ARRIVED)) or (
        event in (Event.RESET, Event.RELEASE, Event.FAIL)
    )


settings_ = st.tuples(
    st.sampled_from(["ACT", "GTO", "ATR", "ARD", "POS", "SPE", "FOR", "ADR", "MOD"]), st.integers(0, 255)
)


@given(st.lists(settings_ | st.integers(1, 400) | st.floats(1, 84), max_size=30))
def test_the_fingers_always_stay_between_their_stops(actions: list[tuple[str, int] | int | float]) -> None:
    gripper = Gripper(MODEL)
    gripper.advance(PERIOD_S, powered=True)
    for action in actions:
        if isinstance(action, tuple):
            if gripper.accepts(*action):
                gripper.set(*action)
        elif isinstance(action, float):
            gripper.object_mm = action
        else:
            for _ in range(action):
                before = gripper.position
                gripper.advance(PERIOD_S, powered=True)
                assert abs(gripper.position - before) <= MODEL.speed(255) * PERIOD_S + 1e-9
        assert MODEL.open_stop <= gripper.position <= MODEL.closed_stop
        for name in ("STA", "OBJ", "FLT", "POS", "PRE"):
            assert int(gripper.get(name) or "") >= 0


# on the arm


def request(controller: Controller, text: bytes, session: GripperSession | None = None) -> bytes:
    decoder = RequestDecoder()
    answers: list[bytes] = []
    controller.post(GripperCall((*decoder.feed(text), *decoder.flush()), session or GripperSession()), answers.append)
    controller.tick()
    return b"".join(answers)


@pytest.fixture
def controller() -> Controller:
    controller = Controller(ControllerConfig(model=load_model("ur5e"), running=True, gripper=MODEL))
    controller.tick()
    return controller


def test_requests(controller: Controller) -> None:
    assert request(controller, b"GET STA\nGET OBJ\nGET POS\n") == b"STA 0\nOBJ 3\nPOS 3\n"
    assert request(controller, b"GET FLT") == b"00"
    assert request(controller, b"GET PRE") == b"000"
    assert request(controller, b"SET ACT 1 ATR 0\n") == b"ack"
    assert request(controller, b"GET STA") == b"1"
    assert request(controller, b"GET COU\n") == b"COU ?\n", "not known"
    for wrong in (b"SET POS 256\n", b"SET GTO 2\n", b"SET STA 3\n", b"SET POS -1\n", b"SET POS 9 XYZ 1\n", b"what\n"):
        assert request(controller, wrong) == b"nack"
    assert request(controller, b"GET PRE") == b"000", "all or nothing"


def test_gripper_selection(controller: Controller) -> None:
    session = GripperSession()
    assert len(request(controller, b"GET SID", session)) == 17
    assert request(controller, b"GET SID", session).startswith(b"[9]")
    assert request(controller, b"SET SID 2\n", session) == b"ack"
    assert request(controller, b"GET STA\n", session) == b"STA ?\n", "there is no second gripper"
    assert request(controller, b"SET SID 9\n", session) == b"ack"
    assert request(controller, b"GET STA\n", session) == b"STA 0\n"


def test_the_gripper_is_powered_with_the_arm(controller: Controller) -> None:
    request(controller, b"SET ACT 1\n")
    controller.safety_event(SafetyEvent.ROBOT_EMERGENCY_STOP)
    for _ in range(2000):
        controller.tick()
    assert request(controller, b"GET POS\n") == b"POS ?\n"
    assert request(controller, b"GET SID").startswith(b"[]")
    assert controller.gripper is not None
    assert not controller.gripper.powered
    assert controller.gripper.status is Status.RESET


def test_requests_without_a_gripper() -> None:
    assert Controller(ControllerConfig(model=load_model("ur3"))).gripper is None


def test_behaviour_is_deterministic() -> None:
    def run() -> list[float]:
        controller = Controller(ControllerConfig(model=load_model("ur5e"), running=True, gripper=MODEL))
        controller.tick()
        request(controller, b"SET ACT 1\n")
        assert controller.gripper is not None
        seen = []
        for _ in range(300):
            controller.tick()
            seen.append(controller.gripper.position)
        return seen

    assert run() == run()
    assert len(set(run())) > 200


def test_power_events_of_the_arm_do_not_reach_the_gripper(controller: Controller) -> None:
    controller.power_event(PowerEvent.POWER_OFF)
    controller.tick()
    assert GripperSession().answer(controller.gripper, (Get("PCO"),)) == b"PCO 1\n"  # type: ignore[arg-type]
