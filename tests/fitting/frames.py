"""A smoothed record in the fit's frame, and cut into cycles as a fit takes it."""

from fitting.judge.law_fits import cut_run
from fitting.record import motion


def in_frame(kinematics):
    return motion.from_kinematics(kinematics, kinematics.recording.rig, None)


def cut(kinematics):
    return cut_run(in_frame(kinematics), frozenset())
