"""A package, so that its tests share one robot: fixtures of scope package end with the last test of the folder."""
