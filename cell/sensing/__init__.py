"""The depth camera: an exact render, and the sensor model that turns it into a measured image.

Effects of the sensor are in `sensor_model.measure`, their numbers in `cameras/*.yaml`.
"""
