"""Errors of known class, time and size put into real motion."""
