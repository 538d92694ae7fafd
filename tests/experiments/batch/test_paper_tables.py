"""Batches in the layout of the paper's tables: known trials, signs, totals, the paper's figures beside."""

import pandas as pd
import pytest

from dslab.experiments.batch.paper_tables import (
    NO_MAP,
    UNSTABLE,
    latex,
    table_1,
    table_2,
    table_3,
    write_tables,
)
from dslab.scenarios.errors import InputError


def trial(source, system, ate_m, intact, needed=0, first=0, later=0, took_s=None):
    return {
        "source": source, "system": system, "ended": "finished", "keyframe_ate_m": ate_m,
        "ate_m": ate_m, "intact": intact, "recoveries_needed": needed, "recovered_by_first": first,
        "recovered_by_later": later, "recovery_s": took_s,
    }  # fmt: skip


def rows():
    trials = [
        trial("kitti-like/03", "base", 1.0, True), trial("kitti-like/03", "base", 3.0, True),
        trial("kitti-like/03", "dual", 1.5, True), trial("kitti-like/03", "dual", 1.5, True),
        trial("kitti-like/01", "base", None, False), trial("kitti-like/01", "base", None, False),
        trial("kitti-like/01", "dual", 9.0, True, 2, 1, 1, 1.5),
        trial("kitti-like/01", "dual", 7.0, False, 1),
        trial("stressed", "base", 0.06, False), trial("stressed", "base", 0.02, True),
        trial("stressed", "dual", 0.5, True, 1, 1, 0, 0.5), trial("stressed", "dual", 0.5, True),
    ]  # fmt: skip
    return pd.DataFrame(trials)


def test_table_1_has_medians_and_the_papers_signs():
    table = table_1(rows()).set_index("sequence")
    assert table.loc["kitti-like/03", ["base", "dual"]].tolist() == ["2.00", "1.50"]
    assert table.loc["kitti-like/01", ["base", "dual"]].tolist() == [NO_MAP, f"8.00 {UNSTABLE}"]
    assert table.loc["stressed", "base"] == f"0.040 {UNSTABLE}"
    assert table.loc["kitti-like/03", "Dual-SLAM (paper)"] == "1.29"
    assert table["LDSO (paper)"].tolist() == ["2.14", "10.31", "", "0"]
    assert table.loc["stressed", "Dual-SLAM (paper)"] == ""
    assert table.loc["failed trials", ["base", "dual", "ORB-SLAM (paper)"]].tolist() == ["3", "1", "28"]


def test_table_2_has_rates_and_their_reduction():
    table = table_2(rows()).set_index("data set")
    assert table.loc["kitti-like", ["base", "dual"]].tolist() == ["2/4", "1/4"]
    assert table.loc["total", ["base", "dual"]].tolist() == ["3/6", "1/6"]
    assert table.loc["failure reduction", ["base", "dual"]].tolist() == ["n.a.", "1-1/3 = 0.67"]
    assert table.loc["KITTI (paper)", "Dual-SLAM"] == "10/110"


def test_table_3_has_recoveries_by_thread():
    table = table_3(rows())
    own = table[(table.system == "dual") & (table["data set"] == "kitti-like")].iloc[0]
    assert own[["trials", "needs recovery", "failure", "recoveries"]].tolist() == [4, 2, 1, 3]
    assert own[["success", "with thread 1", "with a later one", "mean time, s"]].tolist() == [2, 1, 1, "1.50"]
    assert "base" not in set(table.system)
    unbroken = rows()[rows().source == "kitti-like/03"]
    assert table_3(unbroken).iloc[0, :6].tolist() == ["dual", "kitti-like", 2, 0, 0, 0]
    assert table[table.system == "Dual-SLAM (paper)"]["with thread 1"].tolist() == [17, 106]


def test_tables_are_written_as_csv_and_latex(tmp_path):
    write_tables(rows(), tmp_path)
    names = {path.name for path in (tmp_path / "tables").iterdir()}
    assert names == {f"table_{n}.{form}" for n in (1, 2, 3) for form in ("csv", "tex")}
    text = (tmp_path / "tables" / "table_1.tex").read_text()
    assert text.startswith(r"\begin{tabular}{lrrrrrr}") and text.count(r"\\") == 5
    assert r"$\otimes$" in text and r"$\cap$" in text and NO_MAP not in text
    assert pd.read_csv(tmp_path / "tables" / "table_2.csv").shape[0] == 6


def test_a_name_is_no_command_of_latex():
    text = latex(pd.DataFrame({"a": [r"x & 50% #1 $_{y}^2$ ~\z"]}))
    assert r"x \& 50\% \#1 \$\_\{y\}\textasciicircum{}2\$ \textasciitilde{}\textbackslash{}z \\" "\n" in text


def test_a_file_where_the_folder_of_the_tables_belongs_is_one_line(tmp_path):
    (tmp_path / "tables").touch()
    with pytest.raises(InputError, match="tables: is a file where a folder belongs; move it away"):
        write_tables(rows(), tmp_path)
