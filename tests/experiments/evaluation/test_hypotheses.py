"""Logged hypotheses stand in a table with the truth beside them."""

import numpy as np
from test_relation_audit import STAMPS, TRUTH, asserted

from dslab.experiments.evaluation.hypotheses import hypotheses
from dslab.experiments.evaluation.metrics import Truth
from dslab.slam.belief.log import LoggedView
from dslab.slam.belief.model import Sight, Unseen

UNSEEN = Unseen(3.0, 2.0, 1.0)
SIGHT = Sight(*(np.arange(3) for _ in range(8)))


def logged(relation, supposed_by=500):
    return LoggedView("loop", (0, supposed_by, 40), relation, SIGHT, "contradicted", UNSEEN)


def test_a_view_is_false_if_it_is_not_where_it_is_supposed_to_be():
    right, far, turned = asserted(new=(340,)), asserted(new=(340,), shift_m=(3, 0, 0)), asserted(
        new=(340,), turn_deg=40
    )  # fmt: skip
    alone = asserted(old=(40,), new=(340,))
    table = hypotheses(
        [logged(right), logged(far), logged(turned), logged(alone), logged(right, supposed_by=340)],
        Truth(STAMPS, TRUTH),
    )
    assert table["false"].iloc[:3].tolist() == [False, True, True]
    assert table["false"].isna().iloc[3] and table.reason.iloc[3]
    assert table.proposes.tolist() == [False] * 4 + [True]
    assert table.error_over_bound[0] < 0.1 and table.error_over_bound[1] > 1
    assert tuple(table.loc[0, list(Unseen._fields)]) == UNSEEN
    assert table.shown[0].tolist() == [0, 1, 2]


def test_a_run_without_hypotheses_has_an_empty_table():
    assert hypotheses([], Truth(STAMPS, TRUTH)).empty
