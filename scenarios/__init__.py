"""What is run, and what came of it: scenarios, picks, episodes, campaigns, statistics, reports."""
