"""One pick from the depth image to the judged outcome."""
