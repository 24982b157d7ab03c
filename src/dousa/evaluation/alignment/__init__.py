"""Which moment of one motion belongs to which moment of another."""
