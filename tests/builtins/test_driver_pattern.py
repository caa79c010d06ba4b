"""A program of the kind drivers upload: a socket is read in the main thread, others move the arm."""

import struct

import pytest

from urproto.modes import RuntimeState

DRIVER = """
def driver():
  global target = get_joint_positions()
  global moving = 0
  thread follow():
    while True:
      enter_critical
      q = target
      exit_critical
      servoj(q, t=get_steptime(), lookahead_time=0.03, gain=2000)
    end
  end
  thread go():
    movej([0.3, -1.5, 1.5, -1.6, -1.57, 0], a=1, v=0.5)
    socket_send_int(0, "driver")
  end
  h = 0
  if not socket_open("10.0.0.1", 50001, "driver"):
    popup("no driver", title="Driver", error=True, blocking=True)
  end
  enter_critical
  message = socket_read_binary_integer(7, "driver", 0)
  exit_critical
  while message[0] > 0 and message[1] >= 0:
    if message[1] == 1:
      if moving == 0:
        moving = 1
        h = run follow()
      end
      target = [message[2], message[3], message[4], message[5], message[6], message[7]] / 1000000
    elif message[1] == 2:
      kill h
      stopj(4)
      h = run go()
    elif message[1] == 3:
      kill h
      join h
      stopj(4)
      moving = 0
    end
    enter_critical
    message = socket_read_binary_integer(7, "driver", 0.5)
    exit_critical
  end
  textmsg("left with ", message[0])
end
"""


@pytest.fixture
def driver(rig):
    rig.submit(DRIVER)
    rig.until(lambda: bool(rig.sockets.opened), 0.1)
    return rig.sockets.opened[0]


def send(socket, command: int, q=(0.0,) * 6) -> None:
    socket.feed(struct.pack(">7i", command, *[round(angle * 1e6) for angle in q]))


def test_streamed_targets_are_followed_one_per_period(rig, driver):
    for step in range(300):
        send(driver, 1, (0.0005 * step, *rig.q[1:]))
        rig.tick()
    assert len(driver.inbox) <= 28
    assert rig.controller.snapshot.target_qd[0] == pytest.approx(0.25, rel=0.02)
    send(driver, 3)
    rig.until(lambda: rig.controller.snapshot.target_qd == (0.0,) * 6, 0.3)


def test_a_move_in_a_thread_can_be_cancelled_quickly(rig, driver):
    send(driver, 2)
    rig.seconds(0.4)
    assert rig.controller.snapshot.target_qd[0] > 0.3
    send(driver, 3)
    took = rig.until(lambda: rig.controller.snapshot.target_qd == (0.0,) * 6, 0.3)
    assert took < 0.2
    assert driver.sent == b""


def test_a_move_in_a_thread_reports_its_end_while_the_reader_waits(rig, driver):
    for _ in range(100):
        if driver.sent:
            break
        send(driver, 2) if not driver.inbox and rig.controller.motion.idle else send(driver, 0)
        rig.seconds(0.02)
    assert bytes(driver.sent) == b"\0\0\0\0"
    assert rig.q[0] == pytest.approx(0.3, abs=1e-9)


def test_silence_ends_the_loop_after_its_timeout(rig, driver):
    send(driver, 0)
    took = rig.until(lambda: rig.state is RuntimeState.STOPPED, 2.0)
    assert took == pytest.approx(0.5, abs=0.02)
    assert rig.texts == ["left with 0"]


def test_a_disconnected_peer_ends_the_loop_immediately(rig, driver):
    rig.seconds(1.0)
    driver.close()
    assert rig.until(lambda: rig.state is RuntimeState.STOPPED, 1.0) < 0.02


def test_a_missing_driver_opens_a_popup(rig):
    rig.sockets.listening.clear()
    rig.submit(DRIVER)
    rig.seconds(0.2)
    assert [popup.text for popup in rig.controller.popups.shown] == ["no driver"]
    assert rig.state is RuntimeState.PLAYING
