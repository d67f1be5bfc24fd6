from daq import Recording as Recording
from daq import load as load
from daq import record as record
from fitting import Law as Law
from fitting import rank as rank
from fitting import rank_each as rank_each
from processing import smooth as smooth
from rig_sim import cycle as cycle
from rig_sim import events as events
from rig_sim import run as run
from rig_sim import scene as scene

__version__: str
