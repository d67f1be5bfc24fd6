"""The default: "segment" where the record shows sticks beyond doubt, else "rts".

A stick is beyond doubt when it makes the record more likely by 1.5 ln n for each of its corners
(`processing.segmentation.model_selection`).
"""

from processing.kalman import white_jerk
from processing.record.estimates import RecordEstimates
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting
from processing.segmentation import smoother


def estimate(series: Series, setting: Setting, estimates: RecordEstimates | None = None) -> Motion:
    """Smooth the record; ``method`` of the result is "segment" or "rts".

    ``setting`` names no window and no order: `processing.methods.registry.estimate` hands those to "sg".
    """
    estimates = estimates or RecordEstimates()
    noise = estimates.once("jerk", lambda: white_jerk.fit(series))
    pilot = white_jerk.smooth(series, noise)
    found = smoother.segmented(series, noise, pilot, setting, estimates.part("segments"), gated=True)
    return pilot if found is None else found
