"""The library as a page shows it: one list with facets, and a small moving figure of each clip."""
