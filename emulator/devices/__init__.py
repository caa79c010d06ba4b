"""Devices mounted on the arm: state machines that the controller advances once per control period."""
