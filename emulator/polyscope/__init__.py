"""PolyScope program trees (`.urp` files) and what they are in URScript."""
