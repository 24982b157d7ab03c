"""Looking after a library: what is damaged, what of it can be had again, and unused room."""
