import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from dap_client import DebugClient


@pytest.fixture
def client():
    made = DebugClient()
    yield made
    made.close()
