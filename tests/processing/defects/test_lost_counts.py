"""Lost counts are found, each once, and nothing else is taken for one."""

from dataclasses import replace

import numpy as np
import pytest

from processing.defects import lost_counts
from processing.record import series


@pytest.mark.parametrize("size", [10, -12, 40, -300])
def test_a_loss_within_one_sample_is_marked_where_it_happened(motion, recorded, size):
    run = recorded(motion(5, 20.0))
    at = [700, 5000, 9001, 14321]
    count = run.count.copy()
    for k in at:
        count[k:] += size
    found = lost_counts.losses(series.from_recording(replace(run, count=count)))
    assert [loss.first for loss in found] == at
    assert [loss.last for loss in found] == at
    assert np.abs([loss.counts - size for loss in found]).max() <= 1


@pytest.mark.parametrize(
    ("jitter", "times"), [(0.0, "recorded"), (30e-6, "recorded"), (100e-6, "recorded"), (30e-6, "nominal")]
)
def test_no_false_alarm_in_a_clean_minute(motion, recorded, times, jitter):
    assert lost_counts.losses(series.from_recording(recorded(motion(5, 60.0, jitter)), times)) == ()


def test_a_track_without_counts_has_none_to_lose(imported):
    time = np.arange(100) * 1e-3
    assert lost_counts.losses(series.from_recording(imported(time, np.where(time < 0.05, 0.0, 1.0)))) == ()
