"""The driver library: dashboard, data exchange and scripts for a robot, emulated or real."""
