"""The report of an experiment: one page to read, its figures as JSON, its plots as files."""
