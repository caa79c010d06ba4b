"""``python -m client``, and the command ``ur-client``."""

from client.cli import main

if __name__ == "__main__":
    main()
