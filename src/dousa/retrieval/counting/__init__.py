"""How often an action is repeated: tallies of its movement, and the count that they speak for."""
