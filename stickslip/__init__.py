"""Which friction law does a stick-slip contact obey: the functions of a record's way, and what the packages share.

>>> import stickslip as ss
>>> ranking = ss.rank("data_samples/law5.h5", laws=5)
>>> ranking.laws_in_set
(5,)

``load`` and ``record`` are those of `daq`, ``smooth`` is that of `processing`, ``rank`` and ``rank_each`` are those of
`fitting`, ``scene``, ``run``, ``events`` and ``cycle`` those of `rig_sim`.  Each package is imported on first use.
"""

from stickslip.lazy import lazy_names

__all__ = [
    "Law",
    "Recording",
    "__version__",
    "cycle",
    "events",
    "load",
    "rank",
    "rank_each",
    "record",
    "run",
    "scene",
    "smooth",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    dict.fromkeys(("Recording", "load", "record"), "daq")
    | {"smooth": "processing"}
    | dict.fromkeys(("Law", "rank", "rank_each"), "fitting")
    | dict.fromkeys(("cycle", "events", "run", "scene"), "rig_sim"),
)
