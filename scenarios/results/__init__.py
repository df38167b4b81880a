"""Output of a campaign: records, the results file, the summary, replay files."""
