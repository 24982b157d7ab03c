"""Furi, the figures of a dance: where they are cut, their eigenspaces, and curves over them."""
