"""What stands around the arm: solid things that push back, hands that push, and what comes of it."""
