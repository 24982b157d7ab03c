"""Bodies of which a part is missing: what they are compared by, and forests that ask about that alone."""
