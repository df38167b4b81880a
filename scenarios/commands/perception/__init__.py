"""Commands that train, measure and use perception."""
