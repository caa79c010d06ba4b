"""The effects of RTDE inputs, and the registers and coils of the Modbus server."""
