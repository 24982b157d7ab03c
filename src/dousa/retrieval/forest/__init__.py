"""The motion forest: growing, asking, keeping it in a file; new categories; how far its answer can be trusted."""
