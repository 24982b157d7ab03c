"""Cameras, and the files that calibrations come in."""
