"""Search for grasp points, rank weights and scenario fields with a higher pick success."""
