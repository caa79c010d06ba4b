"""What is wired to the controller or mapped like it: signals, registers, encoders, lights, Modbus memory."""
