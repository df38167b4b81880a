"""From votes to verified poses: hypotheses, ICP against the CAD, verification, score."""
