"""Programs: loading, compiling, starting, pausing and ending them."""
