"""Pages about the code name files, folders and modules that exist."""

import re
from pathlib import Path

from tests.rows import each_row

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(
        ROOT / name
        for name in (
            "CONTRIBUTING.md",
            "docs/architecture.md",
            "docs/read_first.md",
            "docs/robustness.md",
            "docs/writing.md",
        )
    ),
    *(
        ROOT / "docs" / "reference" / name
        for name in ("layers.md", "sources.md", "container_tests.md", "ros2_tests.md")
    ),
]
FOLDERS = ("urproto", "urscript", "emulator", "client", "tests", "benchmarks", "docs", "examples", "docker")
KINDS = "py|csv|toml|tsv|script"
OTHERS = {"dashboard_client.py", "send_dummy_motion_primitives_ur10e.py"}  # files of other projects
WRITTEN = {"tests/fuzzing/corpus/TARGET.txt"}  # by commands


def is_module(name: str) -> bool:
    """Whether a dotted name is a module, or something in one."""
    parts = name.split(".")
    places = [ROOT.joinpath(*parts[:count]) for count in range(len(parts), max(1, len(parts) - 3), -1)]
    return any(place.is_dir() or place.with_suffix(".py").is_file() for place in places)


@each_row("page", PAGES, ids=lambda page: page.name)
def test_named_files_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    paths = [path.as_posix() for folder in FOLDERS for path in (ROOT / folder).rglob("*")]
    missing = set()
    for name in re.findall(rf"`([\w/]+\.(?:{KINDS}))`", text):
        if name not in OTHERS and not any(path.endswith(f"/{name}") for path in paths):
            missing.add(name)
    for name in re.findall(rf"`((?:{'|'.join(FOLDERS)})/[\w/.]*)`", text):
        if name not in WRITTEN and not (ROOT / name).exists():
            missing.add(name)
    modules = re.findall(r"`((?:urproto|urscript|emulator|client)(?:\.\w+)+)`", text)
    assert not missing | {name for name in modules if not is_module(name)}


def test_pages_named_in_the_code_exist() -> None:
    files = [
        path for package in ("urproto", "urscript", "emulator", "client") for path in (ROOT / package).rglob("*.py")
    ]
    named = {name for path in files for name in re.findall(r"docs/[\w/]+\.md", path.read_text(encoding="utf-8"))}
    assert len(named) > 5
    assert not [name for name in named if not (ROOT / name).exists()]
