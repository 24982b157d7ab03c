"""Windows of takes, and the search for places in them."""
