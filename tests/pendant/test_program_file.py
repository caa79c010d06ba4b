"""The file in which a pendant saves the program draft."""

from pathlib import Path

import pytest

from client.errors import FileError
from client.pendant.saved import ProgramFile, SavedDraft
from tests.rows import each_row

DRAFT = SavedDraft("cell/job.urp", True, b"\x1f\x8b\x00<URProgram/>")


def test_draft_is_saved_per_robot_address(tmp_path: Path) -> None:
    ProgramFile(tmp_path / "drafts", "192.168.0.2_30001").write(DRAFT)
    assert ProgramFile(tmp_path / "drafts", "192.168.0.2_30001").read() == DRAFT
    assert ProgramFile(tmp_path / "drafts", "192.168.0.3_30001").read() is None
    assert [path.name for path in (tmp_path / "drafts").iterdir()] == ["192.168.0.2_30001.json"]


def test_address_cannot_leave_folder(tmp_path: Path) -> None:
    ProgramFile(tmp_path, "../../fe80::1%eth0/x").write(DRAFT)
    assert len(list(tmp_path.iterdir())) == 1


@each_row("content", ["", "{", "[]", "{}", '{"path": "", "changed": true, "urp": "?"}', "null"])
def test_unreadable_file_is_moved_aside(tmp_path: Path, content: str) -> None:
    file = ProgramFile(tmp_path, "robot")
    (tmp_path / "robot.json").write_text(content)
    with pytest.raises(FileError, match="not a program draft of a pendant"):
        file.read()
    assert (tmp_path / "robot.unreadable").read_text() == content
    assert file.read() is None


def test_nothing_is_saved_without_folder() -> None:
    file = ProgramFile(None, "robot")
    file.write(DRAFT)
    assert file.read() is None


def test_uncreatable_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "drafts").write_text("a file")
    with pytest.raises(FileError):
        ProgramFile(tmp_path / "drafts", "robot").write(DRAFT)
