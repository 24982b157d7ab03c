"""The options of the commands: shared ones, and groups of those that have many."""
