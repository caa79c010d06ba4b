"""Commands of ``ur-client`` that are more than a call; ``client.cli`` has the others."""
