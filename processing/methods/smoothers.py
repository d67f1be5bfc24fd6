"""The smoothers, which need no window: "rts" smooths all motion in one way, "segment" sticks and slips separately.

"auto", the default, is "segment" if the record clearly contains sticks, else "rts".  A stick is clear if it raises the
log likelihood of the record by 1.5 ln n for each of its corners (`processing.stick_slip.accept`).
"""

from dataclasses import replace

from processing.kalman import white_jerk
from processing.methods.registry import MethodModel
from processing.record.motion import Motion
from processing.record.series import Series
from processing.record.setting import Setting, reject_window
from processing.stick_slip import smoother


def learn(method: str, series: Series, setting: Setting, noise: float) -> MethodModel:
    """Fit the noise levels by maximum likelihood, and whether and how the record sticks and slips.

    A belt speed in the setting is that of the sticks; InputError for a window or an order.
    """
    reject_window(setting, method, f"{method} has no window, because it estimates the smoothing from the record")
    jerk, stated = white_jerk.fit(series), setting.belt_speed
    if method == "rts":
        return MethodModel(method="rts", noise=noise, jerk=jerk, stated=stated)
    pilot = white_jerk.smooth(series, jerk)
    rule, sticks, first_pass = smoother.learn(series, jerk, pilot, stated, gated=method == "auto")
    chosen = "rts" if method == "auto" and sticks is None else "segment"
    return MethodModel(
        method=chosen, noise=noise, jerk=jerk, rule=rule, sticks=sticks, stated=stated, first_pass=first_pass
    )


def apply(series: Series, model: MethodModel) -> Motion:
    """Smooth the record, or a block of it; the motion states the window of the equivalent Savitzky-Golay filter."""
    first_pass = model.first_pass
    pilot = (
        first_pass.pilot
        if first_pass is not None and first_pass.series is series
        else white_jerk.smooth(series, model.jerk)
    )
    if model.sticks is None or model.rule is None:
        return replace(pilot, method=model.method)
    return smoother.apply(series, pilot, model.stated, model.rule, model.sticks, first_pass)
