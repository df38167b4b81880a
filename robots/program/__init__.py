"""A motion as a Fanuc TP program, and as waypoints."""
