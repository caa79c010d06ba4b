"""``python -m urscript``, and the command ``urscript``."""

import sys

from urproto.text import show_anything
from urscript.cli import main

if __name__ == "__main__":
    show_anything(sys.stdout, sys.stderr)
    raise SystemExit(main())
