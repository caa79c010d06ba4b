"""What nobody reads is not computed, and is the same whoever reads it."""

import random
from math import hypot

import pytest

from emulator.robot.installation import Payload
from urproto.vectors import ZERO6

MOVES = """def moves():
  set_tcp(p[0.1, 0.05, 0.2, 0.1, 0.2, 0.3])
  set_payload(2.0, [0.02, 0.0, 0.05])
  while True:
    movej([1.5, -1.2, 1.0, -1.4, -1.57, 0.0], a=10, v=3)
    set_payload(1.0)
    movel(pose_add(get_actual_tcp_pose(), p[0, 0, -0.1, 0, 0, 0]), a=3, v=2)
    set_tcp(p[0, 0, 0.1, 0, 0, 0])
    speedj([1.5, 0, 0, 0, 0, 1], 5, 0.3)
    stopj(5)
    zero_ftsensor()
    movej([-1.5, -0.6, 0.3, -1.3, -1.57, 0.3], a=10, v=3)
  end
end
"""
READS = """def reads():
  set_standard_digital_out(0, True)
  movej([1.5, -1.2, 1.0, -1.4, -1.57, 0.0], a=10, v=3, t=0.2)
  textmsg(get_rtde_value("timestamp"), get_rtde_value("actual_TCP_pose"))
  thread other():
    while True:
      textmsg(get_rtde_value("actual_digital_output_bits"), get_rtde_value("target_q"))
      sync()
    end
  end
  run other()
  movej([1.0, -1.2, 1.0, -1.4, -1.57, 0.0], a=10, v=3)
end
"""


def started(make, model, program, **options):
    rig = make(model, running=True, **options)
    rig.controller.arm.mounted = Payload(1.5, (0.01, 0.02, 0.03))
    rig.script(program)
    return rig


@pytest.mark.parametrize("dynamic", [False, True], ids=["ideal", "dynamic"])
def test_reading_the_state_changes_nothing(make, dynamic):
    seldom, always = (started(make, "ur5e", MOVES, dynamic=dynamic) for _ in range(2))
    always.controller.subscribe(lambda snapshot: snapshot.values())
    for _ in range(8):
        seldom.seconds(0.25)
        always.seconds(0.25)
        assert seldom.now.values() == always.now.values()
    assert seldom.messages == always.messages


def test_a_snapshot_keeps_its_state_whatever_happens_before_it_is_read(make):
    early, late = (started(make, "ur5e", MOVES) for _ in range(2))
    read = [early.tick().values() for _ in range(600)]
    kept = [late.tick() for _ in range(600)]
    assert read == [snapshot.values() for snapshot in kept]


def test_programs_read_the_state_of_the_last_period(make):
    seldom, always = (make("ur5e", running=True) for _ in range(2))
    always.controller.subscribe(lambda snapshot: snapshot.values())
    for rig in (seldom, always):
        rig.seconds(0.1)
        rig.script(READS)
        rig.seconds(1.5)
    assert len(seldom.messages) > 100
    assert seldom.messages == always.messages


@pytest.mark.parametrize("model", ["ur3", "ur10e"])
def test_nothing_is_faster_than_its_bound(make, model):
    """In motions of any speed and direction, whether or not the exact speeds are looked at in between."""
    chance = random.Random(model)
    rig = make(model, running=True, initial_q=(0.0, -1.4, 1.4, -1.6, -1.57, 0.0))
    arm = rig.controller.arm
    near = 0
    for _ in range(12):
        speeds = [round(chance.uniform(-1.2, 1.2), 3) for _ in range(6)]
        tcp = [round(chance.uniform(-0.2, 0.2), 3) for _ in range(3)]
        rig.script(
            f"def swing():\n  set_tcp(p{[*tcp, 0, 0, 0]})\n  speedj({speeds}, {chance.uniform(1, 20)}, 0.2)\nend\n"
        )
        for _ in range(round(0.3 / rig.controller.period_s)):
            rig.tick()
            exact = max(hypot(*arm.tcp_speed[:3]), hypot(*arm.elbow_velocity))
            assert exact <= arm.bounds.speed + 1e-9
            assert arm.efforts.momentum <= arm.bounds.momentum + 1e-9
            near += exact > 0.5 * arm.bounds.speed
            if chance.random() < 0.1:
                arm.certainly_below(0.0, 0.0)
    assert near > 20, "the bounds are of no use"
    rig.until(lambda snapshot: snapshot.actual_qd == ZERO6)
    assert arm.certainly_below(0.0, 0.0)
