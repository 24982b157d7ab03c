"""The index of leaves, and search by motion and by words."""
