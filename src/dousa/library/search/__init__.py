"""The index of leaves, and searches by motion and by words."""
