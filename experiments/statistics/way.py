"""How far a measured failure lies on the way from Eq. 1 to the weakest link."""

import numpy as np

from dslab.experiments.statistics.estimates import Figure
from dslab.experiments.statistics.world_intervals import Interval, few_events, ratio_interval, wilson_interval


def way_interval(measured: Figure, product: Figure, weakest: Figure) -> Interval | None:
    """Way k = (measured - product) / (weakest - product) with its interval by worlds.

    0 is Eq. 1, 1 the weakest link. The spread of the failure is not known where fewer than 5 worlds have it,
    or by Eq. 1 are to have it or not to have it: the interval is then at least that of so many trials as
    there are worlds.

    Args:
        measured: Q or D.
        product: pi_marg, over the same worlds.
        weakest: the smallest of p0 and the threads' pr.

    Returns:
        The way; None with fewer than 3 worlds, or where Eq. 1 and the weakest link are the same.
    """
    room = weakest - product
    if measured.worlds < 3 or room.value <= 0 or not np.isfinite([*measured.without, *product.without]).all():
        return None
    found = ratio_interval(measured - product, room)
    if found is None or not few_events(measured.pseudo_values, (product.value,)):
        return found
    trials = wilson_interval(min(max(measured.value, 0.0), 1.0), measured.worlds, measured.worlds)
    ends = [(end - product.value) / room.value for end in (trials.low, trials.high)]
    return Interval(found.value, min(found.low, ends[0]), max(found.high, ends[1]))
