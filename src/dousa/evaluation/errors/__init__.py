"""What differs from the reference, and which error explains it."""
