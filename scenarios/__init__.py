"""The scenarios that come with Heliarch."""
