"""``python -m emulator``, and what the command ``ur-emulator`` calls."""

from urproto.entry import ur_emulator as main

if __name__ == "__main__":
    main()
