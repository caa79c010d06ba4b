"""Bytes recorded from controllers, by file name."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # primary_structs; importlib mode does not add the folder

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


@pytest.fixture
def golden() -> Callable[[str], bytes]:
    """Read ``tests/golden/<name>.hex``: comment lines state the origin, the rest is hexadecimal."""

    def read(name: str) -> bytes:
        lines = (GOLDEN / f"{name}.hex").read_text().splitlines()
        assert lines[0].startswith("#"), f"{name}.hex does not state its origin"
        return bytes.fromhex("".join(line for line in lines if not line.startswith("#")))

    return read
