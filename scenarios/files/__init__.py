"""Files written whole or not at all, and YAML changed in place."""
