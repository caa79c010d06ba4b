"""Remote procedure calls of programs: XML-RPC over HTTP and over packet streams."""
