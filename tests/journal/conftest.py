import sys
from pathlib import Path

from tests.browser import CHROMIUM

sys.path.insert(0, str(Path(__file__).parent))

if CHROMIUM is None:
    collect_ignore_glob = ["test_*_browser.py"]
