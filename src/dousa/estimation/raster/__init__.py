"""Drawing a body into images."""
