"""The plots of a report; each is drawn from the figures of report.json and from nothing else."""
