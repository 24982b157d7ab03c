"""Uncut recordings: their windows, search inside them, labels over time, and the same while a motion happens."""
