"""Dual-SLAM over several seeds of a scenario, two runs at a time."""

from dslab import experiments

if __name__ == "__main__":
    runs = [{"sequence": "small/room", "system": "dual", "seed": seed} for seed in range(2)]
    table = experiments.compare(experiments.run_many(runs, workers=2))
    print(table[["share_tracked", "breakages", "ate_m"]])
