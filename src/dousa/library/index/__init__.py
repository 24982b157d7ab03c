"""What a search needs of all clips, kept small: exact answers of a million clips without looking at most of them."""
