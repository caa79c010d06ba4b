"""Signals, registers, encoders and lights of the controller."""
