"""Levels of error over noise at which a fit is taken as good, near, or lost.

Each is an rms residual over the noise of one position; during a fit, over the resolution of the record.
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
