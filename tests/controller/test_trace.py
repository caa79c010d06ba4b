"""Output of ``--log-level debug``: reasons for events, one line each with robot time."""

import logging

from emulator.faults.injector import FaultInjector
from emulator.faults.program import ProgramStuck
from emulator.lifecycle.safety import SafetyEvent


def test_each_change_of_state_is_one_line_with_its_reason(rig, caplog):
    caplog.set_level(logging.DEBUG, logger="emulator")
    rig.request("power on")
    rig.request("brake release")
    rig.seconds(1.0)
    rig.script("def p():\n  sleep(100)\nend\n")
    rig.seconds(0.2)
    rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    rig.tick()
    rig.script("def q(:\nend\n")
    rig.tick(2)
    FaultInjector(rig.controller).inject(ProgramStuck(lasting=0.1))
    rig.seconds(0.3)
    lines = [record.getMessage() for record in caplog.records]
    refused = [line for line in lines if "was not started" in line]  # a warning for everybody
    assert len(refused) == 1
    lines.remove(refused[0])
    assert all(line.split(" s: ")[0].replace(".", "", 1).isdigit() for line in lines), lines
    trace_text = "\n".join(line.split(" s: ", 1)[1] for line in lines)
    for expected in (
        "DashboardLine(text='power on', restricted=False) is answered with 'Powering on'",
        "power: POWER_ON in state OFF",
        "power: RELEASING is left for RUNNING",
        "program: 26 bytes to be compiled",
        "program: p is accepted",
        "program: START leads from STOPPED to PLAYING",
        "safety: PROTECTIVE_STOP leads from NORMAL to PROTECTIVE_STOP",
        "stop: category 2 for PROTECTIVE_STOP, the program is PLAYING",
        "program: PAUSE leads from PLAYING to PAUSING",
        "program: a text is refused",
        "fault 1 begins: ProgramStuck(",
        "fault 1 is over: program_stuck",
    ):
        assert expected in trace_text


def test_nothing_is_formatted_without_debug_logging(rig, caplog):
    class Expensive:
        def __str__(self) -> str:
            raise AssertionError("it was looked at")

    caplog.set_level(logging.INFO, logger="emulator")
    rig.controller.messages.trace("%s", Expensive())
    assert not caplog.records
