"""Saved poses: persistence and names."""

import json
from pathlib import Path

import pytest

from client.errors import FileError
from client.pendant.saved import BUILT_IN, Poses

BOX = (0.1, -1.2, 1.3, -1.4, -1.5, 0.6)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "not there yet" / "poses.json"


def test_poses_are_saved_per_model(path: Path) -> None:
    poses = Poses(path)
    assert poses.for_model("ur5e") == {}
    poses.save("ur5e", "  over   the box ", BOX)
    poses.save("ur5e", "a", BOX)
    assert list(Poses(path).for_model("ur5e").items()) == [("a", BOX), ("over the box", BOX)]
    assert Poses(path).for_model("ur3") == {}
    assert poses.version == 2


def test_saving_replaces_and_deleting_is_idempotent(path: Path) -> None:
    poses = Poses(path)
    poses.save("ur5e", "box", BOX)
    poses.save("ur5e", "box", (0.0,) * 6)
    assert poses.for_model("ur5e") == {"box": (0.0,) * 6}
    poses.delete("ur5e", "box")
    poses.delete("ur5e", "box")
    assert Poses(path).for_model("ur5e") == {}


def test_renaming_never_overwrites(path: Path) -> None:
    poses = Poses(path)
    poses.save("ur5e", "box", BOX)
    poses.save("ur5e", "table", (0.0,) * 6)
    with pytest.raises(ValueError, match="table"):
        poses.rename("ur5e", "box", "table")
    with pytest.raises(ValueError, match="no longer exists"):
        poses.rename("ur5e", "gone", "new")
    poses.rename("ur5e", "box", "lid")
    assert Poses(path).for_model("ur5e") == {"lid": BOX, "table": (0.0,) * 6}


@pytest.mark.parametrize("name", ["", "   ", "x" * 61, *BUILT_IN])
def test_invalid_names_are_rejected(path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="pose"):
        Poses(path).save("ur5e", name, BOX)
    assert not path.exists()


def test_poses_are_kept_in_memory_without_file() -> None:
    poses = Poses(None)
    poses.save("ur5e", "box", BOX)
    assert poses.for_model("ur5e") == {"box": BOX}


@pytest.mark.parametrize(
    "content",
    [
        b"\xff",
        b"{",
        b"[]",
        b'{"ur5e": 1}',
        b'{"ur5e": {"box": [1, 2]}}',
        b'{"ur5e": {"a": [0,0,0,0,0,NaN]}}',
        b'{"ur5e": {"a": [0,0,0,0,0,1' + 400 * b"0" + b"]}}",
        100_000 * b"[",
    ],
    ids=lambda content: content[:35].decode("latin-1"),
)
def test_invalid_file_is_reported_and_not_overwritten(path: Path, content: bytes) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    poses = Poses(path)
    with pytest.raises(FileError, match="does not contain poses"):
        poses.for_model("ur5e")
    with pytest.raises(FileError):
        poses.save("ur5e", "box", BOX)
    assert path.read_bytes() == content


def test_failed_write_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    poses = Poses(tmp_path / "file" / "poses.json")
    with pytest.raises(FileError):
        poses.save("ur5e", "box", BOX)
    assert poses.version == 0


def test_file_is_readable_json(path: Path) -> None:
    Poses(path).save("ur5e", "box", BOX)
    assert json.loads(path.read_text("utf-8")) == {"ur5e": {"box": list(BOX)}}
