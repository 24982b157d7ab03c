"""The time between films, by the movement of people in them and by their sound."""
