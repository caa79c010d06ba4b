"""What recording costs: control periods with and without a journal, in turns, and the size of the journal."""

import sys
import time
from statistics import median

from table import Table

from emulator.commands.requests import RTDEInputs
from emulator.journal.file import MemorySink
from emulator.journal.recorder import record
from emulator.journal.replay import Replay
from emulator.virtual import VirtualRobot, virtual_robot

SECONDS = 6.0  # of robot time in each block
BLOCKS = 5
SWING = """def swing():
  while True:
    movej([0.5, -1.2, 1.0, -1.4, -1.57, 0.0])
    movej([-0.5, -1.6, 1.3, -1.3, -1.57, 0.3])
  end
end
"""
CASES = {"at rest": ("", False), "movej": (SWING, False), "six RTDE inputs in each period": ("", True)}


def measure() -> Table:
    """Medians of the blocks."""
    rows = []
    for name, (script, inputs) in CASES.items():
        plain, recorded, sizes, again = [], [], [], []
        for _ in range(BLOCKS):
            plain.append(_run(virtual_robot("ur5e", running=True), script, inputs))
            robot = virtual_robot("ur5e", running=True)
            recorder = record(robot, MemorySink())
            recorded.append(_run(robot, script, inputs))
            sizes.append(len(journal := recorder.journal))
            began = time.process_time()
            with Replay(journal) as replay:
                replay.run()
                assert replay.difference is None
            again.append(SECONDS / (time.process_time() - began))
        off, on = median(plain), median(recorded)
        rows.append(
            [
                name,
                f"{1e6 * off:.0f} us",
                f"{1e6 * on:.0f} us",
                f"{100.0 * (on - off) / 0.002:.1f} %",
                f"{median(sizes) * 60.0 / SECONDS / 1e6:.2f} MB",
                f"{median(again):.0f} x",
            ]
        )
    about = (
        f"A UR5e at 500 Hz in virtual time, medians of {BLOCKS} blocks of {SECONDS:g} s of robot time, in turns. In "
        "real time, a thread compresses the journal, which is included here. The last column is how fast a replay is, "
        "with the start of the robot."
    )
    heads = ["", "period", "recorded", "of a core at 500 Hz", "journal of a minute", "replay"]
    return Table("Journals", about, heads, rows)


def _run(robot: VirtualRobot, script: str, inputs: bool) -> float:
    """CPU time of a control period [s]."""
    controller = robot.controller
    if script:
        robot.send_script(script)
    periods = round(SECONDS / controller.period_s)
    began = time.process_time()
    for number in range(periods):
        if inputs:
            controller.post(RTDEInputs({f"input_double_register_{24 + n}": 0.001 * number + n for n in range(6)}))
        controller.tick()
    return (time.process_time() - began) / periods


if __name__ == "__main__":
    sys.stdout.write(measure().markdown())
