"""New clips in a library: what the forest learns from them, worked out beside other writers, then written at once."""
