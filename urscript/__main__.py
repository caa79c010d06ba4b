"""``python -m urscript``, and the command ``urscript``."""

import sys

from urproto.text import show_any_text
from urscript.cli import main

if __name__ == "__main__":
    show_any_text(sys.stdout, sys.stderr)
    raise SystemExit(main())
