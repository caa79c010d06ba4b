"""``python -m urscript``, and the command ``urscript``."""

from urscript.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
