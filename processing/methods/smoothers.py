"""The smoothers that ask for no window: "rts" takes all motion alike, "segment" smooths sticks and slips apart.

"auto", the default, is "segment" where the record shows sticks beyond doubt, else "rts".  A stick is beyond doubt when
it makes the record more likely by 1.5 ln n for each of its corners (`processing.segmentation.model_selection`).
"""

from dataclasses import replace

from processing.kalman import white_jerk
from processing.methods.method_model import MethodModel
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting, reject_window
from processing.segmentation import smoother


def learn(method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
    """Find the noise levels of greatest likelihood, and whether and how the record sticks and slips.

    series: The record.
    setting: Must name no window and no order: the record decides.  Its belt speed, if any, is the one that sticks have.
    noise: Standard deviation of a position, m.
    Raises InputError: when a window or an order was asked for.
    """
    reject_window(setting, method, f"{method} has no window: the record decides how much is smoothed")
    jerk, stated = white_jerk.fit(series), setting.belt_speed
    if method == "rts":
        return MethodModel(method="rts", noise=noise, jerk=jerk, stated=stated)
    pilot = white_jerk.smooth(series, jerk)
    rule, sticks, known = smoother.learn(series, jerk, pilot, stated, gated=method == "auto")
    chosen = "rts" if method == "auto" and sticks is None else "segment"
    return MethodModel(method=chosen, noise=noise, jerk=jerk, rule=rule, sticks=sticks, stated=stated, known=known)


def apply(series: Series, model: MethodModel) -> Motion:
    """Smooth the record, or a block of it.

    Returns: ``window`` is that of the equivalent Savitzky-Golay filter of order 4, ``order`` the spline's. With its
        corners where sticks and slips are smoothed apart.
    """
    known = model.known
    pilot = known.pilot if known is not None and known.series is series else white_jerk.smooth(series, model.jerk)
    if model.sticks is None or model.rule is None:
        return replace(pilot, method=model.method)
    return smoother.apply(series, pilot, model.stated, model.rule, model.sticks, known)
