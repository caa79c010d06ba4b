"""Recordings of real arms: how well the emulator's model predicts them, and what their own model is."""
