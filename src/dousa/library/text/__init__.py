"""Searching a library by words: what is kept of each motion for it, the index, and the answers."""
