"""The safety system: its limits, inputs and outputs, monitoring, and reactions."""
