"""Which figures of the thesis the atlas has: those redrawn, by number, and those that are not, with the reason."""

from rig_sim.atlas.chapters import chapter2, chapter4_map, chapter4_motion, chapter5
from rig_sim.atlas.figure import Entry

ENTRIES: dict[str, Entry] = {
    entry.number: entry for chapter in (chapter2, chapter4_motion, chapter4_map, chapter5) for entry in chapter.FIGURES
}
NOT_REDRAWN = {
    "4.13": "the thesis's text neither mentions it nor has its caption",
}
