"""Recordings of several repetitions, their bounds known."""
