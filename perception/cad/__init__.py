"""What perception computes from the CAD once: samples, distance field, silhouettes."""
