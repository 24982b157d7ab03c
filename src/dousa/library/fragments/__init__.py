"""Arrays of clips beside the tables of a large library: fragments, files that only grow."""
