"""What the controller tells: messages, dialogues, reports, states for primary clients."""
