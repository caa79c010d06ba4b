"""The documentation site builds without the internet, and all its links are valid."""

import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from urproto.compat import load_toml

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the repository's files, so that nothing is written into the repository."""
    folder = tmp_path_factory.mktemp("repository") / "copy"
    shutil.copytree(ROOT, folder, ignore=left_out)
    return folder


def left_out(_folder: str, names: list[str]) -> set[str]:
    ours = {".github", ".gitlab-ci.yml", ".gitignore"}
    return {
        name
        for name in names
        if (name.startswith(".") and name not in ours) or name in ("build", "__pycache__") or name.endswith(".egg-info")
    }


def site_of(root: Path) -> dict[str, Any]:
    return runpy.run_path(str(root / "docs" / "site.py"))


@pytest.mark.long
def test_the_site_builds_without_dead_links(copy: Path) -> None:
    done = subprocess.run([sys.executable, "docs/site.py"], cwd=copy, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stdout + done.stderr
    site = copy / "build" / "site"
    assert 'id="client.AsyncRobot.make_ready"' in (site / "api" / "robot.html").read_text()  # from a docstring
    assert "- [Editors](editors.html)\n" in (site / "llms.txt").read_text()
    assert (copy / "docs" / "writing.md").read_text() in (site / "llms-full.txt").read_text()
    assert (site / "files" / "examples" / "table.yaml").read_text() == (ROOT / "examples" / "table.yaml").read_text()


def test_every_page_is_in_the_navigation() -> None:
    config = load_toml((ROOT / "zensical.toml").read_text())
    assert sorted(pages(config["project"]["nav"])) == sorted(site_of(ROOT)["sources"]().values())


def pages(nav: list[dict[str, Any]]) -> list[str]:
    found = list[str]()
    for entry in nav:
        for value in entry.values():
            found += [value] if isinstance(value, str) else pages(value)
    return found


def test_dead_links_and_external_resources_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<h1 id="here"></h1><a href="b.html">1</a><a href="#there">2</a><a href="#here">3</a><a href="https://a.org">4</a>'
        '<script src="https://a.org/x.js"></script>'
    )
    assert sorted(line.split(":")[0] for line in site_of(ROOT)["dead_links"](tmp_path)) == [
        "a.html fetches https",
        "a.html links to #there, but there is no such section",
        "a.html links to b.html, which is not there",
    ]


def test_a_page_with_a_link_to_a_missing_file_is_named(copy: Path) -> None:
    page = copy / "docs" / "teaching.md"
    before = page.read_text()
    page.write_text(before + "\n[a slip](../examples/gone.py)\n")
    try:
        done = subprocess.run([sys.executable, "docs/site.py"], cwd=copy, capture_output=True, text=True, timeout=110)
    finally:
        page.write_text(before)
    assert done.returncode == 1
    assert "docs/teaching.md links to ../examples/gone.py, which is not there" in done.stderr
