"""``python -m urscript``."""

from urproto.entry import urscript

if __name__ == "__main__":
    urscript()
