"""Research on top of campaigns: rare events by importance sampling, back-analysis."""
