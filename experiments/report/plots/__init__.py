"""Plots of a report, each drawn from the figures of report.json alone."""
