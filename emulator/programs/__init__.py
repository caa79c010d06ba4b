"""Running programs: which one, when it is compiled, started, paused and ended."""
