"""Check, repair, compaction and review."""
