"""Labels of takes, tags and saved searches."""
