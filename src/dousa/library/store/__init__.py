"""The database, its arrays and the forests that are stored in it."""
