"""Commands to a controller from outside: each is posted, and applied in the next control period."""
