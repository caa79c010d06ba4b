"""Entry point of ``python -m client``, the same as the command ``ur-client``."""

from urproto.entry import ur_client as main

if __name__ == "__main__":
    main()
