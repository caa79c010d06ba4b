"""The system's Chromium, as tests start it, and axe, which finds what keeps people from using a page."""

import os
import shutil
from pathlib import Path

import axe_playwright_python
from playwright.sync_api import Page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--use-gl=angle", "--use-angle=swiftshader-webgl", "--enable-unsafe-swiftshader"),
    *(["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []),
]
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
AXE = (Path(axe_playwright_python.__file__).parent / "axe.min.js").read_text("utf-8")
VIOLATIONS = """async ([where, rules]) => {
  const found = await axe.run(where, { runOnly: { type: 'tag', values: rules }, resultTypes: ['violations'] });
  return found.violations.flatMap(({ id, nodes }) => nodes.map(({ html, any, all, none }) =>
    `${id}: ${html.slice(0, 160)} ${[...any, ...all, ...none].map(({ message }) => message).join('; ')}`));
}"""


def violations(page: Page, where: str) -> list[str]:
    """The findings of axe. Under load, the page may have been reloaded since the library was injected."""
    if page.evaluate("() => !window.axe"):
        page.evaluate(f"() => {{ {AXE} }}")
    found: list[str] = page.evaluate(VIOLATIONS, [where, RULES])
    return found
