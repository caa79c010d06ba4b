"""Generated parts of the documentation match the code."""

import runpy
from pathlib import Path

from client.controllers.configuration import CONTROLLER_TYPES
from client.pendant.screens import SCREENS
from tests.rows import each_row
from urproto.robots import MODELS

ROOT = Path(__file__).resolve().parents[2]
PAGES = runpy.run_path(str(ROOT / "docs" / "generate.py"))["pages"]()


@each_row("page", PAGES)
def test_generated_pages_match_the_code(page) -> None:
    written = ROOT / "docs" / "reference" / page
    assert written.read_text() == PAGES[page](), f"{written} is stale: run `make docs`"


def test_readme_names_every_arm() -> None:
    readme = (ROOT / "README.md").read_text()
    assert all(name in readme for name in MODELS)


def test_pages_name_every_type_of_controller_and_every_screen() -> None:
    controllers, pendant = ((ROOT / "docs" / page).read_text() for page in ("controllers.md", "pendant.md"))
    assert [name for name in CONTROLLER_TYPES if f"`{name}`" not in controllers] == []
    assert [screen.title for screen in SCREENS if screen.title not in pendant] == []
