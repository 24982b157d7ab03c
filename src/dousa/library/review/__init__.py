"""Looking through a library: labels that are likely wrong, and clips that are nearly the same."""
