"""Pages served to a browser: where they listen, and who is let in."""
