"""Episodes and campaigns, in worker processes or on a Ray cluster."""
