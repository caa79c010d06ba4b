"""Captured streams of the controller's ports, told to people: one line a message.

- capture: packets out of pcap and pcapng files
- packets: TCP segments out of packets
- capture_writer, frames: the way back, a pcapng file out of byte streams
- connections: byte streams out of segments, in order
- streams: messages out of a byte stream, garbage skipped and told
- rtde, states, modbus, external, texts: what the messages of each port say
- codecs: which port speaks what, and guessing it from bytes
- session: all of this for one input, whatever it is
- show: values as text

Everything takes bytes as they come and keeps a bounded number of them.
"""
