"""``python -m client``, and what the command ``ur-client`` calls."""

from urproto.entry import ur_client as main

if __name__ == "__main__":
    main()
