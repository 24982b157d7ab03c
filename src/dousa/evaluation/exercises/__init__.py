"""Repetitions of an exercise: split, counted, measured and compared with a reference."""
