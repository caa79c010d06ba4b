"""What can be asked of a controller from outside: each command is posted and applied at the next tick."""
