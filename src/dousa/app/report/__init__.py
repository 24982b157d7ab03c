"""The report of an assessment: one HTML page that opens anywhere, offline, and two CSV files; and its parts by name."""
