"""The safety system: its configuration, what it watches, what it is told by inputs, and what it does about it."""
