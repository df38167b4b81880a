"""Search for grasp points, rank weights and scenario fields that make more picks succeed."""
