"""What a motion is described by: pose features, channels, and their integrals over time."""
