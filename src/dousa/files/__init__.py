"""Files of unknown origin in, whole files out: clear errors, guarded arrays and markup, never half a file."""
