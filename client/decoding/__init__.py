"""Decode captured traffic of the controller's ports into readable text, one line per message.

- capture: read packets from pcap and pcapng files, and write pcapng files
- packets: extract TCP segments from packets
- connections: assemble segments to ordered byte streams
- streams: cut byte streams into messages, skipping and reporting garbage
- rtde, states, modbus, external: the messages of each port
- codecs: the protocol of each port, or guessed from the bytes; frames for writing a byte stream to a file
- session: all of this for one input of any format
- formatting: values as text

Everything accepts bytes in chunks of any size and buffers a bounded number of them.
"""
