"""A small experiment on Eq. 1: a few units, their records as a table, a report page."""

from pathlib import Path

from dslab import experiments


def main(folder: Path = Path("small-experiment")) -> None:
    """Run one unit of one dose and write the report; more units and workers take no other call."""
    spec = experiments.load_experiment("smoke")
    weak_texture = spec.degradations[0].model_copy(update={"doses": (0.02,)})
    spec = spec.model_copy(update={"degradations": (weak_texture,), "worlds": 1, "repeats": 1, "sham": False})
    tally = experiments.run_experiment(spec, folder, workers=1)
    print(f"{tally.done} of {tally.total} units")
    spec, table = experiments.read_experiment(folder)
    print(table[["cell", "world", "outcome", "breakage", "d1"]].to_string())
    print("report:", experiments.write_report(folder))


if __name__ == "__main__":  # the workers import this file
    main()
