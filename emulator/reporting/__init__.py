"""Messages and dialogues of the controller."""
