"""Sticks and slips smoothed apart: every stick that shows is taken for one."""

from dataclasses import replace

from processing.kalman import white_jerk
from processing.record.estimates import RecordEstimates
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting, refuse_window
from processing.segmentation import smoother


def estimate(series: Series, setting: Setting, estimates: RecordEstimates) -> Motion:
    """Smooth the record (`processing.segmentation.smoother`).

    Parameters
    ----------
    series : Series
        The record.
    setting : Setting
        Must name no window and no order; its belt speed, if any, is the one that sticks have.
    estimates : RecordEstimates
        Of the record that this is a block of, or empty.

    Returns
    -------
    Motion
        With its corners.  Without a stick it is the motion of `processing.kalman.white_jerk`.

    Raises
    ------
    InputError
        When a window or an order was asked for.
    """
    refuse_window(setting, "segment", "segment has no window: the record decides how much is smoothed")
    noise = estimates.once("jerk", lambda: white_jerk.fit(series))
    pilot = white_jerk.smooth(series, noise)
    found = smoother.segmented(series, noise, pilot, setting, estimates.part("segments"), gated=False)
    return replace(pilot, method="segment") if found is None else found
