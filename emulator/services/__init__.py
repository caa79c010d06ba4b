"""Services for programs that outlive them: sockets, Modbus signals, run-state outputs, watchdogs."""
