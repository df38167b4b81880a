"""The depth camera: an exact render, and the sensor model that turns it into a measured image."""
