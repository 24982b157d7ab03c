"""Windows of takes, and search for places in them."""
