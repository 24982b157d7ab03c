"""Counting the repetitions of an action from tallies of its movement."""
