"""The default: by segments where the record shows sticks beyond doubt, else the smoother that knows no corners.

A stick is beyond doubt when it makes the record more likely by 1.5 ln n for each of its corners (`processing.segment`).
"""

from processing import rts, segment
from processing.methods import Motion, Setting
from processing.series import Series


def estimate(series: Series, setting: Setting) -> Motion:
    """Smooth the record; ``method`` of the result says how.

    A window or an order that was asked for has a meaning for Savitzky-Golay alone, and is carried out by that.
    """
    if setting.window is not None or setting.order is not None:
        from processing import savgol

        return savgol.estimate(series, setting)
    noise = rts.fit(series)
    smooth = rts.smooth(series, noise)
    found = segment.segmented(series, noise, smooth, setting, gated=True)
    return smooth if found is None else found
