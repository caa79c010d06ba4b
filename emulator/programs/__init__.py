"""Running URScript programs against the controller."""
