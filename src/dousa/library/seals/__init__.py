"""Checksums of what is kept, and what they can put right."""
