"""Compare recordings of real arms with the emulator's model, and identify the model of an arm from a recording."""

from importlib.util import find_spec

from client.errors import MissingExtraError

if find_spec("pinocchio") is None:
    raise MissingExtraError("comparing a recording with the model of its arm", "pinocchio")
