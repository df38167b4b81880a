"""The scenario schema, and the other inputs that decide a result."""
