"""What is wired to the controller: signals, registers, encoders, lights."""
