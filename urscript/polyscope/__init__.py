"""PolyScope's files: programs (`.urp`) and their translation to URScript, installations, safety settings."""
