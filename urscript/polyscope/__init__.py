"""What PolyScope saves: programs (`.urp`) and the URScript they are run as, installations, safety settings."""
