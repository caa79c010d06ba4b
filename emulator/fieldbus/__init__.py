"""The robot as other machines read and write it: what an RTDE input does, and the memory of the Modbus server."""
