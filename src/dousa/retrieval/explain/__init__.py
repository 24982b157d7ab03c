"""Reasons: the few tests that decided the vote of a forest, as relations with numbers."""
