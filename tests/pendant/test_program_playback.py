"""Playing the program draft on a robot."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from client.pendant import program_playback as playback
from client.pendant.program_draft import ProgramDraft
from client.pendant.saved import ProgramFile
from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from tests.rows import each_row
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
def station() -> Any:
    return FakeStation()


async def test_robot_gets_script_from_start_or_node(station: Any) -> None:
    draft = station.program_draft
    one = draft.insert("comment", draft.view.first())
    two = draft.insert("halt", one)
    await playback.play(station)
    assert station.sent[0].startswith("def unnamed():")
    assert not playback.is_on_robot(station)  # it has not reported that yet
    station.programs.running = "unnamed"
    assert playback.is_on_robot(station)
    await playback.play(station, at=two)
    assert "play_from_selection" not in station.sent[0]
    assert "play_from_selection" in station.sent[1]
    draft.delete(one)
    assert not playback.is_on_robot(station)


async def test_incomplete_or_external_control_program_is_not_sent(station: Any) -> None:
    draft = station.program_draft
    waypoint = draft.insert("waypoint", draft.view.first())
    with pytest.raises(playback.PlayError, match="teach it: complete the program"):
        await playback.play(station)
    draft.delete(waypoint)
    draft.insert("external_control", draft.view.first())
    with pytest.raises(playback.PlayError, match="at the robot's own pendant"):
        playback.script(station)
    assert station.sent == []


@pytest.mark.parametrize(("name", "path"), [("job", "job.urp"), (" cell/job.urp ", "cell/job.urp")])
def test_names_get_extension(name: str, path: str) -> None:
    assert playback.with_extension(name) == path


@each_row("name", ["", "  ", ".urp"])
def test_empty_name_is_rejected(name: str) -> None:
    with pytest.raises(ValueError, match="a name"):
        playback.with_extension(name)


async def test_nodes_can_use_installation_of_emulator(station: Any, tmp_path: Path) -> None:
    robot = VirtualRobot(ControllerConfig(model=load_model("ur3"), programs_dir=tmp_path))

    async def call(verb: str, **arguments: Any) -> Any:
        return getattr(robot, verb)(**arguments)

    station.emulator = SimpleNamespace(available=True, verbs={"save_program", "installation"}, call=call)
    draft = station.program_draft
    move = draft.insert("move", draft.view.first())
    await playback.load_installation(station)  # there is no file yet
    before = draft.version
    assert "gripper" not in str(draft.editor.form(move))
    robot.add_to_installation("tcps", {"name": "gripper", "pose": [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]})
    await playback.load_installation(station)
    assert "gripper" in str(draft.editor.form(move))
    assert draft.version == before  # not an edit
