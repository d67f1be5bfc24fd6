"""Which figures of the thesis the atlas has: those redrawn, by number, and those that are not, with the reason."""

from rig_sim.atlas.chapters import chapter2
from rig_sim.atlas.figure import Entry

ENTRIES: dict[str, Entry] = {entry.number: entry for chapter in (chapter2,) for entry in chapter.FIGURES}
NOT_REDRAWN: dict[str, str] = {}
