"""Cameras from a film: of a person who moves, or of a board."""
