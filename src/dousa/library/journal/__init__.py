"""What people change in a library is written down with what was before, so that it can be undone, and done again."""
