"""Simulated devices that a script talks to: on sockets, by XML-RPC and by Modbus (docs/peers.md).

`file` reads them from YAML, `connection` carries out what a device on a socket does, `answers` and `modbus` decide what
it answers, and `log` is what the script sent to it.
"""
