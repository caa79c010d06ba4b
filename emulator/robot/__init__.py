"""The arm with what is mounted on it and stands around it."""
