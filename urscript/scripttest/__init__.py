"""Test files of programs: which settings they have, and the program that a test and the files under test become."""
