"""``dslab paper``: Eq. 1 on the counts of the paper."""

import json

import pytest


def test_the_figures_are_those_of_the_paper(dslab):
    code, out, _ = dslab("paper", "--json")
    assert code == 0
    rows = {(r["counts"]["system"], r["counts"]["dataset"]): r for r in json.loads(out)["rows"]}
    total = rows["Dual-SLAM", "Total"]
    assert (total["counts"]["breakages"], total["counts"]["trials"]) == (153, 610)
    assert total["p0"]["estimate"] == pytest.approx(0.251, abs=5e-4)
    assert total["thread_1"]["estimate"] == pytest.approx(0.196, abs=5e-4)
    assert total["thread_2"]["estimate"] == pytest.approx(0.8)
    assert total["predicted"]["value"] == pytest.approx(0.0096, abs=5e-5)
    assert total["measured"]["estimate"] == pytest.approx(0.0393, abs=5e-5)
    assert total["ratio"]["value"] == pytest.approx(4.1, abs=0.05)
    assert rows["Dual-SLAM⁺", "Total"]["ratio"]["value"] == pytest.approx(4.9, abs=0.05)


def test_the_tables_name_every_row_and_figure_in_80_columns(dslab, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = dslab("paper")
    assert code == 0 and "30/153" in out and "19.6 %" in out and "4.08" in out
    assert out.count("Dual-SLAM⁺") == 6 and out.count("TUM-Mono") == 4
    # Intervals are not torn apart.
    assert "…" not in out and "_" not in out and not any(x.rstrip().endswith(" to") for x in out.splitlines())


def test_files_are_written_where_asked(dslab, tmp_path):
    folder = tmp_path / "paper"
    assert dslab("paper", "--out", folder)[0] == 0
    assert sorted(path.name for path in folder.iterdir()) == ["paper.json", "paper.png", "paper.svg"]
    assert len(json.loads((folder / "paper.json").read_text())["rows"]) == 6
    code, _, err = dslab("paper", "--out", folder)
    assert code == 2 and "already holds files" in err
