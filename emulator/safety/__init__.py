"""The safety system: what it watches, what inputs tell it, and what it does about it."""
