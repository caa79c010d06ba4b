"""Builds the documentation site from the pages of this repository: ``python docs/site.py``, or ``make site``.

The pages are written to be read in a repository browser too, so their links lead to files there. Here they are copied
to ``build/pages`` with those links turned into links of the site, and rendered by Zensical into ``build/site``. What a
page shows of the repository beside pages (an example, a manifest) comes along as a file. Nothing is fetched. At the end
every link and anchor of every page is followed; one that leads nowhere is an error. For assistants, ``llms.txt`` lists
the pages and ``llms-full.txt`` has their text (https://llmstxt.org).
"""

import posixpath
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from urproto.compat import load_toml

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build"
CONFIG = ROOT / "zensical.toml"
# Pages that stand elsewhere in the repository, and where the site has them.
ELSEWHERE = {
    "README.md": "readme.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "examples/ci/README.md": "ci_project.md",
}
_LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")
_COMMENT = re.compile(r"^<!--.*?-->\n", re.MULTILINE | re.DOTALL)  # notes for the tests
_FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_HIDDEN = {"__pycache__", ".pytest_cache"}


class BrokenLinkError(Exception):
    """A page links to what is not there."""


def main() -> int:
    """Build the site; the exit status."""
    try:
        stage(BUILD / "pages")
        shutil.rmtree(BUILD / "site", ignore_errors=True)
        done = subprocess.run([sys.executable, "-m", "zensical", "build", "--clean", "-f", str(CONFIG)], check=False)
        if done.returncode:
            return done.returncode
        broken = [*dead_links(BUILD / "site")]
        for name, text in for_assistants(BUILD / "pages").items():
            (BUILD / "site" / name).write_text(text, encoding="utf-8")
    except BrokenLinkError as problem:
        broken = [str(problem)]
    for line in broken:
        sys.stderr.write(f"{line}\n")
    if not broken:
        sys.stdout.write(f"The site is in {(BUILD / 'site').relative_to(ROOT)}: open index.html there.\n")
    return 1 if broken else 0


def sources() -> dict[str, str]:
    """Every page: where it stands in the repository, and in the site."""
    pages = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / "docs").rglob("*.md")}
    return {source: source.removeprefix("docs/") for source in sorted(pages)} | ELSEWHERE


def stage(folder: Path) -> None:
    """Copy all pages, their pictures and the files they link to.

    Raises:
        BrokenLinkError: a page links to a file that is not in the repository.
    """
    shutil.rmtree(folder, ignore_errors=True)
    pages = sources()
    for source, page in pages.items():
        text, files = rewritten(source, pages)
        place = folder / page
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text, encoding="utf-8")
        for file in files:
            _copy(file, folder)


def rewritten(source: str, pages: dict[str, str]) -> tuple[str, set[str]]:
    """The text of a page for the site, and the files and folders of the repository that it links to."""
    here = posixpath.dirname(source)
    start = posixpath.dirname(pages[source]) or "."
    files = set[str]()

    def link(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(here, match[1]))
        if not (ROOT / target).exists():
            raise BrokenLinkError(f"{source} links to {match[1]}, which is not there")
        goal = pages.get(target)
        if goal is None:
            files.add(target)
            goal = f"{_in_site(target)}/index.md" if (ROOT / target).is_dir() else _in_site(target)
        return posixpath.relpath(goal, start) + (match[2] or "")

    text = (ROOT / source).read_text(encoding="utf-8")
    parts = list[str]()
    at = 0
    for fence in _FENCE.finditer(text):  # code stays as it is
        parts += [_LINK.sub(link, _COMMENT.sub("", text[at : fence.start()])), fence[0]]
        at = fence.end()
    parts.append(_LINK.sub(link, _COMMENT.sub("", text[at:])))
    return "".join(parts), files


def _in_site(target: str) -> str:
    """Where a file of the repository that is not a page is in the site."""
    return target.removeprefix("docs/") if target.startswith("docs/") else f"files/{_shown(target)}"


def _shown(name: str) -> str:
    """A path without the dots at the beginning of its parts: Zensical leaves such files out."""
    return "/".join(part.lstrip(".") for part in name.split("/"))


def _copy(target: str, folder: Path) -> None:
    """A file, or a folder with a page that lists what is in it."""
    here, there = ROOT / target, folder / _in_site(target)
    if here.is_file():
        there.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(here, there)
        return
    listed = list[str]()
    for path in sorted(here.rglob("*")):
        if not path.is_file() or path.suffix in (".pyc", ".md") or _HIDDEN & set(path.parts):
            continue
        name = path.relative_to(here).as_posix()
        shown = there / _shown(name)
        shown.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, shown)
        listed.append(f"- [`{name}`]({shown.relative_to(there).as_posix()})")
    there.mkdir(parents=True, exist_ok=True)
    (there / "index.md").write_text(f"# Files in `{target}`\n\n" + "\n".join(listed) + "\n", encoding="utf-8")


def for_assistants(folder: Path) -> dict[str, str]:
    """The files for assistants, by name, from the staged pages."""
    project = load_toml(CONFIG.read_text(encoding="utf-8"))["project"]
    head = f"# {project['site_name']}\n\n> {project['site_description']}\n"
    listed, full = [head, "\n"], [head]
    for title, page in _entries(project["nav"]):
        if not page:
            listed.append(f"\n## {title}\n\n")
            continue
        text = (folder / page).read_text(encoding="utf-8")
        listed.append(f"- [{title}]({page.removesuffix('.md')}.html)\n")
        full.append(f"\n<!-- {page} -->\n{text}")
    return {"llms.txt": "".join(listed), "llms-full.txt": "".join(full)}


def _entries(nav: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Each page's title and place; each section's title before its pages."""
    for entry in nav:
        for title, inside in entry.items():
            if isinstance(inside, str):
                yield title, inside
            else:
                yield title, ""
                yield from _entries(inside)


class _Page(HTMLParser):
    """ids: what can be linked to. links: what it links to. fetched: what a browser gets by itself."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids = set[str]()
        self.links = set[str]()
        self.fetched = set[str]()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.ids |= {value for name in ("id", "name") if (value := values.get(name))}
        if tag == "a" and (to := values.get("href")):
            self.links.add(to)
        if tag in ("script", "img", "iframe") and (source := values.get("src")):
            self.fetched.add(source)
        if tag == "link" and values.get("rel") in ("stylesheet", "icon", "preload") and (to := values.get("href")):
            self.fetched.add(to)


def dead_links(site: Path) -> Iterator[str]:
    """What links to nothing, and what a browser would fetch from elsewhere: a line each."""
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    for path, page in pages.items():
        shown = path.relative_to(site)
        for target in sorted(page.links | page.fetched):
            url = urlsplit(target)
            if url.scheme or url.netloc:
                if target in page.fetched and url.scheme != "data":
                    yield f"{shown} fetches {target}: the site has to work without the internet"
                continue
            there = (path.parent / unquote(url.path)).resolve() if url.path else path
            if path.name == "404.html" and url.path.startswith("/"):
                there = site / unquote(url.path).lstrip("/")
            there = there / "index.html" if there.is_dir() else there
            if not there.is_file():
                yield f"{shown} links to {target}, which is not there"
            elif url.fragment and there in pages and unquote(url.fragment) not in pages[there].ids | {"__skip"}:
                yield f"{shown} links to {target}, but there is no such section"


if __name__ == "__main__":
    sys.exit(main())
