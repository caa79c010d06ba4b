"""Compare recordings of real arms with the emulator's model, and identify the model of an arm from a recording."""
