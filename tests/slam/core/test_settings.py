"""Settings refuse what they do not know."""

import pytest
from pydantic import ValidationError

from dslab.slam.tracking.config import TrackingConfig


def test_a_name_that_is_no_setting_is_refused_by_name():
    with pytest.raises(ValidationError, match=r"cautious_inliers\n.*[Uu]nexpected keyword"):
        TrackingConfig(cautious_inliers=20)
