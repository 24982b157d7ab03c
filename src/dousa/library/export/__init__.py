"""Clips of a library as files: where they go, and how they are made."""
