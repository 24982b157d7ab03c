"""The time offsets of films, by the movement of people and by sound."""
