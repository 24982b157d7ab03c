"""Leaves that change: which clips stand in them, which are kept as examples, and what grows in their place."""
