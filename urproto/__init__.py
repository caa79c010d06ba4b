"""Definitions shared by client and controller: codecs without I/O, enumerations, versions, and arm models."""

__all__: list[str] = []
