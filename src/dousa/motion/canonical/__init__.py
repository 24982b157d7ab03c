"""Mapping of any motion to 20 canonical joints in metres with Y up and a known left side."""
