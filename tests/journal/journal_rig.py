"""A robot in virtual time that is recorded, and the replay of its run."""

from emulator.journal.file import MemorySink
from emulator.journal.recorder import record
from emulator.journal.replay import Replay
from emulator.virtual import virtual_robot


class Recorded:
    """robot: to be used as any other. replay: executes its run again, once it is complete."""

    def __init__(self, model="ur5e", prepare=lambda robot: None, **options):
        self.robot = virtual_robot(model, **{"running": True, **options})
        prepare(self.robot)
        self._recorder = record(self.robot, MemorySink())

    def post(self, command):
        answers = []
        self.robot.controller.post(command, answers.append)
        return answers

    @property
    def journal(self):
        return self._recorder.journal

    def replay(self):
        return Replay(self.journal)

    def is_repeated(self):
        """The whole run gives the same values in all periods, and again the same program log."""
        with self.replay() as again:
            again.run()
            assert again.difference is None, str(again.difference)
            assert again.checked == again.periods == self._recorder.periods
            mine, its = self.robot.controller, again.controller
            assert its.messages.history == mine.messages.history
            assert its.time_s == mine.time_s
