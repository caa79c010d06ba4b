"""Captured streams of the controller's ports, shown to people: one line a message.

- capture: packets out of pcap and pcapng files, and into pcapng
- packets: TCP segments out of packets
- connections: byte streams out of segments, in order
- streams: messages out of a byte stream, garbage skipped and reported
- rtde, states, modbus, external: what the messages of each port say
- codecs: which port speaks what, and guessing it from bytes; the frames that carry a byte stream back into a file
- session: all of this for one input, whatever it is
- formatting: values as text

Everything takes bytes as they come and keeps a bounded number of them.
"""
