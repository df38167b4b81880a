"""`pickproof benchmark ...`: commands that measure pickproof itself."""
