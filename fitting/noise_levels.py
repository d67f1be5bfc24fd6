"""Levels at which a fit is taken as good, near, or lost, an effect as shown, and a usual value as known.

The former are rms residuals over the noise of one position; during a fit, over the resolution of the record.
"""

# Error of a fit that describes the record: true laws and departures end at 0.98 to 1.02.  At half the excess noise
# makes a true one start again; at twice a hard spring passes for friction by position, which leaves 1.1.
DESCRIBES = 1.03
# Error that is clearly more than noise: below it an excess shows in what residuals repeat, not in their size.  A
# measured curve that leaves so much beside an adequate law was not found.  At half the excess a sound curve is refused.
CLEARLY_ABOVE = 1.1
# Error of a fit worth polishing, which may be noise alone: at half the excess the noise of a short record hides a true
# law, at twice a wrong law is taken for one.
NEAR = 1.2
# Error beyond which a law does not describe a record: it is not judged, and a formula does not take every sample.  True
# laws end at 0.9 to 2.6 resolutions, the larger in harsh records.
LOST = 3.0

# Standard errors from which an effect is shown, or a stated value contradicted, chosen: at 3 chance would do so once in
# 400 times.
SHOWN = 4.0
FEWEST = 4  # cycles, sticks or levels whose usual one is trusted: of fewer, one odd one moves it
