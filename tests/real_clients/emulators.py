"""Emulators by model name, one at a time. Each is recorded: its run with all its clients must replay bit for bit."""

from pathlib import Path

from emulator_process import EmulatorProcess
from rig import Rig

from emulator.journal.replay import Replay

_NEW = ["--model", "ur5e", "--polyscope", "5.26", "--remote-control"]
ARGUMENTS = {
    "ur3": (["--model", "ur3"], (3, 15), 0.008),
    "ur3e": (["--model", "ur3e", "--polyscope", "5.22", "--remote-control"], (5, 22), 0.002),
    "ur5e": (_NEW, (5, 26), 0.002),
    "ur5e dynamic": ([*_NEW, "--arm", "dynamic"], (5, 26), 0.002),
    "ur3 dynamic": (["--model", "ur3", "--arm", "dynamic", "--seed", "5"], (3, 15), 0.008),
    # The newest PolyScope that the release of python-urx reads.
    "ur3 3.4": (["--model", "ur3", "--polyscope", "3.4", "--gripper", "robotiq-2f-85"], (3, 4), 0.008),
}


class Emulators:
    """One emulator at a time: requesting another model ends the previous one and checks that it ends cleanly."""

    def __init__(self, positions: Path) -> None:
        self._positions = positions
        self._journal = positions.with_name("run.journal")
        self._rig: Rig | None = None

    def get(self, model: str) -> Rig:
        if self._rig is None or self._rig.model != model:
            self.close()
            _, polyscope, period_s = ARGUMENTS[model]
            process = EmulatorProcess(self.arguments(model))
            self._rig = Rig(process, model, polyscope, period_s)
        return self._rig if self._rig.process.running else self._rig.start()

    def arguments(self, model: str) -> list[str]:
        """Arguments of its command line."""
        recorded = ["--initial-positions", str(self._positions), "--journal", str(self._journal)]
        return [*ARGUMENTS[model][0], "--running", *recorded]

    def close(self) -> None:
        rig, self._rig = self._rig, None
        if rig is not None:
            status = rig.process.stop() if rig.process.running else 0
            rig.process.dispose()
            assert status == 0, f"the {rig.model} emulator ended with status {status}"
            self._replay()

    def _replay(self) -> None:
        with Replay(self._journal) as replay:
            replay.run()
            assert replay.difference is None, f"{replay.difference}; {self._journal} can be replayed"
            assert replay.checked
