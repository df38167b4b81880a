"""Reports, explanations and exports of a campaign."""
