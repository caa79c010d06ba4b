"""What both ends of the wire agree on: codecs without I/O, enumerations, versions, and the arms."""

__all__: list[str] = []
