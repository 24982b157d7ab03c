"""Keypoints of people in films, found by networks or read from files."""
