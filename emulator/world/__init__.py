"""Objects around the arm: solid objects that push back, hands that push, and the resulting forces."""
