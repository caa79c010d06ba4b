"""Campaigns for tests: a folder with a program, and workers that run a job immediately in this process."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from emulator.campaign.workers import Finished, Lost

PROGRAM = """def work():
  movej([0.1, -1.2, 0.3, -1.5, 0.2, 0.4], a=4, v=3)
  sleep(0.2)
  textmsg("done")
end
"""
CAMPAIGN = """
script: work.script
limit_s: 20
matrix:
  robot: [{model: ur3, polyscope: 3.15.8}, {model: ur5e}]
  fault: [null, ["encoder_jump,joint=1,by_rad=0.3,after=9", "runtime_exception,line=3,probability=0.4,message=oh"]]
  seed: {from: 5, count: 3}
"""


def write(folder: Path, text: str = CAMPAIGN, program: str = PROGRAM) -> Path:
    """A campaign file in this folder, with its program."""
    (folder / "work.script").write_text(program)
    path = folder / "trial.yaml"
    path.write_text(text)
    return path


class InProcessWorkers:
    """Workers in this process. loses: whether the process of a job dies, given the arguments of the job."""

    def __init__(self, folder: str, loses: Callable[..., bool] = lambda *_: False) -> None:
        self.folder = folder
        self.size = 2
        self.jobs: list[tuple[Any, ...]] = []
        self._loses = loses
        self._done: list[Finished] = []

    @property
    def room(self) -> int:
        return self.size - len(self._done)

    def submit(self, function: Callable[..., Any], *arguments: Any) -> int:
        self.jobs.append(arguments)
        value = Lost("its process died") if self._loses(*arguments) else function(*arguments)
        self._done.append(Finished(len(self.jobs), value))
        return len(self.jobs)

    def finished(self, patience_s: float) -> list[Finished]:
        done, self._done = self._done, []
        return done

    def close(self) -> None:
        self._done = []
