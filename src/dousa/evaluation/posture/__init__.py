"""Posture: a frame as the directions of nine segments, their weights, and the rotation between two of them."""
