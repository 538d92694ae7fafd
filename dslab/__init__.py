"""Dual-SLAM lab: `from dslab import scenarios, sim, slam, experiments`.

The packages stand at the top of the repository; here are links to them.
"""
