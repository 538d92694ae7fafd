"""Merging folders of one experiment: all units, once; what contradicts is refused and nothing is written."""

import shutil
from contextlib import nullcontext, suppress
from functools import partial

import pytest
from pool_fakes import LocalPool
from unit_fakes import made_up_record, made_up_unit

from dslab.experiments.campaign.folder import TABLE_FILE, export, read_rows
from dslab.experiments.campaign.merge import merge
from dslab.experiments.campaign.runner import run_experiment
from dslab.experiments.campaign.schedule import Schedule
from dslab.experiments.eq1.spec import load_spec
from dslab.scenarios.errors import InputError


@pytest.fixture(scope="module")
def spec():
    return load_spec("smoke").model_copy(update={"sham": False, "repeats": 1, "worlds": 6})


def run(spec, folder, units=None, last_first=False, job=None):
    """Run synthetic units, all or the first few to be started."""

    def stop(tally):
        if units is not None and tally.ended_here >= units:
            raise KeyboardInterrupt

    with suppress(KeyboardInterrupt):
        run_experiment(
            spec,
            folder,
            lambda: nullcontext(LocalPool(job or made_up_unit)),
            show=stop,
            order=partial(Schedule, last_first=last_first),
        )
    return folder


def test_two_machines_that_meet_in_the_middle_make_the_whole(spec, tmp_path):
    first, second = run(spec, tmp_path / "a", 5), run(spec, tmp_path / "b", 8, last_first=True)
    assert {row["index"] for row in read_rows(second)[1]} <= {2, 3, 4, 5}
    done = merge(tmp_path / "both", [first, second])
    total = spec.worlds * len(spec.cell_names())
    assert (done.added, done.total) == (done.done, total) and done.known + done.added >= 12
    whole = run(spec, tmp_path / "whole")
    run(spec, tmp_path / "both")
    made = [[made_up_record(spec.unit(row["cell"], row["index"]))["unit_id"] for row in read_rows(f)[1]]
            for f in (tmp_path / "both", whole)]  # fmt: skip
    assert made[0] == made[1] and len(made[0]) == total


def test_a_run_goes_on_from_an_exported_table(spec, tmp_path):
    folder = run(spec, tmp_path / "a", 7)
    export(folder)
    (tmp_path / "table").mkdir()
    for name in ("spec.yaml", TABLE_FILE):
        shutil.copy(folder / name, tmp_path / "table" / name)
    assert merge(tmp_path / "b", [tmp_path / "table"]).added == len(read_rows(folder)[1])
    assert read_rows(tmp_path / "b")[1] == read_rows(folder)[1]
    assert merge(tmp_path / "b", [folder]).added == 0


def test_what_contradicts_is_refused_and_nothing_is_written(spec, tmp_path):
    folder = run(spec, tmp_path / "a", 3)
    before = read_rows(folder)[1]
    wrong = before[1]["unit_id"]

    def otherwise(unit):
        return made_up_unit(unit) | ({"onset_frame": 77} if unit.unit_id == wrong else {})

    other = run(spec, tmp_path / "b", 6, job=otherwise)
    with pytest.raises(InputError, match=f"{before[1]['cell']}:{before[1]['index']} has another outcome"):
        merge(folder, [other])
    of_another = run(spec.model_copy(update={"root_seed": 9}), tmp_path / "c", 2)
    with pytest.raises(InputError, match="is of another experiment"):
        merge(folder, [of_another])
    assert read_rows(folder)[1] == before
