"""A scenario, its frames, base and Dual-SLAM on them, and what came of it."""

from dslab import experiments, scenarios, sim, slam

sequence = sim.render(scenarios.load("breakage", seed=1))
runs = [experiments.run(sequence, system) for system in ("base", "dual")]
print(experiments.compare(runs))
print("ATE of Dual-SLAM:", runs[1].metrics["ate_m"], "m")
print("breakages:", [e.frame for e in runs[1].events if isinstance(e, slam.events.Breakage)])
runs[1].plot("quickstart.png")
