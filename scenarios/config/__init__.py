"""The scenario schema, and what else decides a result."""
