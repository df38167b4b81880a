"""Commands that run picks and look at their results."""
