"""Camera calibration from films of a moving person or of a board."""
