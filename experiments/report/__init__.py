"""Report of an experiment: a page, its figures as JSON, its plots as files."""
