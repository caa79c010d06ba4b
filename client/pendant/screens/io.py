"""I/O."""

from client.pendant.page import Page

__all__ = ["build"]


def build(page: Page) -> None:
    """Put it on the page."""
