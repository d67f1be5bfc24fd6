"""The fixed-interval smoother of a white-jerk motion, its noise levels by maximum likelihood."""

from processing.kalman import white_jerk
from processing.record.estimates import RecordEstimates
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting, refuse_window


def estimate(series: Series, setting: Setting, estimates: RecordEstimates) -> Motion:
    """Smooth the record (`processing.kalman.white_jerk`).

    Parameters
    ----------
    series : Series
        The record.
    setting : Setting
        Must name no window and no order: the record decides.
    estimates : RecordEstimates
        Of the record that this is a block of, or empty.

    Returns
    -------
    Motion
        ``window`` is that of the equivalent Savitzky-Golay filter of order 4, ``order`` the spline's.

    Raises
    ------
    InputError
        When a window or an order was asked for.
    """
    refuse_window(setting, "rts", "rts has no window: the record decides how much is smoothed")
    return white_jerk.smooth(series, estimates.once("jerk", lambda: white_jerk.fit(series)))
