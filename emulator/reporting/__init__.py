"""What the controller tells people: messages and dialogues."""
