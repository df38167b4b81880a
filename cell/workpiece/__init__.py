"""The workpiece: CAD, mass, collision pieces, resting poses, optical surface."""
