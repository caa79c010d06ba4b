"""Playing the program draft on a robot."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from client.pendant import program_playing as playing
from client.pendant.emulator_control import EmulatorControlError
from client.pendant.program_draft import ProgramDraft
from client.pendant.program_file import ProgramFile
from emulator.control.control import VirtualRobot
from emulator.control.verbs import NotPossible
from emulator.machine import ControllerConfig
from urproto.modes import RuntimeState
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

ROBOT = (PolyscopeVersion(3, 15, 8), load_model("ur3"))


class FakeStation(SimpleNamespace):
    """A real robot, which has no control API."""

    def __init__(self) -> None:
        draft = ProgramDraft(ProgramFile(None, ""), lambda _: None, lambda: None, lambda: ROBOT)
        emulator = SimpleNamespace(available=False, verbs=frozenset())
        programs = SimpleNamespace(running="", loaded=None, refresh=lambda: None)
        super().__init__(program_draft=draft, emulator=emulator, programs=programs, runtime_state=RuntimeState.STOPPED)
        self.mover = SimpleNamespace(release_control=self._do_nothing)
        self.sent = list[str]()

    async def _do_nothing(self) -> None:
        pass

    async def send_script(self, text: str) -> None:
        self.sent.append(text)


@pytest.fixture
def arm() -> Any:
    return FakeStation()


async def test_robot_gets_script_from_start_or_node(arm: Any) -> None:
    draft = arm.program_draft
    one = draft.insert("comment", draft.view.first())
    two = draft.insert("halt", one)
    await playing.play(arm)
    assert arm.sent[0].startswith("def unnamed():")
    assert not playing.is_on_robot(arm)  # it has not reported that yet
    arm.programs.running = "unnamed"
    assert playing.is_on_robot(arm)
    await playing.play(arm, at=two)
    assert "play_from_selection" not in arm.sent[0]
    assert "play_from_selection" in arm.sent[1]
    draft.delete(one)
    assert not playing.is_on_robot(arm)


async def test_incomplete_or_external_control_program_is_not_sent(arm: Any) -> None:
    draft = arm.program_draft
    waypoint = draft.insert("waypoint", draft.view.first())
    with pytest.raises(playing.PlayError, match="teach it: complete the program"):
        await playing.play(arm)
    draft.delete(waypoint)
    draft.insert("external_control", draft.view.first())
    with pytest.raises(playing.PlayError, match="at the robot's own pendant"):
        playing.script(arm)
    assert arm.sent == []


@pytest.mark.parametrize(("name", "path"), [("job", "job.urp"), (" cell/job.urp ", "cell/job.urp")])
def test_names_get_extension(name: str, path: str) -> None:
    assert playing.with_extension(name) == path


@pytest.mark.parametrize("name", ["", "  ", ".urp"])
def test_empty_name_is_rejected(name: str) -> None:
    with pytest.raises(ValueError, match="a name"):
        playing.with_extension(name)


async def test_nodes_can_use_installation_of_emulator(arm: Any, tmp_path: Path) -> None:
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3"), programs_dir=tmp_path))

    async def call(verb: str, **arguments: Any) -> Any:
        try:
            return getattr(robot, verb)(**arguments)
        except NotPossible as error:
            raise EmulatorControlError(str(error)) from error

    arm.emulator = SimpleNamespace(available=True, verbs={"save_program", "installation"}, call=call)
    draft = arm.program_draft
    move = draft.insert("move", draft.view.first())
    await playing.load_installation(arm)  # there is no file yet
    before = draft.version
    assert "gripper" not in str(draft.editor.form(move))
    robot.add_to_installation("tcps", {"name": "gripper", "pose": [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]})
    await playing.load_installation(arm)
    assert "gripper" in str(draft.editor.form(move))
    assert draft.version == before  # not an edit
