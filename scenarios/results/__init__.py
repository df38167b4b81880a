"""What a campaign leaves: records, the results file, the summary, replay files."""
