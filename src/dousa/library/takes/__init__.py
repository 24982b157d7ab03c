"""Looking into takes: the windows that a library keeps of its own, and those of others, described on the fly."""
