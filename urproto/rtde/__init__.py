"""Real-Time Data Exchange (TCP 30004).

- fields: every output and input variable, its wire type, unit and first versions
- recipes: packing and unpacking of a chosen list of variables
- codec: the packages in both directions, protocol versions 1 and 2
"""
