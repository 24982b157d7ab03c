"""The demonstration: every capability on synthetic people, before your eyes."""
