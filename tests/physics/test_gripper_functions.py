"""A program with the functions that Robotiq's URCap inserts before programs, in a scene with a part to grip.

Names, arguments and requests are those of preambles written by the URCap; the code is ours.
"""

import asyncio
from pathlib import Path

from emulator.app import Emulator
from emulator.config import EmulatorConfig, controller_config
from tests.physics.conftest import HOME
from tests.ticking import StepClock
from urproto.compat_asyncio import timeout
from urproto.primary.messages import TextMessage

SCENE = """objects:
  table: {box: [1.6, 1.6, 0.1], pose: [0, 0, -0.05], friction: 0.6}
  part: {box: [0.04, 0.04, 0.04], pose: [-0.45, -0.2, 0.0201], mass: 0.2, friction: 0.8}
"""
PROGRAM = """def pick():
  def digit(byte):
    return byte - 48
  end
  def rq_set(name, value, gripper_socket="1"):
    socket_set_var(name, value, gripper_socket)
    answer = socket_read_byte_list(3, gripper_socket)
    return answer[0] == 3 and answer[1] == 97 and answer[2] == 99 and answer[3] == 107
  end
  def rq_digit(name, gripper_socket="1"):
    socket_send_string(str_cat("GET ", name), gripper_socket)
    answer = socket_read_byte_list(1, gripper_socket)
    return digit(answer[1])
  end
  def rq_init_connection(gripper_sid=9, gripper_socket="1"):
    socket_open("127.0.0.1", 63352, gripper_socket)
    return rq_set("SID", gripper_sid, gripper_socket)
  end
  def rq_is_gripper_activated(gripper_socket="1"):
    return rq_digit("STA", gripper_socket) == 3
  end
  def rq_activate_and_wait(gripper_socket="1"):
    rq_set("ACT", 0, gripper_socket)
    rq_set("ATR", 0, gripper_socket)
    rq_set("ACT", 1, gripper_socket)
    while not rq_is_gripper_activated(gripper_socket):
      sync()
    end
  end
  def rq_set_pos(pos, gripper_socket="1"):
    rq_set("GTO", 0, gripper_socket)
    requested = -1
    while requested != pos:
      rq_set("POS", pos, gripper_socket)
      socket_send_string("GET PRE", gripper_socket)
      answer = socket_read_byte_list(3, gripper_socket)
      requested = 100 * digit(answer[1]) + 10 * digit(answer[2]) + digit(answer[3])
    end
  end
  def rq_is_object_detected(gripper_socket="1"):
    found = rq_digit("OBJ", gripper_socket)
    return found == 1 or found == 2
  end
  def rq_move_and_wait(pos, gripper_socket="1"):
    rq_set_pos(pos, gripper_socket)
    rq_set("GTO", 1, gripper_socket)
    while rq_digit("OBJ", gripper_socket) == 0:
      sleep(0.01)
    end
  end
  def rq_open_and_wait(gripper_socket="1"):
    rq_move_and_wait(0, gripper_socket)
  end
  def rq_close_and_wait(gripper_socket="1"):
    rq_move_and_wait(255, gripper_socket)
  end
  set_tcp(p[0, 0, 0.163, 0, 0, 0])
  textmsg("connected ", rq_init_connection())
  rq_activate_and_wait()
  rq_close_and_wait()
  textmsg("nothing there ", rq_is_object_detected())
  rq_open_and_wait()
  movel(p[-0.45, -0.2, 0.2, 0, 3.14159, 0], v=0.5)
  movel(p[-0.45, -0.2, 0.02, 0, 3.14159, 0], v=0.3)
  rq_close_and_wait()
  textmsg("a part ", rq_is_object_detected())
  movel(p[-0.45, -0.2, 0.2, 0, 3.14159, 0], v=0.3)
  textmsg("at ", floor(socket_get_var("POS", "1")))
  textmsg("carried ", rq_is_object_detected())
end
"""


async def test_urcap_functions_grip_a_part(tmp_path: Path) -> None:
    (scene := tmp_path / "cell.yaml").write_text(SCENE)
    controller_of = controller_config(
        "ur5", world=scene, physics=True, running=True, gripper="robotiq-2f-85", initial_q=HOME
    )
    async with Emulator(EmulatorConfig(controller=controller_of, ephemeral_ports=True), StepClock()) as emulator:
        controller, texts = emulator.controller, list[str]()
        controller.subscribe(
            lambda snapshot: texts.extend(m.text for m in snapshot.messages if isinstance(m, TextMessage))
        )
        controller.programs.submit(PROGRAM)
        async with timeout(60):
            while controller.programs.busy:
                controller.tick()
                await asyncio.sleep(0)
        assert controller.world is not None
        assert controller.world.poses()["part"][2] > 0.19
        width = controller.gripper.model.width_mm(float(texts[3].removeprefix("at ")))
    assert texts == ["connected True", "nothing there False", "a part True", texts[3], "carried True"]
    assert 39.0 < width < 41.0
