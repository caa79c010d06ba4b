"""What serves programs and outlives each of them: sockets, Modbus signals, outputs that follow them, watchdogs."""
