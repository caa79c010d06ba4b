"""A stop that is released before the arm is at rest."""

from emulator.controller import Controller
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import ControllerConfig
from urproto.modes import SafetyMode
from urproto.robots import load_model


def test_a_stop_released_early_is_not_a_stopping_time_violation():
    controller = Controller(ControllerConfig(model=load_model("ur5e"), running=True))
    for _ in range(200):
        controller.motion.commands.speedj((0.5, 0.0, 0.0, 0.0, 0.0, 0.0), a=10.0)
        controller.tick()
    controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    controller.safety_event(SafetyEvent.UNLOCK)
    for _ in range(1000):
        controller.motion.commands.speedj((0.5, 0.0, 0.0, 0.0, 0.0, 0.0), a=10.0)
        controller.tick()
    assert controller.safety.mode is SafetyMode.NORMAL
    assert abs(controller.motion.qd[0] - 0.5) < 1e-9
