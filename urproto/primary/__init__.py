"""Primary and secondary client interface (TCP 30001, 30002 and read-only 30011, 30012).

- framing: splitting a byte stream into messages; its chunks may be of any size
- state, subpackages: robot state (type 16) and its parts
- messages: robot messages (type 20): text, key, error, popup, version, ...
- program_state: program state (type 25): names and values of program variables
"""
