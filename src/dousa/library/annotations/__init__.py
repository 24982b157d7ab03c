"""Takes with labels: where their tables are found, and how their segments are kept."""
