"""Training, and clips that are added to a trained library."""
