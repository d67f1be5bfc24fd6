"""The committed .hex files are what the committed source makes, and the source keeps its own rules."""

import re
import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[2] / "firmware"
FLASH_BYTES = {"uno": 32_256, "mega": 253_952}  # less the bootloader
OURS = range(2, 18)


@pytest.mark.parametrize("kind", ["uno", "mega"])
def test_the_committed_hex_is_what_the_source_makes(built, kind):
    name = f"stickslip-{kind}.hex"
    assert (built / name).read_bytes() == (FIRMWARE / name).read_bytes()


@pytest.mark.parametrize("kind", ["uno", "mega"])
def test_it_fits_beside_the_bootloader_and_leaves_room_for_the_stack(built, kind):
    line = ["avr-size", str(built / f"stickslip-{kind}.elf")]
    text, data, bss = subprocess.run(line, capture_output=True, text=True, check=True).stdout.split("\n")[1].split()[:3]
    assert int(text) + int(data) < FLASH_BYTES[kind]
    assert int(data) + int(bss) < 2048 - 512


@pytest.mark.parametrize("kind", ["uno", "mega"])
def test_the_registers_of_the_interrupts_are_touched_by_nothing_else(built, kind):
    # A library routine that used one of them, saved and restored, would lose the edges of the time between.
    line = ["avr-objdump", "-d", str(built / f"stickslip-{kind}.elf")]
    listing = subprocess.run(line, capture_output=True, text=True, check=True).stdout
    # Ours; what runs before the first interrupt; constants that the disassembler takes for code.
    allowed = re.compile(
        r"__vector_\d+$|not_due$|latch|clock_(now|arm)$|phase$|steps$|(up|down|illegal|same|x4_end)$"
        r"|__do_copy_data$|__ctors_end$|__trampolines_end$|__c\."
    )
    routine = ""
    strangers = []
    for text in listing.splitlines():
        if head := re.match(r"^[0-9a-f]+ <(.+)>:$", text):
            routine = head.group(1)
            continue
        words = text.split("\t")
        if len(words) < 4 or allowed.match(routine):
            continue
        used = {int(number) for number in re.findall(r"\br(\d+)\b", words[3])}
        pairs = {n + 1 for n in used} if words[2].strip() == "movw" else set()
        if (used | pairs) & set(OURS):
            strangers.append((routine, text))
    assert not strangers
