"""``ur-emulator exec``: an emulator and unmodified programs that share a clock, which waits for all of them."""
