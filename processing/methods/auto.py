"""The default: by segments where the record shows sticks beyond doubt, else the smoother that knows no corners.

A stick is beyond doubt when it makes the record more likely by 1.5 ln n for each of its corners
(`processing.segmentation.smoother`).
"""

from processing.kalman import white_jerk
from processing.methods.registry import Motion, Setting
from processing.record.series import Series
from processing.segmentation import smoother


def estimate(series: Series, setting: Setting) -> Motion:
    """Smooth the record; ``method`` of the result says how.

    A window or an order that was asked for has a meaning for Savitzky-Golay alone, and is carried out by that.
    """
    if setting.window is not None or setting.order is not None:
        from processing.polynomial import savgol

        return savgol.estimate(series, setting)
    noise = white_jerk.fit(series)
    smooth = white_jerk.smooth(series, noise)
    found = smoother.segmented(series, noise, smooth, setting, gated=True)
    return smooth if found is None else found
